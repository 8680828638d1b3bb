"""Whole practice runs as a user starts them: ``tel practice`` over DDS, one process a node."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from graph_harness import Graph
from rosbags.highlevel import AnyReader
from tel_process import (
    HANG_S,
    PAPER,
    PATIENT,
    PRIORITY,
    QUICK,
    StartTel,
    TelProcess,
    own_domain,
    summary_of,
    tel_here,
    tel_practice,
    wait_until,
)

from tel_ros.app.errors import EXIT_BAD_INPUT, GraphError
from tel_ros.core.trial import Outcome
from tel_ros.recording import topics
from tel_ros.recording.network_file import load_network
from tel_ros.recording.run_folder import NETWORK_FILE
from tel_ros.recording.trial_bag import read_trial

StartGraph = Callable[..., Graph]

STOOD_STILL_S = 0.05
PERIOD_NS = 2_000_000
LONG_TRIAL = (*QUICK, "sim.lockstep_timeout_s=3.0")
"""Without its arm the controller waits for so long before it gives up braking."""
NOISY = (
    *(*QUICK, "practice.trials=2", "practice.goal_duration_s=3.5"),
    *("sim.position_noise_rad=0.0001", "sim.command_delay_s=0.01"),
    *("learning.gaussians_per_input=5", "learning.weights=least_squares"),
)
"""With noise, so that a run goes on as without only if all of its state does."""
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


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TelProcess]:
    """Return a finished run, of which only the live view was killed; whoever looks at one shares it."""
    view = ("--view",) if find_spec("viser") else ()
    with own_domain(), tel_practice(tmp_path_factory.mktemp("whole")) as start:
        run = start(*NOISY, more=view, TEL_ROS_PLAIN_EXECUTOR="1")
        if view:
            wait_until(lambda: "main" in run.nodes(), "the view")
            wait_until(lambda: run.nodes()["main"].nice() >= 10, "a view that lets the others go first")
            run.nodes()["main"].kill()
        run.finish()
        yield run


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
    assert load_network(run.folder / NETWORK_FILE).trials_learned == 2
    assert run.left_behind() == []
    assert not (run.folder / ".unfinished").exists()
    said = (run.folder / "log" / "practice_manager.log").read_text().splitlines()
    assert len(said) == 2 and said[1].endswith("completed")  # and no complaints at the end


def test_a_run_killed_in_mid_trial_goes_on_and_ends_as_without_bit_for_bit_and_with_either_executor(
    whole_run: TelProcess, tel: StartTel, ros_domains: Iterator[int]
) -> None:
    code, out, err = whole_run.finish()
    assert code == 0, err
    expected = summary_of(out)

    killed = tel(*NOISY, name="killed")
    killed.wait_until_moving(trial=2)
    killed.kill()
    killed.process.communicate(timeout=HANG_S)
    wait_until(lambda: killed.left_behind() == [], "the end of all nodes")
    assert not (killed.folder / "trial_002").exists()

    resume = ["practice", "--resume", str(killed.folder), "--no-report", "--json"]
    # Others take a process that was killed for a living one for many seconds: hence another domain.
    resumed = TelProcess(resume, killed.folder, {"ROS_DOMAIN_ID": str(next(ros_domains))})
    code, out, err = resumed.finish()
    assert code == 0, err
    assert "after 1 whole trial" in err
    assert (killed.folder / "set_aside" / "trial_002").is_dir()
    found = summary_of(out)
    for summary in (found, expected):
        del summary["run"]
        del summary["config"]["versions"]  # somebody may commit between the runs
        for row in summary["trials"]:
            del row["wall_s"]
    assert found == expected
    network = (killed.folder / NETWORK_FILE).read_bytes()
    assert network == (whole_run.folder / NETWORK_FILE).read_bytes()
    for topic in (*topics.RECORDED_LIVE, topics.EFFORT_COMMANDS):
        in_both = [recorded(run.folder / "trial_001", topic) for run in (killed, whole_run)]
        assert in_both[0] == in_both[1], topic

    code, out, err = tel_here(*resume)
    assert (code, out) == (2, "")
    assert "the run is finished: completed, 2 trials" in err


@pytest.mark.parametrize("more", [[str(PAPER)], ["--set", "seed=2"], ["--out", "elsewhere"]], ids=" ".join)
def test_a_run_goes_on_as_it_was_begun(tmp_path: Path, more: list[str]) -> None:
    code, out, err = tel_here("practice", "--resume", str(tmp_path), *more)
    assert (code, out) == (2, "")
    assert "given with --resume; expected" in err


@pytest.mark.realtime
def test_the_same_graph_runs_in_real_time(tel: StartTel) -> None:
    three_s = ("practice.first_duration_s=3.0", "practice.goal_duration_s=3.0")
    wanted = ("sim.clock=realtime", "practice.trials=1", "control.path_tolerance_rad=2.0", *three_s)
    for attempt in range(3):
        run = tel(*wanted, *PATIENT, *PRIORITY, name=f"attempt_{attempt}")
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


@pytest.mark.parametrize(("victim", "trial"), [("ep_controller", 1), ("practice_manager", 2)])
def test_a_killed_node_ends_the_run_with_its_name_and_leaves_no_process(
    tel: StartTel, victim: str, trial: int
) -> None:
    durations = "practice.durations_s=[60.0]" if trial == 1 else "practice.durations_s=[3.5, 60.0]"
    run = tel(*LONG_TRIAL, f"practice.trials={trial}", durations)
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


def test_no_node_outlives_a_killed_supervisor(tel: StartTel) -> None:
    run = tel(*QUICK)
    run.wait_until_moving(trial=1)
    run.process.kill()
    run.process.communicate(timeout=HANG_S)
    wait_until(lambda: run.left_behind() == [], "the end of all nodes")


def test_a_second_graph_is_refused_before_anything_moves(tel: StartTel, graph: StartGraph) -> None:
    graph(["ep_controller"]).meet(topics.EP_CONTROLLER)
    second = tel(*QUICK)
    code, out, err = second.finish()
    assert (code, out) == (2, "")
    assert f"ROS_DOMAIN_ID is '{os.environ['ROS_DOMAIN_ID']}'" in err
    assert "without a running graph (found ep_controller)" in err
    assert not second.folder.exists()


def test_an_external_arm_that_is_not_there_is_reported_and_nothing_simulated_starts(tel: StartTel) -> None:
    run = tel(*QUICK, "run.arm=external", "run.arm_timeout_s=2.0")
    wait_until(lambda: len(run.nodes()) >= 4 or run.process.poll() is not None, "the nodes")
    names = set(run.nodes())
    code, _, err = run.finish()
    assert code == 3
    assert "the arm is not there" in err and "/joint_states" in err
    assert "sim_bridge" not in names
    assert run.left_behind() == []


def test_a_value_that_only_a_node_can_refuse_is_bad_input_as_well(graph: StartGraph) -> None:
    running = graph(["sim_bridge"], "sim.initial_position_rad=[3.5, 0.0]")  # outside the URDF's range
    wait_until(lambda: "expected" in running.log("sim_bridge"), "the refusal")
    with pytest.raises(GraphError, match="node sim_bridge ended with code 2") as refusal:
        wait_until(lambda: running.processes.check() is not None, "the end")
    assert refusal.value.exit_code == EXIT_BAD_INPUT
    assert "sim.initial_position_rad is [3.5, 0.0]; expected one value in rad a joint" in str(refusal.value)
