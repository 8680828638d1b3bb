"""The controller over DDS: goals that it refuses, trials that it ends, and what the arm feels then."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from graph_harness import Graph
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import ControlState, TrialGoal, TrialResult
from tel_process import COARSE, PAPER, own_domain

from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config

StartGraph = Callable[..., Graph]

ARM_AND_CONTROLLER = ["sim_bridge", "ep_controller"]


@pytest.fixture(scope="module")
def arm_and_controller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    config, folder = load_config(PAPER, COARSE), tmp_path_factory.mktemp("shared") / "graph"
    with own_domain() as domain, Graph(config, folder, ARM_AND_CONTROLLER, domain) as made:
        made.wait_for_controller()
        yield made


@pytest.fixture
def shared(arm_and_controller: Graph) -> Iterator[Graph]:
    """Return an arm and a controller, of which a test leaves nothing but an arm at rest."""
    with arm_and_controller.nothing_left():
        yield arm_and_controller

    def completed() -> bool:
        goal = arm_and_controller.send(arm_and_controller.goal())
        return bool(arm_and_controller.result(goal).outcome == TrialResult.COMPLETED)

    arm_and_controller.spin_until(completed, "a trial after the test")


class HandMade:
    """A controller whose arm is made up here: states are published one by one."""

    def __init__(self, running: Graph) -> None:
        self.running, self._stamp_ns = running, 1_000_000_000

    def begin(self) -> None:
        """Offer the states anew."""
        self._publisher = self.running.node.create_publisher(JointState, topics.JOINT_STATES, 10)

    def publish(
        self, position: list[float], velocity: list[float], names: tuple[str, ...] = ("elbow", "shoulder")
    ) -> int:
        """Publish a state, 2 ms later than the one before; return its stamp."""
        self._stamp_ns += 2_000_000
        message = JointState(name=list(names), position=position, velocity=velocity)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._stamp_ns, 1_000_000_000)
        self._publisher.publish(message)
        self.running.executor.spin_once(timeout_sec=0.002)
        return self._stamp_ns


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[HandMade]:
    config = load_config(PAPER, (*COARSE, "run.arm=external"))
    folder = tmp_path_factory.mktemp("alone") / "graph"
    with own_domain() as domain, Graph(config, folder, ["ep_controller"], domain) as running:
        running.activate_controller()
        yield HandMade(running)


@pytest.fixture
def hand_made(controller: HandMade) -> Iterator[HandMade]:
    with controller.running.nothing_left():
        yield controller


def of_trial(states: list[ControlState]) -> list[ControlState]:
    return [state for state in states if state.trial]


def test_a_trial_runs_from_rest_to_rest_and_reports_what_the_control_states_show(shared: Graph) -> None:
    states = shared.listen(ControlState, topics.CONTROL_STATES, depth=10_000)
    shared.meet(topics.EP_CONTROLLER)
    feedback: list[Any] = []
    result = shared.result(shared.send(shared.goal(5.0), feedback))
    assert result.outcome == TrialResult.COMPLETED, result.message
    shared.spin_until(lambda: len(of_trial(states)) == result.ticks, "all control states")
    states = of_trial(states)
    run = [s for s in states if s.phase == ControlState.RUN]
    assert len(run) == 1001
    error = np.array([s.position_rad for s in run]) - np.array([s.desired_position_rad for s in run])
    assert result.rms_error_rad == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
    assert result.max_error_rad == pytest.approx(np.abs(error).max(), rel=1e-9)
    assert [s.phase for s in states[:1] + states[-1:]] == [ControlState.APPROACH, ControlState.HOLD]
    assert feedback and feedback[-1].max_error_rad <= result.max_error_rad


def broken(kind: str, goal: TrialGoal) -> TrialGoal:
    """Return the goal with one thing wrong."""
    if kind == "wrong joints":
        goal.joint_names = ["shoulder", "wrist"]
    elif kind == "not finite":
        goal.position_rad[100] = float("nan")
    elif kind == "command not finite":
        goal.equilibrium_rad[7] = float("inf")
    elif kind == "time goes back":
        goal.time_ns[50] = goal.time_ns[49]
    elif kind == "outside joint limits":
        goal.position_rad[100] = 3.5
    elif kind == "too fast":
        goal.velocity_rad_s[100] = 50.0
    elif kind == "does not end at rest":
        goal.velocity_rad_s[-1] = 1.0
    elif kind == "too few commands":
        goal.equilibrium_rad = goal.equilibrium_rad[:-2]
    elif kind == "empty":
        return TrialGoal()
    return goal


REFUSALS = {
    "wrong joints": "the trajectory is for the joints shoulder, wrist; expected shoulder, elbow",
    "not finite": "position_rad is nan for joint 1 at point 50; expected finite numbers",
    "command not finite": "the equilibrium trajectory is inf for joint 2 at point 3",
    "time goes back": "expected strictly increasing times",
    "outside joint limits": "shoulder should be at 3.500 rad at 0.250 s; expected -2.900 to 2.900 rad",
    "too fast": "shoulder should be at 50.000 rad/s",
    "does not end at rest": "starts or ends with 1.000 rad/s; expected rest",
    "too few commands": "equilibrium_rad has 2000 values; expected 1001 points of 2 joints",
    "empty": "the trajectory is for the joints (none)",
}


def test_malformed_goals_are_refused_with_the_reason_and_nothing_moves(shared: Graph) -> None:
    commands = shared.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    shared.meet(topics.EP_CONTROLLER)
    for kind, reason in REFUSALS.items():
        result = shared.result(shared.send(broken(kind, shared.goal())))
        assert result.outcome == TrialResult.REFUSED, kind
        assert reason in result.message, kind
    assert commands == []


def test_one_trial_at_a_time_and_cancelling_brings_the_arm_to_rest(shared: Graph) -> None:
    states = shared.listen(ControlState, topics.CONTROL_STATES, depth=10_000)
    shared.meet(topics.EP_CONTROLLER)
    first = shared.start_moving()
    second = shared.result(shared.send(shared.goal()))
    assert second.outcome == TrialResult.REFUSED
    assert "one trial at a time" in second.message
    first.cancel_goal_async()
    result = shared.result(first)
    assert result.outcome == TrialResult.CANCELLED
    shared.spin_until(lambda: len(of_trial(states)) == result.ticks, "all control states")
    last = of_trial(states)[-1]
    assert last.phase == ControlState.STOP
    assert np.abs(last.velocity_rad_s).max() < 0.1


def test_a_trial_is_aborted_at_a_limit_and_the_arm_braked_and_held(graph: StartGraph) -> None:
    # One limit; all others, and path tolerances, are tested without ROS.
    running = graph(ARM_AND_CONTROLLER, "arm.velocity_limit_rad_s=[3.0, 9.0]")
    states = running.listen(ControlState, topics.CONTROL_STATES, depth=10_000)
    running.wait_for_controller()
    result = running.result(running.send(running.goal(4.5)))
    running.spin_until(lambda: len(of_trial(states)) == result.ticks, "all control states")
    assert result.outcome == TrialResult.ABORTED
    assert "shoulder moves at" in result.message
    stop = [s for s in states if s.phase == ControlState.STOP]
    power = [np.max(np.multiply(s.effort_nm, s.velocity_rad_s)) for s in stop]
    assert max(power) <= 1e-9  # the springs only brake
    assert np.abs(stop[-1].velocity_rad_s).max() < 0.1


def test_a_trial_without_joint_states_ends_with_zero_effort(graph: StartGraph) -> None:
    # So long that a busy machine does not come first.
    running = graph(ARM_AND_CONTROLLER, "sim.lockstep_timeout_s=4.0")
    states = running.listen(ControlState, topics.CONTROL_STATES)
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    running.wait_for_controller()
    handle = running.start_moving()
    with running.time_stopped_in_motion():
        result = running.result(handle)
        assert result.outcome == TrialResult.ABORTED
        assert "(time-out 4.0 s)" in result.message
        running.spin_until(lambda: list(commands[-1].data) == [0.0, 0.0], "zero effort")
    running.spin_until(lambda: states[-1].phase == ControlState.STOP, "the brake")


def test_a_goal_without_an_arm_is_refused(hand_made: HandMade) -> None:
    running = hand_made.running
    running.spin_until(running.trials.server_is_ready, topics.EXECUTE_TRIAL)
    result = running.result(running.send(running.goal()))
    assert result.outcome == TrialResult.REFUSED
    assert "no joint states on /joint_states" in result.message


def test_states_that_cannot_be_used_are_never_answered(hand_made: HandMade) -> None:
    running, zero = hand_made.running, [0.0, 0.0]
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    hand_made.begin()
    running.spin_until(
        lambda: hand_made.publish([1.3, 0.6], zero) and running.trials.server_is_ready(), "the action"
    )
    for _ in range(50):
        hand_made.publish([1.3, 0.6], zero)
    sent = running.trials.send_goal_async(ExecuteTrial.Goal(goal=running.goal()))
    running.spin_until(lambda: hand_made.publish([1.3, 0.6], zero) and len(commands) > 20, "commands")
    assert sent.done() and all(np.isfinite(message.data).all() for message in commands)
    heard = len(commands)
    result = sent.result().get_result_async()
    running.spin_until(
        lambda: hand_made.publish([float("nan"), 0.6], zero) and result.done(), "the end of the trial"
    )
    assert result.result().result.result.outcome == TrialResult.ABORTED
    assert all(list(message.data) == zero for message in commands[heard + 5 :])
    assert "expected finite numbers" in running.log("ep_controller")
    complaint = "the joint state has shoulder; expected also elbow"
    running.spin_until(
        lambda: hand_made.publish([0.6], [0.0], ("shoulder",)) and complaint in running.log("ep_controller"),
        complaint,
    )
    assert all(list(message.data) == zero for message in commands[heard + 5 :])


def test_missing_velocities_are_estimated_and_that_is_said_once(graph: StartGraph) -> None:
    # A controller of its own: where velocities were reported once, missing ones are not made up.
    running = graph(["ep_controller"], "run.arm=external")
    running.activate_controller()
    hand_made = HandMade(running)
    states = running.listen(ControlState, topics.CONTROL_STATES)
    hand_made.begin()
    positions: dict[int, float] = {}

    def publish(velocity: list[float]) -> None:
        position = 0.5 + 0.0002 * len(positions)  # 0.1 rad/s
        names = ("elbow", "gripper", "shoulder")
        positions[hand_made.publish([1.3, 0.0, position], velocity, names)] = position

    for velocity in ([float("nan"), 0.0, float("nan")], []):

        def still_and_moving(velocity: list[float] = velocity) -> bool:
            publish(velocity)
            return bool(states) and np.allclose(states[-1].velocity_rad_s, [0.1, 0.0], atol=1e-6)

        states.clear()
        running.spin_until(still_and_moving, "the velocity of the shoulder")
        for _ in range(100):
            publish(velocity)
    complaint = "have no velocity for shoulder, elbow: it is estimated from the positions"
    assert running.log("ep_controller").count(complaint) == 1


def test_a_trial_is_aborted_when_somebody_else_commands_the_arm(shared: Graph) -> None:
    handle = shared.send(shared.goal(20.0))
    shared.node.create_publisher(Float64MultiArray, topics.EFFORT_COMMANDS, 10)
    result = shared.result(handle)
    assert result.outcome == TrialResult.ABORTED
    assert "test commands the arm on /effort_controller/commands, too" in result.message
    refused = shared.result(shared.send(shared.goal()))
    assert refused.outcome == TrialResult.REFUSED
    assert "commands the arm" in refused.message


def test_two_that_speak_for_the_arm_are_not_believed(shared: Graph) -> None:
    commands = shared.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    shared.meet(topics.EP_CONTROLLER)
    handle = shared.send(shared.goal(20.0))
    shared.spin_until(lambda: len(commands) > 100, "commands")
    shared.node.create_publisher(JointState, topics.JOINT_STATES, 10)
    result = shared.result(handle)
    assert result.outcome == TrialResult.ABORTED
    assert "sim_bridge and test publish /joint_states: who speaks for the arm?" in result.message
    shared.spin_until(lambda: list(commands[-1].data) == [0.0, 0.0], "zero effort")
