"""The simulated arm over DDS: what a driver of a real one would do."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable

import numpy as np
import pytest
from graph_harness import Graph
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from tel_ros.nodes.conversions import time_ns
from tel_ros.recording import topics

StartGraph = Callable[..., Graph]

PERIOD_NS = 5_000_000


def command(effort: list[float], answers_ns: int | None = None) -> Float64MultiArray:
    message = Float64MultiArray(data=effort)
    if answers_ns is not None:
        message.layout.dim = [
            MultiArrayDimension(label=str(answers_ns), size=len(effort), stride=len(effort))
        ]
    return message


def connected(graph: StartGraph, *overrides: str):  # noqa: ANN201
    running = graph(["sim_bridge"], *overrides)
    states = running.listen(JointState, topics.JOINT_STATES, depth=5000)
    pub = running.node.create_publisher(Float64MultiArray, topics.EFFORT_COMMANDS, 10)
    running.spin_until(lambda: len(states) > 2 and pub.get_subscription_count() > 0, "the arm")
    return running, states, pub


def test_in_lockstep_each_answer_is_one_period_and_a_late_answer_none(graph: StartGraph) -> None:
    running, states, pub = connected(graph)
    assert {time_ns(s.header.stamp) for s in states} == {0}  # time stands still without commands
    for k in range(5):
        pub.publish(command([1.0, 0.0], answers_ns=k * PERIOD_NS))
        running.spin_until(
            lambda k=k: time_ns(states[-1].header.stamp) == (k + 1) * PERIOD_NS, "the next state"
        )
        pub.publish(command([9.0, 0.0], answers_ns=k * PERIOD_NS))  # the old state answered once more
    seen = len(states)
    running.spin_until(lambda: len(states) > seen + 3, "repetitions")
    assert time_ns(states[-1].header.stamp) == 5 * PERIOD_NS
    assert 9.0 not in {s.effort[0] for s in states}


def test_in_lockstep_a_moving_arm_that_nobody_commands_coasts_to_rest(graph: StartGraph) -> None:
    friction = "sim.viscous_friction_nms_per_rad=[3.0, 3.0]"  # so that it comes to rest within a second
    running, states, pub = connected(graph, "sim.lockstep_timeout_s=0.3", friction)
    for k in range(50):
        pub.publish(command([5.0, 0.0], answers_ns=k * PERIOD_NS))
        running.spin_until(
            lambda k=k: time_ns(states[-1].header.stamp) == (k + 1) * PERIOD_NS, "the next state"
        )
    assert np.abs(states[-1].velocity).max() > 0.1
    running.spin_until(lambda: "come to rest" in running.log("sim_bridge"), "rest")
    assert "effort is zero, the arm coasts" in running.log("sim_bridge")
    assert list(states[-1].effort) == [0.0, 0.0]


@pytest.mark.realtime
def test_in_real_time_what_is_too_old_or_broken_is_not_applied_and_a_stall_is_one_long_step(
    graph: StartGraph,
) -> None:
    # That broken commands and silence move nothing, test/contract shows of this arm as well.
    running, states, pub = connected(graph, "sim.clock=realtime", "sim.command_age_limit_s=0.2")

    def newest_ns() -> int:
        return time_ns(states[-1].header.stamp)

    def says(what: str) -> None:
        running.spin_until(lambda: what in running.log("sim_bridge"), what)

    pub.publish(command([float("nan"), 0.0]))
    says("expected 2 finite numbers")
    for _ in range(20):
        seen = len(states)
        pub.publish(command([1.0, 0.5], answers_ns=newest_ns() - 201_000_000))
        running.spin_until(lambda seen=seen: len(states) > seen, "states")
    says("(limit 0.2 s); it is ignored")
    assert {tuple(s.effort) for s in states} == {(0.0, 0.0)}
    assert {tuple(s.position) for s in states} == {tuple(states[0].position)}

    def push() -> bool:
        pub.publish(command([1.0, 0.5], answers_ns=newest_ns()))
        return states[-1].effort[0] > 0.0

    running.spin_until(push, "the effort of a command in time")
    says("no command for 0.100 s: effort is zero")

    running.signal("sim_bridge", signal.SIGSTOP)
    stopped_ns = time.time_ns()
    time.sleep(0.3)
    running.signal("sim_bridge", signal.SIGCONT)
    running.spin_until(lambda: newest_ns() > stopped_ns + 290_000_000, "the present")
    stamps_ns = np.array([time_ns(state.header.stamp) for state in states])
    # One state stands for the whole stall: what lies between is not published in a burst.
    assert np.diff(stamps_ns).max() >= 280_000_000
    assert set((np.diff(stamps_ns) % PERIOD_NS).tolist()) == {0}
    # A state may come late, but none comes from the future.
    assert stamps_ns[-1] <= time.time_ns()
