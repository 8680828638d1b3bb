"""What the nodes tell about themselves on ``/diagnostics``."""

from __future__ import annotations

import signal
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_harness import Graph
from tel_interfaces.srv import LoadNetwork

from tel_ros.recording import topics

StartGraph = Callable[..., Graph]

NODES = ["sim_bridge", "inverse_dynamics", "trial_recorder", "ep_controller"]


def test_the_nodes_say_how_they_are_and_at_once_when_that_changes(graph: StartGraph) -> None:
    running = graph(NODES)
    arrays: list[DiagnosticArray] = running.listen(DiagnosticArray, topics.DIAGNOSTICS)

    def newest(node: str) -> DiagnosticStatus | None:
        found = [status for array in arrays for status in array.status if status.name.startswith(f"{node}: ")]
        return found[-1] if found else None

    def said(node: str, level: bytes, text: str) -> DiagnosticStatus:
        def heard() -> bool:
            status = newest(node)
            return status is not None and status.level == level and status.message.startswith(text)

        # Long enough for learning to be compiled, where it never was before.
        running.spin_until(heard, f"{node}: {text!r}")
        return newest(node)

    said("ep_controller", DiagnosticStatus.WARN, "unconfigured: it commands nothing")
    running.wait_for_controller()
    status = said("ep_controller", DiagnosticStatus.OK, "IDLE")
    values = {pair.key: pair.value for pair in status.values}
    assert values["lifecycle"] == "active"
    assert (status.name, status.hardware_id) == ("ep_controller: control loop", "planar_arm")
    assert int(values["listeners_to_commands"]) >= 1
    said("sim_bridge", DiagnosticStatus.OK, "waits for commands")
    said("trial_recorder", DiagnosticStatus.OK, "waits for a trial")
    values = {p.key: p.value for p in said("inverse_dynamics", DiagnosticStatus.OK, "ready").values}
    assert values["revision"] and values["last_training"] == "nothing yet"

    assert not running.call(LoadNetwork, topics.LOAD, LoadNetwork.Request(path="/nowhere.npz")).success
    said("inverse_dynamics", DiagnosticStatus.WARN, "refused: /nowhere.npz")
    assert running.result(running.send(running.goal(4.5))).outcome == 0
    values = {p.key: p.value for p in said("ep_controller", DiagnosticStatus.OK, "HOLD").values}
    assert values["last_trial"] == "trial 1: COMPLETED"
    running.signal("sim_bridge", signal.SIGKILL)
    said("ep_controller", DiagnosticStatus.ERROR, "no joint states on /joint_states")
