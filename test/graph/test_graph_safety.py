"""The emergency stop in software, and the guard of a controller that is gone."""

from __future__ import annotations

import signal
from collections.abc import Callable

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_harness import Graph
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from tel_interfaces.msg import ControlState, TrialResult
from tel_process import PATIENT, PRIORITY

from tel_ros.nodes import qos
from tel_ros.recording import topics

StartGraph = Callable[..., Graph]


def trigger(running: Graph, name: str) -> Trigger.Response:
    return running.call(Trigger, name, Trigger.Request())


def test_an_emergency_stop_brakes_the_arm_and_lasts_until_its_reset(graph: StartGraph) -> None:
    running = graph(["sim_bridge", "ep_controller"], *PATIENT)
    states = running.listen(ControlState, topics.CONTROL_STATES, depth=10_000)
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS, depth=10_000)
    stopped: list[Bool] = []
    running.node.create_subscription(Bool, topics.SAFETY_STOPPED, stopped.append, qos.LATCHED)
    running.wait_for_controller()
    assert not trigger(running, topics.SAFETY_RESET).success  # there is nothing to reset
    trial = running.start_moving()
    with running.time_stopped_in_motion():
        assert trigger(running, topics.SAFETY_STOP).success
        too_early = trigger(running, topics.SAFETY_RESET)
    assert not too_early.success and "not at rest yet" in too_early.message
    running.spin_until(lambda: bool(stopped) and stopped[-1].data, "the latched topic")
    result = running.result(trial)
    assert result.outcome == TrialResult.ABORTED
    assert "emergency stop (/safety/stop)" in result.message
    # safety.final_effort is zero: first the brake, then nothing.
    running.spin_until(lambda: list(commands[-1].data) == [0.0, 0.0], "zero effort")
    braking = [s for s in states if s.trial and s.phase == ControlState.STOP]
    assert np.abs(braking[0].velocity_rad_s).max() > 0.3  # it was in mid-motion
    assert max(abs(v) for v in running.where_time_stands_still().velocity) < 0.1

    refused = running.result(running.send(running.goal()))
    assert refused.outcome == TrialResult.REFUSED
    assert "emergency stop" in refused.message
    running.spin_until(lambda: trigger(running, topics.SAFETY_RESET).success, "the reset")
    running.spin_until(lambda: not stopped[-1].data, "the latched topic")
    again = running.result(running.send(running.goal()))
    assert again.outcome == TrialResult.COMPLETED, again.message


def test_an_arm_that_is_to_be_held_at_the_end_is_held_after_a_stop_and_after_the_controller_has_ended(
    graph: StartGraph,
) -> None:
    # Friction keeps the springs of the brake deflected: so it shows that they are not let go.
    sticky = ("sim.coulomb_friction_nm=[1.0, 1.0]",)
    running = graph(["sim_bridge", "ep_controller"], *PATIENT, "safety.final_effort=hold", *sticky)
    states = running.listen(ControlState, topics.CONTROL_STATES, depth=10_000)
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS, depth=10_000)
    running.wait_for_controller()
    trial = running.start_moving()
    with running.time_stopped_in_motion():
        assert trigger(running, topics.SAFETY_STOP).success
    assert running.result(trial).outcome == TrialResult.ABORTED

    def has_ended() -> bool:
        return running.node.count_publishers(topics.EFFORT_COMMANDS) == 0

    # From then on the controller does not answer, and the simulated arm's time stands still: it has to rest.
    running.spin_until(lambda: states[-1].phase == ControlState.IDLE, "rest")
    assert trigger(running, topics.SAFETY_RESET).success
    running.signal("ep_controller", signal.SIGTERM)
    running.spin_until(has_ended, "the controller's end")
    assert np.any(commands[-1].data)


@pytest.mark.realtime
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
def test_the_guard_brakes_the_arm_of_a_controller_that_was_killed_or_hangs(
    graph: StartGraph, how: signal.Signals
) -> None:
    nodes = ["sim_bridge", "arm_guard", "ep_controller"]
    real_time = ("sim.clock=realtime", *PRIORITY, *PATIENT)
    running = graph(nodes, *real_time, "safety.guard=always", "control.path_tolerance_rad=2.5")
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS, depth=10_000)
    arm = running.listen(JointState, topics.JOINT_STATES)
    health: list[DiagnosticArray] = running.listen(DiagnosticArray, topics.DIAGNOSTICS)

    def guard_says(level: bytes, text: str) -> bool:
        said = [s for array in health[-10:] for s in array.status if s.name == "arm_guard: command watch"]
        return bool(said) and said[-1].level == level and text in said[-1].message

    running.wait_for_controller()
    running.spin_until(lambda: guard_says(DiagnosticStatus.OK, "watches"), "the guard")
    assert commands == []
    running.start_moving()
    running.signal("ep_controller", how)
    heard = len(commands)

    def by_guard() -> list[Float64MultiArray]:
        return [m for m in commands[heard:] if m.layout.dim[0].label == "arm_guard"]

    running.spin_until(lambda: any(np.any(m.data) for m in by_guard()), "the guard's brake")
    running.spin_until(lambda: guard_says(DiagnosticStatus.ERROR, "commands"), "the alarm")
    running.spin_until(lambda: np.abs(arm[-1].velocity).max() < 0.05, "rest")
    running.spin_until(lambda: not np.any(by_guard()[-1].data), "zero effort")
    assert "takes over" in running.log("arm_guard")
    if how == signal.SIGSTOP:
        running.signal("ep_controller", signal.SIGCONT)
        running.spin_until(lambda: "the guard yields" in running.log("arm_guard"), "the guard's silence")
