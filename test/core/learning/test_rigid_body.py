"""Rigid links, linear in their parameters, against the formulas of the two-link arm."""

from __future__ import annotations

import dataclasses
import functools
import sys

import numpy as np
import pytest
from two_link import TwoLinkArm
from two_link_trials import JOINTS, context, random_movement, trial, truth_rad, urdf

from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.learner import rms
from tel_ros.core.learning.rigid_body import COULOMB_SPEED_RAD_S, RigidBodyLearner, RigidBodyRegressor
from tel_ros.core.learning.signals import TrainingSamples

pytest.importorskip("pinocchio")

DRIVE, VISCOUS, COULOMB = np.array([0.02, 0.03]), np.array([0.05, 0.05]), np.array([0.3, 0.1])
X = random_movement(np.random.default_rng(0), 4.0)[::5]


def true_parameters() -> np.ndarray:
    """Return mass, first and second moments about its joint of each link, then those of each joint."""
    links = []
    for mass, inertia in zip(TwoLinkArm.MASS, TwoLinkArm.INERTIA, strict=True):
        moment = mass * TwoLinkArm.CENTRE
        about_joint = inertia + moment * TwoLinkArm.CENTRE
        links += [mass, moment, 0.0, 0.0, 0.0, 0.0, about_joint, 0.0, 0.0, about_joint]
    return np.array([*links, *DRIVE, *VISCOUS, *COULOMB])


def coulomb_nm(inputs: np.ndarray) -> np.ndarray:
    return COULOMB * np.tanh(inputs[:, 2:4] / COULOMB_SPEED_RAD_S)


def swapped(values: np.ndarray) -> np.ndarray:
    """Return columns of two joints in the other order, of each kind of input."""
    return values.reshape(len(values), -1, 2)[:, :, ::-1].reshape(values.shape)


def test_regressor_times_parameters_is_the_torque_with_drives_and_friction() -> None:
    regressor = RigidBodyRegressor(urdf(), JOINTS)
    torque = regressor(X) @ true_parameters()
    expected = TwoLinkArm().inverse_dynamics(*np.split(X, 3, axis=1)) + DRIVE * X[:, 4:] + coulomb_nm(X)
    assert regressor(X).shape == (len(X), 2, regressor.n_parameters) == (len(X), 2, 26)
    np.testing.assert_allclose(torque, expected, atol=1e-12)


def test_wrong_inertias_in_the_urdf_do_not_matter() -> None:
    right, wrong = (RigidBodyRegressor(urdf(scale), JOINTS)(X) for scale in (1.0, 7.0))
    np.testing.assert_array_equal(wrong, right)


def test_joints_may_come_in_another_order_than_in_the_urdf() -> None:
    forwards, backwards = (RigidBodyRegressor(urdf(), joints) for joints in (JOINTS, JOINTS[::-1]))
    parameters = true_parameters()
    other = np.concatenate([parameters[:20], DRIVE[::-1], VISCOUS[::-1], COULOMB[::-1]])
    expected = swapped(forwards(X) @ parameters)
    np.testing.assert_allclose(backwards(swapped(X)) @ other, expected, atol=1e-12)


def test_an_arm_of_one_joint_is_turned_by_its_moment_of_inertia() -> None:
    """The other joint of the URDF stays at zero, and what hangs on it belongs to the one link."""
    alone = RigidBodyRegressor(urdf(), ("shoulder",))
    stretched = np.array([[0.7, 0.0, 0.0, 0.0, 2.0, 0.0]])
    expected = TwoLinkArm().inverse_dynamics(*np.split(stretched, 3, axis=1))[0, 0]
    (m1, m2), (i1, i2) = TwoLinkArm.MASS, TwoLinkArm.INERTIA
    at = TwoLinkArm.LENGTH + TwoLinkArm.CENTRE
    parameters = np.zeros(alone.n_parameters)
    parameters[9] = i1 + m1 * TwoLinkArm.CENTRE**2 + i2 + m2 * at**2
    assert alone.n_parameters == 13
    np.testing.assert_allclose(alone(np.array([[0.7, 0.0, 2.0]])) @ parameters, [[expected]])


def test_a_joint_of_the_urdf_that_is_not_asked_for_stays_at_zero() -> None:
    gripper = """<joint name="finger" type="prismatic"><parent link="forearm"/><child link="finger"/>
      <origin xyz="0.3 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint>
      <link name="finger"/></robot>"""
    with_gripper = RigidBodyRegressor(urdf().replace("</robot>", gripper), JOINTS)
    np.testing.assert_allclose(with_gripper(X), RigidBodyRegressor(urdf(), JOINTS)(X), atol=1e-12)


def test_the_slope_in_an_acceleration_is_that_of_the_regressor() -> None:
    regressor = RigidBodyRegressor(urdf(), JOINTS)
    for joint in (0, 1):
        ahead = X.copy()
        ahead[:, 4 + joint] += 3.0
        slope = (regressor(ahead) - regressor(X)) / 3.0
        np.testing.assert_allclose(regressor.acceleration_slope(X, joint), slope, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "joints", "said"),
    [
        ("", JOINTS, "a URDF with these joints that Pinocchio reads"),
        ("words", JOINTS, "a URDF with these joints that Pinocchio reads"),
        (urdf()[:-20], JOINTS, "a URDF with these joints that Pinocchio reads"),
        (urdf(), ("shoulder", "wrist"), "joints is .wrist."),
        (urdf().replace("revolute", "fixed"), JOINTS, "joints is .shoulder.; expected a movable joint"),
        (urdf().replace("revolute", "floating"), JOINTS, "joints is .shoulder.; expected a movable joint"),
    ],
    ids=["empty", "no_xml", "broken_off", "unknown_joint", "fixed_joints", "floating_joints"],
)
def test_a_urdf_without_the_joints_is_refused_with_what_was_expected(
    text: str, joints: tuple[str, ...], said: str
) -> None:
    with pytest.raises(ConfigError, match=rf"name is 'rigid_body'; expected .*{said}") as error:
        RigidBodyRegressor(text, joints)
    assert error.value.key == "name"
    assert error.value.value == "rigid_body"


def test_without_pinocchio_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(ConfigError, match=r"name is 'rigid_body'; expected .*pip install pin"):
        RigidBodyLearner(context())


def learned(*trials: TrainingSamples) -> RigidBodyLearner:
    learner = RigidBodyLearner(context())
    for samples in trials:
        learner, _ = learner.trained_on(samples, "actual")
    return learner


def test_without_noise_one_figure_teaches_the_torque_of_all_movements() -> None:
    learner = learned(trial(7.0), trial(5.5), trial(4.5))
    for seed in range(3):
        other = random_movement(np.random.default_rng(seed), 3.0)
        wanted = truth_rad(other)
        assert rms(wanted - learner.predict(other)) < 1e-6 * rms(wanted)


def test_one_trial_is_nearly_enough() -> None:
    learner, other = learned(trial(7.0)), random_movement(np.random.default_rng(0), 3.0)
    assert rms(truth_rad(other) - learner.predict(other)) < 1e-4 * rms(truth_rad(other))


def test_the_inertia_of_each_joints_drive_is_learned_beside_that_of_its_link() -> None:
    """A link's inertia acts on all joints below it, that of a rotor on its own joint alone."""
    trials = []
    for duration_s in (7.0, 4.5):
        exact = trial(duration_s)
        trials.append(
            dataclasses.replace(exact, offset_rad=exact.offset_rad + DRIVE * exact.actual[:, 4:] / 15.0)
        )
    learner, other = learned(*trials), random_movement(np.random.default_rng(0), 3.0)
    wanted = truth_rad(other) + DRIVE * other[:, 4:] / 15.0
    assert rms(wanted - learner.predict(other)) < 1e-6 * rms(wanted)


def test_a_learner_from_before_drives_had_an_inertia_answers_as_it_did_and_learns_on() -> None:
    learner = learned(trial(7.0))
    stored = learner.stored()
    drives = [20, 21]
    arrays = {
        name: functools.reduce(lambda a, axis: np.delete(a, drives, axis), range(a.ndim), a)
        if name in ("gram", "moment", "effect", "parameters")
        else a
        for name, a in stored.arrays.items()
    }
    restored = RigidBodyLearner.restored(context(), dataclasses.replace(stored, arrays=arrays))
    parameters = stored.arrays["parameters"].copy()
    parameters[drives] = 0.0
    expected = (RigidBodyRegressor(urdf(), JOINTS)(X) @ parameters + 1.5 * X[:, 2:4]) / 15.0
    np.testing.assert_allclose(restored.predict(X), expected, atol=1e-12)
    restored, _ = restored.trained_on(trial(4.5), "actual")
    assert rms(truth_rad(X) - restored.predict(X)) < 1e-3 * rms(truth_rad(X))


def test_springs_and_dampers_of_the_controller_are_known_not_learned() -> None:
    told = dataclasses.replace(context(), stiffness_nm_per_rad=(30.0, 5.0), damping_nms_per_rad=(0.0, 2.5))
    q, v, a = np.split(trial(5.0).actual, 3, axis=1)
    torque = TwoLinkArm().inverse_dynamics(q, v, a)
    offset = (torque + v * [0.0, 2.5]) / [30.0, 5.0]
    samples = dataclasses.replace(trial(5.0), offset_rad=offset)
    learner, _ = RigidBodyLearner(told).trained_on(samples, "actual")
    np.testing.assert_allclose(learner.predict(samples.actual), offset, atol=1e-5)
    parameters = learner.stored().arrays["parameters"]
    np.testing.assert_allclose(parameters[-4:-2], VISCOUS, atol=1e-3)


def with_noise(
    samples: TrainingSamples, noise_rad_s2: float, seed: int, told: bool = True
) -> TrainingSamples:
    """Return a trial with noise in its accelerations, whose size the learner is told or not."""
    actual = samples.actual.copy()
    actual[:, 4:] += noise_rad_s2 * np.random.default_rng(seed).normal(size=(len(actual), 2))
    known = np.array([0.0, 0.0, 0.0, 0.0, noise_rad_s2, noise_rad_s2]) if told else np.empty(0)
    return dataclasses.replace(samples, actual=actual, input_noise=known)


def shrinkage(noise_rad_s2: float, told: bool) -> np.ndarray:
    """Return the share of each joint's torque that noise in the accelerations of practice has cost."""
    learner = learned(
        *(
            with_noise(trial(duration_s, step=4), noise_rad_s2, seed, told)
            for seed, duration_s in enumerate((6.0, 5.0, 4.5))
        )
    )
    held_out = trial(4.5, first=5)
    answer, wanted = learner.predict(held_out.actual), held_out.offset_rad
    return 1.0 - np.sum(answer * wanted, axis=0) / np.sum(wanted**2, axis=0)


def test_noise_in_accelerations_costs_torque_unless_its_size_is_told() -> None:
    """3 rad/s² is what 1 mrad becomes behind a low-pass of 10 Hz; the shoulder practises with 5 rad/s²."""
    untold, told = (shrinkage(3.0, told=told) for told in (False, True))
    assert untold[0] > 0.1
    assert abs(told[0]) < 0.2 * untold[0]
    assert np.all(np.abs(told) < 0.03)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise_rad_s2", [3.0, 6.0, 12.0])
def test_a_slow_trial_that_sinks_in_its_noise_still_leaves_sensible_answers(
    noise_rad_s2: float, seed: int
) -> None:
    """The joints accelerate by 0.8 and 1.9 rad/s² there: hardly anything is left without the noise."""
    learner = learned(with_noise(trial(11.5, step=2), noise_rad_s2, seed))
    held_out = trial(11.5, first=5)
    assert rms(held_out.offset_rad - learner.predict(held_out.actual)) < 2.0 * rms(held_out.offset_rad)


def test_coulomb_friction_is_learned_beside_viscous_friction() -> None:
    trials = []
    for duration_s in (9.0, 7.0, 5.0):
        exact = trial(duration_s, step=4)
        dry = COULOMB * np.sign(exact.actual[:, 2:4]) / 15.0
        trials.append(dataclasses.replace(exact, offset_rad=exact.offset_rad + dry))
    learner = learned(*trials)
    viscous, coulomb = np.split(learner.stored().arrays["parameters"][-4:], 2)
    # The true sign is steeper than the smooth one that is fitted.
    np.testing.assert_allclose(coulomb, COULOMB, rtol=0.03)
    np.testing.assert_allclose(viscous, VISCOUS, atol=0.01)
    held_out = trials[-1]
    assert rms(held_out.offset_rad - learner.predict(held_out.actual)) < 0.3 * rms(coulomb_nm(X) / 15.0)


MUCH = 10.0
"""Times the usual friction: about half of what the movements need."""


def with_pauses(samples: TrainingSamples, seed: int, told: bool) -> TrainingSamples:
    """Return a trial with dry friction in which each joint sticks for half of the time, now and then.

    What is commanded then is within the friction of what would hold the joint without it, mostly on one side.
    """
    rng = np.random.default_rng(seed)
    n = len(samples.actual)
    stuck = np.column_stack([(np.arange(n) // (n // 20) + k) % 2 == 0 for k in (0, 1)])
    actual = samples.actual.copy()
    actual[:, 2:4][stuck], actual[:, 4:][stuck] = 0.0, 0.0
    held_by = np.where(stuck, rng.uniform(-1.0, 0.2, size=(n, 2)), np.sign(actual[:, 2:4]))
    offset = truth_rad(actual) + MUCH * COULOMB * held_by / 15.0
    sliding = ~stuck if told else np.empty((0, 0), dtype=bool)
    return TrainingSamples(actual=actual, desired=actual, offset_rad=offset, sliding=sliding)


def error_after_pauses(told: bool) -> float:
    """Return the error on other movements after practice with pauses, as a share of the truth."""
    learner = learned(*(with_pauses(trial(t, step=4), k, told) for k, t in enumerate((9.0, 7.0, 5.0))))
    wanted = truth_rad(X) + MUCH * coulomb_nm(X) / 15.0
    return rms(wanted - learner.predict(X)) / rms(wanted)


def test_what_holds_a_joint_that_sticks_is_not_taken_for_its_dynamics() -> None:
    untold, told = error_after_pauses(told=False), error_after_pauses(told=True)
    assert untold > 0.03
    assert told < 0.3 * untold


def test_without_dry_friction_samples_at_rest_are_learned_from_all_the_same() -> None:
    exact = trial(5.0)
    sliding = np.abs(exact.actual[:, 2:4]) > 0.05
    learner = learned(dataclasses.replace(exact, sliding=sliding))
    assert np.all(learner.stuck_trust > 0.1)
    other = random_movement(np.random.default_rng(0), 3.0)
    assert rms(truth_rad(other) - learner.predict(other)) < 1e-4 * rms(truth_rad(other))


def test_movements_that_practice_has_not_shown_are_less_certain() -> None:
    """With the elbow at rest, what it needs to be moved stays unknown."""
    exact = trial(5.0)
    still = exact.actual.copy()
    still[:, [1, 3, 5]] = [1.3, 0.0, 0.0]
    offset = truth_rad(still) + 1e-3 * np.random.default_rng(0).normal(size=(len(still), 2))
    learner = learned(TrainingSamples(still, still, offset))
    known, unknown = learner.std(still).mean(axis=0), learner.std(exact.actual).mean(axis=0)
    assert unknown[0] > 3.0 * known[0]
