"""Whole practice runs as a user starts them: ``tel practice`` over DDS, one process a node."""

from __future__ import annotations

import dataclasses
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from graph_harness import PATIENT, QUICK, SHORT, TelProcess, summary_of, wait_until
from rosbags.highlevel import AnyReader

from tel_ros.core.trial import Outcome
from tel_ros.recording import topics
from tel_ros.recording.network_file import load_network
from tel_ros.recording.trial_bag import read_trial

Tel = Callable[..., TelProcess]
pytestmark = pytest.mark.timeout(150)

STOOD_STILL_S = 0.05
PERIOD_NS = 2_000_000
LONG_TRIAL = (
    *(*QUICK, "practice.trials=1", "practice.first_duration_s=60.0"),
    # Without its arm the controller waits for so long before it gives up braking.
    "sim.lockstep_timeout_s=3.0",
)
"""Whoever does something in mid-trial has seconds for it, also where this process waits for a core."""
LONG_SECOND_TRIAL = (*LONG_TRIAL, "practice.trials=2", "practice.durations_s=[3.5, 60.0]")
NODES = ["sim_bridge", "ep_controller", "inverse_dynamics", "trial_recorder", "practice_manager"]


def recorded(bag: Path, topic: str) -> list[tuple[int, bytes]]:
    """Return time and content of a topic's messages, serialised anew: padding is not set to anything."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == topics.absolute(topic)]
        assert connections  # without any, all messages would come
        store = reader.typestore
        return [
            (time_ns, bytes(store.serialize_cdr(store.deserialize_cdr(raw, c.msgtype), c.msgtype)))
            for c, time_ns, raw in reader.messages(connections=connections)
        ]


def what_repeats(summary: dict[str, Any]) -> dict[str, Any]:
    """Return a summary without name, wall clock and versions: somebody may commit between two runs."""
    rows = [{key: value for key, value in row.items() if key != "wall_s"} for row in summary["trials"]]
    config = {key: value for key, value in summary["config"].items() if key != "versions"}
    return {**summary, "config": config, "trials": rows, "run": None}


def test_a_practice_run_learns_and_leaves_whole_bags_a_network_and_a_summary(whole_run: TelProcess) -> None:
    run = whole_run
    code, out, err = run.finish()
    assert code == 0, err
    summary = summary_of(out)
    rows = summary["trials"]
    assert summary["outcome"] == "completed"
    assert [row["duration_s"] for row in rows] == [4.0, 3.5]
    # One trial teaches enough to more than halve the error, although the next trial is faster.
    assert rows[1]["rms_error_rad"] < 0.5 * rows[0]["rms_error_rad"]
    for row in rows:
        assert row["timing"] is None  # in lockstep how long a tick took says nothing
        trial = read_trial(run.folder / row["bag"])
        assert trial.report.timing is None
        error = trial.position_rad[trial.run] - trial.desired[trial.run, :2]
        assert np.sqrt(np.mean(error**2)) == pytest.approx(row["rms_error_rad"], rel=1e-9)
        assert len(trial.time_ns) == row["ticks"]
        assert row["training_rms_after_rad"] < row["training_rms_before_rad"]
    assert load_network(run.folder / "network" / "network.npz").trials_learned == 2
    assert run.left_behind() == []
    assert not (run.folder / ".unfinished").exists()


def test_two_runs_of_a_configuration_are_bit_identical_with_either_executor(
    whole_run: TelProcess, tel: Tel
) -> None:
    first = whole_run
    code_1, out_1, err_1 = first.finish()
    second = tel(*SHORT, name="second", TEL_ROS_PLAIN_EXECUTOR="1")
    code_2, out_2, err_2 = second.finish()
    assert (code_1, code_2) == (0, 0), err_1 + err_2
    assert what_repeats(summary_of(out_1)) == what_repeats(summary_of(out_2))
    for name in ("trial_001", "trial_002"):
        for topic in (*topics.RECORDED_LIVE, topics.EFFORT_COMMANDS):
            assert recorded(first.folder / name, topic) == recorded(second.folder / name, topic), topic


@pytest.mark.realtime
@pytest.mark.timeout(300)
def test_the_same_graph_runs_in_real_time(tel: Tel) -> None:
    three_s = ("practice.first_duration_s=3.0", "practice.goal_duration_s=3.0")
    wanted = ("sim.clock=realtime", "practice.trials=1", "control.path_tolerance_rad=2.0", *three_s, *PATIENT)
    for attempt in range(3):
        run = tel(*wanted, name=f"attempt_{attempt}")
        code, out, err = run.finish()
        assert out, err
        row = summary_of(out)["trials"][0]
        # The arm does not wait for a machine that stands still, and may be anywhere afterwards.
        stood_still = row["timing"] is None or row["timing"]["jitter_max_s"] >= STOOD_STILL_S
        if row["outcome"] == "completed" or not stood_still:
            break
    assert code == 0, err
    assert row["outcome"] == "completed"
    trial = read_trial(run.folder / row["bag"])
    assert trial.report.timing is not None
    assert row["timing"] == dataclasses.asdict(trial.report.timing)
    # As many periods as the stamps say have gone by, answered or missed, and no more arrived than there were.
    periods = round((trial.time_ns[-1] - trial.time_ns[0]) / PERIOD_NS) + 1
    assert row["ticks"] + trial.report.timing.missed_ticks == periods
    assert 0.0 < trial.report.timing.response_p99_s <= trial.report.timing.response_max_s
    moved_s = (trial.time_ns[trial.run][-1] - trial.time_ns[trial.run][0]) * 1e-9
    assert moved_s == pytest.approx(3.0, abs=0.05 + trial.report.timing.jitter_max_s)


@pytest.mark.parametrize(("victim", "trial"), [*((node, 1) for node in NODES[:-1]), (NODES[-1], 2)])
def test_a_killed_node_ends_the_run_with_its_name_and_leaves_no_process(
    tel: Tel, victim: str, trial: int
) -> None:
    run = tel(*(LONG_TRIAL if trial == 1 else LONG_SECOND_TRIAL))
    nodes = run.wait_until_moving(trial)
    assert sorted(nodes) == sorted(NODES)
    nodes[victim].kill()
    code, _, err = run.finish()
    assert code == 3
    assert f"node {victim} was killed by SIGKILL" in err
    assert run.left_behind() == []
    assert trial == 1 or read_trial(run.folder / "trial_001").report.index == 1
    unfinished = run.folder / f"trial_00{trial}"
    assert not unfinished.exists() or read_trial(unfinished).report.outcome != Outcome.COMPLETED


def test_no_node_outlives_a_killed_supervisor(tel: Tel) -> None:
    run = tel(*QUICK)
    run.wait_until_moving(trial=1)
    run.process.kill()
    run.process.communicate(timeout=10.0)
    wait_until(lambda: run.left_behind() == [], 15.0, "the end of all nodes")


def test_a_run_whose_arm_leaves_its_path_tolerance_ends_with_the_reason(tel: Tel) -> None:
    run = tel(*QUICK, "control.path_tolerance_rad=0.1")
    code, out, err = run.finish()
    assert code == 1
    summary = summary_of(out)
    assert summary["outcome"] == "aborted"
    assert "off its desired position (path tolerance 0.100 rad)" in summary["trials"][0]["message"]
    assert "path tolerance" in err
    trial = read_trial(run.folder / "trial_001")  # the bag of an aborted trial is whole, too
    assert np.abs(trial.velocity_rad_s[-1]).max() < 0.1  # and its end shows the arm at rest


def test_a_second_graph_is_refused_before_anything_moves_and_an_interrupted_one_brings_the_arm_to_rest(
    tel: Tel,
) -> None:
    # However slowly this machine runs two graphs at once, the first one waits, and is not done before; and
    # however fast, no trial is over before the signal comes.
    long = ("practice.trials=40", "practice.first_duration_s=60.0", "practice.goal_duration_s=30.0")
    first = tel(*QUICK, *long, "sim.lockstep_timeout_s=30.0", name="first")
    first.wait_until_moving(trial=1)
    second = tel(*QUICK, name="second")
    code, out, err = second.finish()
    assert code == 2
    assert out == ""
    assert f"ROS_DOMAIN_ID is '{os.environ['ROS_DOMAIN_ID']}'" in err
    assert "without a running graph (found" in err
    assert not second.folder.exists()

    log = first.folder / "log" / "ep_controller.log"
    under_way = log.read_text().count("trial ")  # the signal comes in mid-trial
    wait_until(lambda: log.read_text().count("trial ") > under_way, 60.0, "a trial")
    time.sleep(0.3)
    first.process.send_signal(signal.SIGINT)
    code, _, err = first.finish()
    assert code == 130
    assert "interrupted" in err
    assert first.left_behind() == []
    assert ": CANCELLED" in log.read_text()  # only said once the arm is at rest


def test_an_external_arm_that_is_not_there_is_reported_and_nothing_simulated_starts(tel: Tel) -> None:
    run = tel(*QUICK, "run.arm=external", "run.arm_timeout_s=2.0")
    started = time.monotonic()
    wait_until(lambda: len(run.nodes()) >= 4 or run.process.poll() is not None, 30.0, "the nodes")
    names = set(run.nodes())
    code, _, err = run.finish()
    assert code == 3
    assert "the arm is not there" in err and "/joint_states" in err
    assert "sim_bridge" not in names
    assert time.monotonic() - started < 60.0
    assert run.left_behind() == []


def test_a_value_that_only_a_node_can_refuse_is_bad_input_as_well(tel: Tel) -> None:
    run = tel(*QUICK, "sim.initial_position_rad=[3.5, 0.0]")  # outside the range that the URDF gives
    code, _, err = run.finish()
    assert code == 2
    assert "sim.initial_position_rad is [3.5, 0.0]; expected one value in rad a joint" in err
    assert run.left_behind() == []
