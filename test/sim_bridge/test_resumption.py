"""Going on with an interrupted run: nothing of it is lost, and what comes is as if nothing had happened."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_run import record_run

from sim_bridge.arm import SimulatedArm
from sim_bridge.resuming import replay_arm
from tel_lab.offline import OfflinePractice
from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.practice.movement_path import forecast_trajectory
from tel_ros.core.practice.session import PracticeSession
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, Movement, PlannedTrial
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network
from tel_ros.recording.resumption import RecordedNetwork, earlier_trials, prepare_to_resume, resumed_config
from tel_ros.recording.run_folder import (
    NETWORK_FILE,
    SUMMARY_FILE,
    network_after,
    read_summary,
    run_lock,
    trial_bag,
    trial_bags,
    write_summary,
)
from tel_ros.recording.trial_bag import read_arm_record, read_topic
from tel_ros.recording.waypoint_file import load_path

PLANAR_ARM = Path(__file__).parents[2] / "config" / "planar_arm.yaml"
OVERRIDES = (
    *("practice.first_duration_s=4.0", "practice.goal_duration_s=3.0", "control.approach_speed_rad_s=1.5"),
    *("practice.trials=3", "practice.tolerance_rad=0.001", "practice.step_tolerance_rad=0.02"),
    *("learning.gaussians_per_input=5", "control.settle_time_s=0.2"),
    *("control.rate_hz=250", "sim.physics_rate_hz=1000"),
    # What is on its way, and what is random, has to go on as well.
    *("sim.command_delay_s=0.008", "sim.position_noise_rad=0.0001"),
)
EQUAL = ("index", "alpha", "reason", "expected_rms_rad", "training_rms_after_rad", "grown", "outcome")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a run that was not interrupted, made once for each storage: ``runs("sqlite3")``."""

    @cache
    def made(storage: str) -> Path:
        folder = tmp_path_factory.mktemp(storage) / "run"
        record_run(folder, load_config(PLANAR_ARM, [*OVERRIDES, f"recording.storage={storage}"]))
        return folder

    return made


@pytest.fixture
def whole(request: pytest.FixtureRequest, runs: Callable[[str], Path]) -> Path:
    """The run that was not interrupted. Tests only look at it."""
    return runs(getattr(request, "param", "mcap"))


@pytest.fixture
def interrupted(whole: Path, tmp_path: Path) -> Callable[..., Path]:
    """Copy the run as if it had been killed: ``interrupted(bags=2, rows=1)``."""

    def cut(bags: int, rows: int, outcome: str = "running") -> Path:
        run = Path(shutil.copytree(whole, tmp_path / "run"))
        for bag in trial_bags(run)[bags:]:
            shutil.rmtree(bag)
        for index in range(rows + 1, 4):
            network_after(run, index).unlink()
        shutil.copy(network_after(run, rows), run / NETWORK_FILE)
        summary = read_summary(run)
        write_summary(run, {**summary, "outcome": outcome, "message": "", "trials": summary["trials"][:rows]})
        if rows == 0:
            (run / SUMMARY_FILE).unlink()
        return run

    return cut


def rows_of(run: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = read_summary(run)["trials"]
    return rows


def records(run: Path) -> Iterator[tuple[Any, Any]]:
    return (read_arm_record(bag, topics.EFFORT_COMMANDS) for bag in trial_bags(run))


def made_arm(config: Config) -> SimulatedArm:
    return SimulatedArm(config.arm, config.sim, rate_hz=config.control.rate_hz, seed=config.seed)


@pytest.mark.parametrize(
    ("whole", "bags", "rows"),
    [("mcap", 0, 0), ("mcap", 1, 1), ("mcap", 2, 1), ("mcap", 2, 2), ("sqlite3", 2, 1)],
    indirect=["whole"],
)
def test_rows_and_networks_are_those_of_the_run_without_interruption(
    whole: Path, interrupted: Callable[..., Path], bags: int, rows: int
) -> None:
    """With fewer rows than bags it was killed between the end of a trial and the end of its lesson."""
    run = interrupted(bags, rows)
    resumption = prepare_to_resume(run, resumed_config(run))
    assert resumption.trials == bags
    summary = read_summary(run)
    assert summary["outcome"] == "running"
    without_wall_clock = [{**row, "wall_s": None} for row in rows_of(whole)[:bags]]
    assert [{**row, "wall_s": None} for row in summary["trials"]] == without_wall_clock
    for index in range(bags + 1):
        assert network_after(run, index).read_bytes() == network_after(whole, index).read_bytes()
    assert bags == 0 or (run / NETWORK_FILE).read_bytes() == network_after(whole, bags).read_bytes()


@pytest.mark.parametrize("bags", [0, 2])
def test_the_strategy_goes_on_with_what_it_had_decided(
    whole: Path, interrupted: Callable[..., Path], bags: int
) -> None:
    run = interrupted(bags, bags)
    earlier = earlier_trials(run, resumed_config(run))
    plan = earlier.session.next()
    assert isinstance(plan, PlannedTrial)
    expected = rows_of(whole)[bags]
    assert (plan.index, plan.alpha, plan.reason) == (
        expected["index"],
        expected["alpha"],
        expected["reason"],
    )
    assert expected["expected_rms_rad"] in (None, plan.expected_rms_rad)


def test_forecasts_are_equal_to_the_last_bit_whether_the_network_is_in_a_file_or_in_memory(
    whole: Path,
) -> None:
    config = resumed_config(whole)
    path, movement = load_path(config.path, config.arm), Movement(3.5)
    in_memory = OfflinePractice(config, path, load_network(network_after(whole, 1)))
    in_file = RecordedNetwork(whole, config)
    in_file.load(1)
    found, again = (
        PracticeSession(config, path, None, make_strategy(config), None, network).forecast(movement)
        for network in (in_memory, in_file)
    )
    in_memory.arm.plant.close()
    np.testing.assert_array_equal(found.effort_nm, again.effort_nm)
    np.testing.assert_array_equal(found.std_rad, again.std_rad)
    # As the graph does: from equilibrium points, and the rounding of that has its share in decisions.
    desired = forecast_trajectory(path, None, movement)
    equilibrium_rad = in_memory.predict(desired).equilibrium_rad
    stiffness, damping = (
        np.array(values) for values in (config.arm.stiffness_nm_per_rad, config.arm.damping_nms_per_rad)
    )
    expected_nm = stiffness * (equilibrium_rad - desired.position_rad) - damping * desired.velocity_rad_s
    np.testing.assert_array_equal(found.effort_nm, expected_nm)


def test_a_network_that_was_gone_back_to_is_not_the_one_learned_meanwhile(whole: Path) -> None:
    config = resumed_config(whole)
    desired = forecast_trajectory(load_path(config.path, config.arm), None, Movement(3.5))
    network = RecordedNetwork(whole, config)
    before = network.predict(desired).equilibrium_rad
    network.train(trial_bag(whole, 1))
    network.save(1)
    assert not np.array_equal(network.predict(desired).equilibrium_rad, before)
    network.load(0)
    np.testing.assert_array_equal(network.predict(desired).equilibrium_rad, before)


def test_the_simulated_arm_is_where_it_was_bit_by_bit(whole: Path, interrupted: Callable[..., Path]) -> None:
    """Sensors, their noise and commands on their way included: it goes on equally with the third trial."""
    run = interrupted(2, 2)
    new_arm = partial(made_arm, resumed_config(run))
    arm, offset_ns = replay_arm(new_arm, records(run))
    assert offset_ns == 0
    third = trial_bag(whole, 3)
    states = dict(read_topic(third, topics.JOINT_STATES))
    for time_ns, command in read_topic(third, topics.EFFORT_COMMANDS):
        assert arm.time_ns == time_ns
        assert list(arm.reading().position_rad) == states[time_ns].position.tolist()
        assert list(arm.reading().velocity_rad_s) == states[time_ns].velocity.tolist()
        arm.step(command.data)
    arm.close()


def test_an_arm_that_does_not_follow_the_records_rests_where_it_was_last(whole: Path) -> None:
    """A heavier one, say: an arm that has coasted, or one in real time, does not follow them either."""
    config = load_config(PLANAR_ARM, [*OVERRIDES, "sim.inertia_scale=1.2"])
    arm, offset_ns = replay_arm(partial(made_arm, config), records(whole))
    last_ns, last = read_topic(trial_bag(whole, 3), topics.JOINT_STATES)[-1]
    assert offset_ns + arm.time_ns == last_ns
    assert arm.true_position_rad == pytest.approx(last.position.tolist(), abs=1e-9)
    assert arm.true_velocity_rad_s == (0.0, 0.0)
    arm.close()


@pytest.mark.parametrize("whole", ["mcap", "sqlite3"], indirect=True)
def test_what_a_crash_has_left_is_set_aside_and_told(interrupted: Callable[..., Path]) -> None:
    run = interrupted(2, 2)
    left = run / UNFINISHED / "trial_003"
    left.mkdir(parents=True)
    (left / "trial_003.mcap").write_bytes(b"half a trial")
    resumption = prepare_to_resume(run, resumed_config(run))
    (kept,) = resumption.set_aside
    assert (kept / "trial_003.mcap").read_bytes() == b"half a trial"
    assert resumption.set_aside[kept] == "was never closed"
    assert not (run / UNFINISHED).exists()
    # Once more: the name is taken.
    left.mkdir(parents=True)
    assert prepare_to_resume(run, resumed_config(run)).set_aside.keys() == {kept.with_name("trial_003.2")}
    assert (kept / "trial_003.mcap").read_bytes() == b"half a trial"


def test_a_damaged_last_bag_is_set_aside_and_its_trial_is_done_again(
    interrupted: Callable[..., Path],
) -> None:
    run = interrupted(2, 2)
    (trial_bag(run, 2) / "metadata.yaml").unlink()
    resumption = prepare_to_resume(run, resumed_config(run))
    assert resumption.trials == 1
    assert list(resumption.set_aside.values()) == ["has no metadata.yaml: it was never closed"]
    assert [row["index"] for row in rows_of(run)] == [1]


def test_a_damaged_bag_before_the_last_is_refused_and_nothing_is_moved(
    interrupted: Callable[..., Path],
) -> None:
    run = interrupted(2, 2)
    (trial_bag(run, 1) / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"trial_001: has no metadata\.yaml.*another one follows"):
        prepare_to_resume(run, resumed_config(run))
    assert trial_bag(run, 2).exists()
    assert len(rows_of(run)) == 2


def test_a_finished_run_is_refused(whole: Path) -> None:
    before = (whole / SUMMARY_FILE).read_bytes()
    with pytest.raises(InputFileError, match=r"the run is finished: \w+, 3 trials"):
        prepare_to_resume(whole, resumed_config(whole))
    assert (whole / SUMMARY_FILE).read_bytes() == before


def test_a_run_whose_last_lesson_was_interrupted_is_not_finished(
    interrupted: Callable[..., Path], whole: Path
) -> None:
    run = interrupted(3, 2)
    prepare_to_resume(run, resumed_config(run))
    assert (run / NETWORK_FILE).read_bytes() == (whole / NETWORK_FILE).read_bytes()
    earlier = earlier_trials(run, resumed_config(run))
    assert isinstance(earlier.session.next(), Ending)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"has no run\.yaml; expected the folder of a practice run"):
        resumed_config(tmp_path)


def test_bags_that_are_not_of_this_configuration_are_refused(interrupted: Callable[..., Path]) -> None:
    run = interrupted(2, 2)
    config = resumed_config(run)
    file = run / "run.yaml"
    file.write_text(file.read_text().replace("first_duration_s: 4.0", "first_duration_s: 5.0"))
    assert resumed_config(run) != config
    with pytest.raises(BagError, match=r"trial_001: has α 0\.75, but the strategy plans α 0\.6 there"):
        prepare_to_resume(run, resumed_config(run))


def test_a_summary_that_tells_other_things_than_the_bags_is_refused(interrupted: Callable[..., Path]) -> None:
    run = interrupted(2, 2)
    summary = read_summary(run)
    summary["trials"][1]["rms_error_rad"] = 0.5
    (run / SUMMARY_FILE).write_text(json.dumps(summary))
    with pytest.raises(InputFileError, match=r"tells of trial 2 that rms_error_rad is 0\.5; expected 0\.0"):
        prepare_to_resume(run, resumed_config(run))


def test_one_practice_at_a_time_in_a_folder(whole: Path) -> None:
    with (
        run_lock(whole),
        pytest.raises(InputFileError, match="a practice run is under way in it"),
        run_lock(whole),
    ):
        pytest.fail("two at a time")
    with run_lock(whole):
        pass  # it has been given free
