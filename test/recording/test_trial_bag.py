"""Reading a trial back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from synthetic_trial import JOINTS, METADATA, SyntheticTrial

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, counted
from tel_ros.core.learning.signals import learning_record
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Outcome, Phase
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import TrialBagWriter
from tel_ros.recording.config_file import dump_config
from tel_ros.recording.shared_files import share_folder
from tel_ros.recording.trial_bag import read_trial


def std_of(trial: SyntheticTrial, n_points: int = 0) -> np.ndarray:
    """Return standard deviations for the points of a trial's goal, no two of them alike."""
    n_points = n_points or len(trial.time_ns)
    return 0.001 * (1.0 + np.arange(2 * n_points).reshape(-1, 2))


def test_a_trial_comes_back_bit_by_bit(trial_bag: Path, trial: SyntheticTrial) -> None:
    found, n = read_trial(trial_bag), trial.n
    desired = [f"desired_{name}" for name in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")]
    np.testing.assert_array_equal(found.desired, np.hstack([trial.values[name][:n] for name in desired]))
    for name in ("equilibrium_rad", "position_rad", "velocity_rad_s", "effort_nm"):
        np.testing.assert_array_equal(getattr(found, name), trial.values[name][:n])
    np.testing.assert_array_equal(found.time_ns, trial.time_ns[:n])
    np.testing.assert_array_equal(found.phase, trial.phase[:n])
    np.testing.assert_array_equal(found.saturated, trial.saturated[:n])
    assert (found.bag, found.joints, found.report.index, found.report.duration_s) == (
        trial_bag,
        JOINTS,
        3,
        9.0,
    )
    assert (found.report.outcome, found.report.message, dict(found.metadata)) == (
        Outcome.COMPLETED,
        "",
        METADATA,
    )


def test_an_aborted_trial_says_so(tmp_path: Path) -> None:
    bag = SyntheticTrial(outcome=1, message="elbow is off").write(tmp_path / "bag")
    found = read_trial(bag)
    assert (found.report.outcome, found.report.message) == (Outcome.ABORTED, "elbow is off")


def test_time_counts_from_the_first_tick_of_run(trial_bag: Path, trial: SyntheticTrial) -> None:
    found = read_trial(trial_bag)
    first = int(np.argmax(trial.phase == Phase.RUN))
    np.testing.assert_allclose(found.time_s, (np.arange(trial.n) - first) * 0.002, atol=1e-12)
    np.testing.assert_array_equal(found.run, trial.phase[: trial.n] == Phase.RUN)


def test_the_signals_leave_out_the_way_to_the_start(trial_bag: Path, trial: SyntheticTrial) -> None:
    signals = learning_record(read_trial(trial_bag))
    kept = trial.phase[: trial.n] != Phase.APPROACH
    np.testing.assert_array_equal(signals.time_ns, trial.time_ns[: trial.n][kept])
    np.testing.assert_array_equal(signals.position_rad, trial.values["position_rad"][: trial.n][kept])
    np.testing.assert_array_equal(signals.equilibrium_rad, trial.values["equilibrium_rad"][: trial.n][kept])
    np.testing.assert_array_equal(signals.run, trial.phase[: trial.n][kept] == Phase.RUN)
    np.testing.assert_array_equal(signals.saturated, trial.saturated[: trial.n][kept])


def test_the_networks_std_comes_back_for_the_ticks_of_run(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.std_rad = std_of(trial)
    trial.std_rad[5] = np.inf, 0.5
    found = read_trial(trial.write(tmp_path / "bag"))
    n_run = np.count_nonzero(trial.phase[: trial.n] == Phase.RUN)
    assert n_run > 5
    np.testing.assert_array_equal(found.command_std_rad, trial.std_rad[:n_run])


def test_beyond_the_trajectory_its_last_std_holds(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.n_points = 4
    trial.std_rad = std_of(trial, 4)
    found = read_trial(trial.write(tmp_path / "bag")).command_std_rad
    np.testing.assert_array_equal(found[:4], trial.std_rad)
    assert len(found) > 4
    np.testing.assert_array_equal(found[4:], np.broadcast_to(trial.std_rad[3], found[4:].shape))


def test_without_a_std_nothing_is_known(trial_bag: Path, trial: SyntheticTrial) -> None:
    n_run = np.count_nonzero(trial.phase[: trial.n] == Phase.RUN)
    np.testing.assert_array_equal(read_trial(trial_bag).command_std_rad, np.full((n_run, 2), np.inf))


def test_a_bag_from_before_goals_had_a_std_is_read(
    tmp_path: Path, trial: SyntheticTrial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag carries the definitions of its messages: its goal has no such field."""
    kind = topics.RECORDED_ONCE[topics.TRIAL_GOAL]
    older = types_without_std()
    monkeypatch.setattr("tel_ros.recording.bag_format.typestore", lambda: older)
    with TrialBagWriter(tmp_path / "bag", {}) as writer:
        for topic, time_ns, data in trial.messages():
            if topic == topics.TRIAL_GOAL:
                goal = vars(typestore().deserialize_cdr(data, kind))
                newer = ("std_rad", "stiffness_nm_per_rad", "damping_nms_per_rad", "__msgtype__")
                fields = {name: value for name, value in goal.items() if name not in newer}
                data = bytes(older.serialize_cdr(older.types[kind](**fields), kind))
            writer.write(topic, time_ns, data)
    found = read_trial(tmp_path / "bag")
    assert len(found.command_std_rad) > 0
    assert np.isposinf(found.command_std_rad).all()
    assert found.springs is None


def types_without_std() -> Typestore:
    """Return the types of bags as they were when a goal had neither ``std_rad`` nor springs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (share_folder("tel_interfaces") / "msg").glob("*.msg"):
        newer = ("std_rad", "stiffness_nm_per_rad", "damping_nms_per_rad")
        lines = file.read_text(encoding="utf-8").splitlines()
        lines = [line for line in lines if not any(name in line for name in newer)]
        store.register(get_types_from_msg("\n".join(lines), f"tel_interfaces/msg/{file.stem}"))
    return store


def test_a_trial_with_the_configured_springs_has_no_others(trial_bag: Path) -> None:
    assert read_trial(trial_bag).springs is None


def test_the_springs_of_a_trial_come_back_and_what_they_did_is_learned(
    tmp_path: Path, trial: SyntheticTrial, config: Config
) -> None:
    configured = Springs.of(config.arm)
    used = configured.scaled(4.0)
    trial.springs = (tuple(used.stiffness_nm_per_rad), tuple(used.damping_nms_per_rad))
    found = read_trial(trial.write(tmp_path / "bag", METADATA | {"config": dump_config(config)}))
    assert found.springs is not None
    for springs, expected in ((found.springs.used, used), (found.springs.configured, configured)):
        np.testing.assert_array_equal(springs.stiffness_nm_per_rad, expected.stiffness_nm_per_rad)
        np.testing.assert_array_equal(springs.damping_nms_per_rad, expected.damping_nms_per_rad)
    kept = trial.phase[: trial.n] != Phase.APPROACH
    u, q, v = (
        trial.values[name][: trial.n][kept] for name in ("equilibrium_rad", "position_rad", "velocity_rad_s")
    )
    k, b = configured.stiffness_nm_per_rad, configured.damping_nms_per_rad
    exerted = 4.0 * k * (u - q) - 2.0 * b * v
    np.testing.assert_allclose(learning_record(found).equilibrium_rad, q + (exerted + b * v) / k, atol=1e-12)
    np.testing.assert_array_equal(found.equilibrium_rad, trial.values["equilibrium_rad"][: trial.n])


@pytest.mark.parametrize(
    "springs",
    [((60.0,), (3.0,)), ((60.0, 60.0), ()), ((), (3.0, 3.0)), ((60.0, -1.0), (3.0, 3.0))],
    ids=["too few", "no damping", "no stiffness", "negative"],
)
def test_springs_that_do_not_fit_are_refused(
    tmp_path: Path, trial: SyntheticTrial, config: Config, springs: tuple[tuple[float, ...], ...]
) -> None:
    trial.springs = springs  # type: ignore[assignment]
    bag = trial.write(tmp_path / "bag", METADATA | {"config": dump_config(config)})
    with pytest.raises(BagError, match="bag: does not tell how stiff its springs were"):
        read_trial(bag)


def test_springs_without_the_configured_ones_are_refused(tmp_path: Path, trial: SyntheticTrial) -> None:
    trial.springs = ((60.0, 60.0), (3.0, 3.0))
    with pytest.raises(BagError, match="and the configuration in the metadata"):
        read_trial(trial.write(tmp_path / "bag"))


@pytest.mark.parametrize("n", [1, 249, 251, 500])
def test_a_std_of_another_length_is_refused(tmp_path: Path, trial: SyntheticTrial, n: int) -> None:
    trial.std_rad = np.full(n, 0.01)
    said = (
        f"bag: its goal holds {counted(n, 'value')} in std_rad; expected nothing, or one value for each of "
        "the 125 points and 2 joints"
    )
    with pytest.raises(BagError, match=said):
        read_trial(trial.write(tmp_path / "bag"))
