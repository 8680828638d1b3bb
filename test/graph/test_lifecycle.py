"""The controller as a managed node: what it does in which state, and the transitions that it refuses."""

from __future__ import annotations

import signal
from collections.abc import Callable

from graph_harness import Graph
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import GetState
from std_msgs.msg import Float64MultiArray
from tel_interfaces.msg import TrialResult
from tel_process import PATIENT

from tel_ros.recording import topics

StartGraph = Callable[..., Graph]


def state(running: Graph) -> int:
    answer = running.call(GetState, f"{topics.EP_CONTROLLER}/get_state", GetState.Request())
    return int(answer.current_state.id)


def test_nothing_is_commanded_before_the_controller_is_active_nor_after_and_a_shutdown_brakes_first(
    graph: StartGraph,
) -> None:
    running = graph(["sim_bridge", "ep_controller"], *PATIENT, "control.lock_memory=true")
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    running.spin_until(running.trials.server_is_ready, topics.EXECUTE_TRIAL)

    def refused(reason: str) -> None:
        result = running.result(running.send(running.goal()))
        assert result.outcome == TrialResult.REFUSED
        assert reason in result.message
        assert commands == []

    refused("ep_controller is unconfigured; expected active")
    assert not running.change_state(Transition.TRANSITION_ACTIVATE)  # it has to be configured first
    assert running.change_state(Transition.TRANSITION_CONFIGURE)
    refused("ep_controller is inactive; expected active")
    assert running.change_state(Transition.TRANSITION_CLEANUP)
    running.wait_for_controller()
    assert commands == []  # active, and nobody has asked for a trial

    handle = running.start_moving()
    with running.time_stopped_in_motion():  # so the trial is not over before
        assert not running.change_state(Transition.TRANSITION_DEACTIVATE)
    assert state(running) == State.PRIMARY_STATE_ACTIVE
    assert "deactivate is refused: a trial is under way" in running.log("ep_controller")
    result = running.result(handle)
    assert result.outcome == TrialResult.COMPLETED, result.message

    assert running.change_state(Transition.TRANSITION_DEACTIVATE)
    running.spin_until(lambda: list(commands[-1].data) == [0.0, 0.0], "zero effort")
    assert state(running) == State.PRIMARY_STATE_INACTIVE
    commands.clear()
    refused("ep_controller is inactive; expected active")
    # And it can be used again.
    assert running.change_state(Transition.TRANSITION_ACTIVATE)
    again = running.result(running.send(running.goal()))
    assert again.outcome == TrialResult.COMPLETED, again.message

    handle = running.start_moving()
    assert running.change_state(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    result = running.result(handle)
    assert result.outcome == TrialResult.CANCELLED
    running.spin_until(lambda: list(commands[-1].data) == [0.0, 0.0], "zero effort")
    assert max(abs(v) for v in running.where_time_stands_still().velocity) < 0.1
    assert state(running) == State.PRIMARY_STATE_FINALIZED
    running.signal("ep_controller", signal.SIGINT)  # the process is still there, and ends as ever

    # Whatever is asked of the operating system is asked in lockstep, too.
    for name in running.processes.pids:
        said = running.log(name)
        assert "memory is locked" in said or "control.lock_memory refused" in said, name
