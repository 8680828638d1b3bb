"""The data that learners are compared on must be right, and must not give away what is held out."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

pinocchio = pytest.importorskip("pinocchio")
pybullet = pytest.importorskip("pybullet")

from tel_lab.inverse_dynamics import arm_models  # noqa: E402
from tel_lab.inverse_dynamics import data_sets as data  # noqa: E402

PLANAR_URDF = data.ROOT / "sim_bridge" / "urdf" / "planar_arm.urdf"
NAMES = ("planar practice", "letters", "seven joints")


@pytest.fixture(scope="module")
def sets() -> dict[str, data.DataSet]:
    """All three sets, the simulated one with few and fast trials."""
    planar = data.planar_practice(durations_s=(5.5, 4.5), held_out_s=(4.5,), other_paths_s=(5.0,))
    return {each.name: each for each in (planar, data.letters(), data.seven_joints())}


def nmse(torque_nm: np.ndarray, expected_nm: np.ndarray) -> np.ndarray:
    """Return MSE / variance of each joint."""
    return np.mean((torque_nm - expected_nm) ** 2, axis=0) / np.var(expected_nm, axis=0)


@pytest.mark.parametrize("name", NAMES)
def test_trials_are_finite_and_fit_their_arm(sets: dict[str, data.DataSet], name: str) -> None:
    each = sets[name]
    n = len(each.joints)
    assert len(each.stiffness_nm_per_rad) == len(each.damping_nms_per_rad) == n
    for trial in each.training + each.held_out:
        assert trial.inputs.shape == (len(trial.torque_nm), 3 * n)
        assert trial.torque_nm.shape[1] == n
        assert trial.input_noise.shape == (3 * n,)
        assert np.all(np.isfinite(trial.inputs)) and np.all(np.isfinite(trial.torque_nm))
        assert 0.0 < trial.bandwidth_hz <= 0.5 * trial.rate_hz


def test_sets_have_the_trials_that_they_promise(sets: dict[str, data.DataSet]) -> None:
    counts = {name: (len(each.training), len(each.held_out)) for name, each in sets.items()}
    assert counts == {"planar practice": (1, 2), "letters": (17, 3), "seven joints": (12, 3)}
    assert [trial.name for trial in sets["letters"].held_out] == list(data.UNSEEN_LETTERS)
    assert len(data.PRACTICE_S) == 15
    assert (data.PRACTICE_S[0], data.PRACTICE_S[-1]) == (11.5, 4.5)


@pytest.mark.parametrize("name", NAMES)
def test_velocity_and_acceleration_are_the_derivatives(sets: dict[str, data.DataSet], name: str) -> None:
    # Central differences over 80 ms flatten the sharp corners of letters.
    tolerance = {"letters": 0.15}.get(name, 0.01)
    for trial in sets[name].training + sets[name].held_out:
        q, v, a = np.split(trial.inputs, 3, axis=1)
        for signal, derivative in ((q, v), (v, a)):
            difference = np.gradient(signal, 1.0 / trial.rate_hz, axis=0)
            rms = np.sqrt(
                np.mean((difference - derivative)[1:-1] ** 2, axis=0) / np.mean(derivative**2, axis=0)
            )
            assert np.all(rms < tolerance), (trial.name, rms)


@pytest.mark.parametrize("name", ("letters", "seven joints"))
def test_exact_movements_go_from_rest_to_rest(sets: dict[str, data.DataSet], name: str) -> None:
    for trial in sets[name].training + sets[name].held_out:
        velocity = np.split(trial.inputs, 3, axis=1)[1]
        # The last sample is the first one that is not before the end.
        assert np.all(np.abs(velocity[[0, -1]]) < 1e-9)


def test_letters_are_written_at_the_size_and_the_pace_of_a_hand(sets: dict[str, data.DataSet]) -> None:
    l1, l2 = arm_models.WRITING_LINKS_M
    for trial in sets["letters"].training + sets["letters"].held_out:
        q1, q2, v1, v2, *_ = trial.inputs.T
        elbow = l1 * np.exp(1j * q1)
        hand = elbow + l2 * np.exp(1j * (q1 + q2))
        size_m = max(np.ptp(hand.real), np.ptp(hand.imag))
        assert 0.05 < size_m < 0.15, trial.name
        assert max(np.abs(v1).max(), np.abs(v2).max()) < 2.0, trial.name
        assert 2.0 <= (len(trial.inputs) - 1) / trial.rate_hz < 3.0 + 1.0 / trial.rate_hz


def test_torque_of_the_letters_is_that_of_links_in_a_plane(sets: dict[str, data.DataSet]) -> None:
    inputs, torque_nm = data.stacked(sets["letters"].training + sets["letters"].held_out)
    (l1, _), (m1, m2), (i1, i2) = arm_models.WRITING_LINKS_M, (1.4, 1.0), (0.02, 0.012)
    _, q2, v1, v2, a1, a2 = inputs.T
    c, s = 0.5 * m2 * l1 * 0.25 * np.array([np.cos(q2), np.sin(q2)])
    elbow, carried = i2 + 0.25 * m2 * 0.25**2, i1 + 0.25 * m1 * l1**2 + m2 * l1**2
    at_shoulder = (carried + elbow + 2.0 * c) * a1 + (elbow + c) * a2 - s * (2.0 * v1 * v2 + v2**2)
    at_elbow = (elbow + c) * a1 + elbow * a2 + s * v1**2
    expected_nm = np.column_stack([at_shoulder + 0.08 * v1, at_elbow + 0.05 * v2])
    assert torque_nm == pytest.approx(expected_nm, abs=1e-9)


def test_recorded_torque_is_that_of_the_simulated_arm(sets: dict[str, data.DataSet]) -> None:
    each = sets["planar practice"]
    inputs, torque_nm = data.stacked(each.training + each.held_out)
    expected_nm = arm_models.torque_nm(PLANAR_URDF.read_text(encoding="utf-8"), inputs, 0.05)
    # The velocity that the EP law is given is late: half a period for the difference of two readings, and
    # what its low-pass of 100 Hz takes, which keeps a share of exp(-0.4 π) of the old value each period.
    kept = np.exp(-2.0 * np.pi * 100.0 / 500.0)
    late_s = (0.5 + kept / (1.0 - kept)) / 500.0
    expected_nm -= np.multiply(each.damping_nms_per_rad, late_s) * inputs[:, 4:]
    # Encoder steps and the filter leave less than 1 % of the torque's RMS.
    assert np.all(nmse(torque_nm, expected_nm) < 1e-4)


def test_torque_of_seven_joints_is_that_of_another_dynamics_library(
    sets: dict[str, data.DataSet], tmp_path: Path
) -> None:
    inputs, torque_nm = data.stacked(sets["seven joints"].held_out)
    # Without shapes, and so without the meshes that they refer to.
    path = tmp_path / "arm.urdf"
    without = re.sub("<(visual|collision)>.*?</\\1>", "", arm_models.iiwa_urdf(), flags=re.DOTALL)
    path.write_text(without, encoding="utf-8")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        body = pybullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client)
        pybullet.setGravity(0.0, 0.0, -arm_models.GRAVITY_M_S2, physicsClientId=client)
        for row, torque in zip(inputs[::50], torque_nm[::50], strict=True):
            q, v, a = (part.tolist() for part in np.split(row, 3))
            expected = pybullet.calculateInverseDynamics(body, q, v, a, physicsClientId=client)
            viscous = np.multiply(data.SEVEN_JOINTS_VISCOUS_NMS_PER_RAD, v)
            assert torque - viscous == pytest.approx(expected, abs=1e-6)
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize("name", NAMES)
def test_held_out_trials_are_none_of_the_training_trials(sets: dict[str, data.DataSet], name: str) -> None:
    each = sets[name]
    names = [trial.name for trial in each.training + each.held_out]
    assert len(set(names)) == len(names)
    # They may come near each other, but never with the same position, velocity and acceleration while moving.
    n, scale = len(each.joints), np.std(data.stacked(each.training)[0], axis=0)
    for seen, unseen in product(each.training, each.held_out):
        a, b = (t.inputs[np.abs(t.inputs[:, n]) > 0.1][::20] / scale for t in (seen, unseen))
        assert np.linalg.norm(a[:, None] - b[None], axis=2).min() > 1e-3, (seen.name, unseen.name)


@pytest.mark.parametrize("name", NAMES)
def test_urdf_has_the_right_kinematics_and_wrong_inertias(sets: dict[str, data.DataSet], name: str) -> None:
    each = sets[name]
    right_urdf = {
        "planar practice": PLANAR_URDF.read_text(encoding="utf-8"),
        "letters": arm_models.WRITING_ARM,
        "seven joints": arm_models.iiwa_urdf(),
    }[name]
    right, wrong = (pinocchio.buildModelFromXML(text) for text in (right_urdf, each.urdf))
    assert list(wrong.names)[1:] == list(each.joints)
    for row in each.held_out[0].inputs[::100, : len(each.joints)]:
        places = []
        for model in (right, wrong):
            state = model.createData()
            pinocchio.framesForwardKinematics(model, state, row)
            places.append(np.array([frame.homogeneous for frame in state.oMf]))
        assert places[1] == pytest.approx(places[0], abs=1e-12)
    for link, other in list(zip(right.inertias, wrong.inertias, strict=True))[1:]:
        assert other.mass > 0.0  # it is wrong, not missing
        assert abs(np.log(other.mass / link.mass)) > 0.3
    inputs, torque_nm = data.stacked(each.held_out)
    assert np.all(nmse(arm_models.torque_nm(each.urdf, inputs, 0.0), torque_nm) > 0.01)


def test_data_are_the_same_each_time(sets: dict[str, data.DataSet]) -> None:
    for name, again in (("letters", data.letters()), ("seven joints", data.seven_joints())):
        for before, after in zip(sets[name].training, again.training, strict=True):
            assert np.array_equal(before.inputs, after.inputs)
            assert np.array_equal(before.torque_nm, after.torque_nm)
