"""The graph with an arm that takes something else than efforts: equilibrium points, or whole trajectories."""

from __future__ import annotations

import signal
from collections.abc import Callable

import numpy as np
from graph_harness import Graph
from rosbags.highlevel import AnyReader
from std_msgs.msg import Float64MultiArray
from tel_interfaces.msg import TrialResult
from tel_process import QUICK, TelProcess, summary_of

from tel_lab.offline import OfflinePractice
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.run_folder import CONFIG_FILE
from tel_ros.recording.trial_bag import read_trial
from tel_ros.recording.waypoint_file import load_path

POSITION = "arm.command_interface=position"
TRAJECTORY = "arm.command_interface=trajectory"


def test_practice_sends_set_points_records_them_and_is_what_it_is_offline(
    tel: Callable[..., TelProcess],
) -> None:
    run = tel(*QUICK, POSITION, "practice.trials=1", "practice.goal_duration_s=4.0")
    code, out, err = run.finish()
    assert code == 0, err
    config = load_config(run.folder / CONFIG_FILE)
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        offline = [done.trial for done in practice.run()]
    for row, expected in zip(summary_of(out)["trials"], offline, strict=True):
        bag = run.folder / row["bag"]
        trial = read_trial(bag)
        np.testing.assert_array_equal(trial.equilibrium_rad, expected.equilibrium_rad)
        np.testing.assert_array_equal(trial.position_rad, expected.position_rad)
        with AnyReader([bag]) as reader:
            commands = [topics.absolute(topic) for topic in topics.RECORDED_COMMANDS]
            connections = [c for c in reader.connections if c.topic in commands]
            assert [c.topic for c in connections] == [topics.absolute(topics.POSITION_COMMANDS)]
            sent = [reader.deserialize(raw, c.msgtype).data for c, _, raw in reader.messages(connections)]
        np.testing.assert_array_equal(sent, trial.equilibrium_rad)


def test_without_states_and_at_its_end_the_controller_sends_nothing_because_zero_is_a_posture(
    graph: Callable[..., Graph],
) -> None:
    start = "sim.initial_position_rad=[0.6, 1.2]"
    running = graph(["sim_bridge", "ep_controller"], POSITION, start, "sim.lockstep_timeout_s=4.0")
    commands = running.listen(Float64MultiArray, topics.POSITION_COMMANDS, depth=20_000)
    efforts = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    running.wait_for_controller()
    handle = running.send(running.goal(6.0))
    running.spin_until(lambda: len(commands) > 100, "commands")
    running.signal("sim_bridge", signal.SIGKILL)
    result = running.result(handle)
    assert result.outcome == TrialResult.ABORTED
    assert "(time-out 4.0 s)" in result.message
    assert "the drive holds its last set point" in running.log("ep_controller")
    running.processes.stop()
    running.spin_until(lambda: running.node.count_publishers(topics.POSITION_COMMANDS) == 0, "the end")
    assert efforts == []
    assert [message for message in commands if not any(message.data)] == []


def test_trials_through_a_trajectory_controller_move_the_arm_as_efforts_for_each_state_do(
    tel: Callable[..., TelProcess],
) -> None:
    run = tel(*QUICK, TRAJECTORY, "practice.trials=2")
    _, out, _ = run.finish()
    rows = summary_of(out)["trials"]
    assert [row["outcome"] for row in rows] == ["completed"] * 2
    config = load_config(run.folder / CONFIG_FILE, ("arm.command_interface=effort",))
    with OfflinePractice(config, load_path(config.path, config.arm), new_network(config)) as practice:
        offline = next(iter(practice.run())).trial
    bag = run.folder / rows[0]["bag"]
    trial = read_trial(bag)
    first, expected = trial.position_rad[trial.run], offline.position_rad[offline.run]
    assert len(first) == len(expected)
    later = slice(len(first) // 2, None)  # they need not have come to rest in the same place
    assert np.sqrt(np.mean((first - expected)[later] ** 2)) < 5e-4
    with AnyReader([bag]) as reader:
        recorded = {connection.topic for connection in reader.connections}
    assert not recorded & {topics.absolute(topic) for topic in topics.RECORDED_COMMANDS}
