"""Checking an arm: listens first; then, if nothing forbids it and somebody agrees, pulses the joints."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from tel_ros.app.bring_up import NodeProcesses, require_simulator
from tel_ros.app.errors import GraphError
from tel_ros.core.check.checks import LISTENING, MOVING, judge
from tel_ros.core.check.evidence import ENOUGH_STATES, Evidence, Finding, UrdfModel
from tel_ros.core.check.listening import listed
from tel_ros.core.check.pulses import STATE_GAP_S, PulseBounds, PulseGuard
from tel_ros.core.check.session import PulseSession
from tel_ros.core.config import ArmConfig, Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.plain_urdf import check_dynamics
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.types import FloatArray
from tel_ros.nodes.arm_check import ArmClient, endpoints
from tel_ros.nodes.waiting import namespace_hint
from tel_ros.recording import topics
from tel_ros.recording.config_file import dump_config
from tel_ros.recording.urdf import described

CHANNEL_TIMEOUT_S = 5.0
DISCOVERY_S = 0.5
START_S = 0.2

Agree = Callable[[str], bool]


def check_arm(
    config: Config, bounds: PulseBounds | None, agree: Agree, listen_s: float, namespace: str = "/"
) -> list[Finding]:
    """Check an arm and return all findings, in the order of the table; a simulated one is started for that.

    Without bounds of pulses it only listens. ``agree`` is asked before a real arm is pulsed, with what is
    going to happen. ConfigError: nothing has moved. GraphError: no joint states within ``run.arm_timeout_s``,
    or the simulated arm died. KeyboardInterrupt is passed on after zero effort was commanded.
    """
    if not 0.5 <= listen_s <= 600.0:
        raise ConfigError("--listen", listen_s, "0.5 to 600 s")
    config = replace(config, sim=replace(config.sim, clock="realtime"))
    if config.run.arm == "sim":
        # The simulated arm concerns nobody else on the network.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    command_topic = topics.commands(config.arm)
    with ArmClient(config.arm.joints, namespace) as client, ExitStack() as arm:
        begun_s = time.monotonic()
        # What takes long to load is loaded while others are discovered, or start.
        import scipy.optimize  # noqa: F401

        client.spin_for(begun_s + DISCOVERY_S - time.monotonic())
        if config.run.arm == "sim":
            client.still_there = _simulated_arm(arm, client, config, namespace).check
            arm.callback(client.send_zero)
        _wait_for_states(client, config)
        client.spin_for(listen_s)
        listened = Evidence(
            config.arm,
            config.control.rate_hz,
            client.states(),
            *endpoints(client.node, command_topic),
            names=client.names,
            malformed=client.malformed,
            listened_s=listen_s,
            arm_has_own_clock=config.run.arm == "sim",
        )
        findings = judge(listened, LISTENING)
        why = _why_not_pulsed(client, config, bounds, agree, findings)
        if bounds is not None and not why:
            moved = _pulse(client, config, bounds, listened)
        else:
            states = client.states()
            enough = len(states) >= ENOUGH_STATES and not any(finding.blocks for finding in findings)
            moved = replace(listened, not_pulsed=why, moving=states if enough else listened.moving)
        return findings + judge(moved, MOVING)


def _simulated_arm(arm: ExitStack, client: ArmClient, config: Config, namespace: str) -> NodeProcesses:
    """Start the simulated arm, once it is sure that its check cannot reach another one."""
    found = endpoints(client.node, topics.commands(config.arm))
    if others := sorted({node for kind in found for node, _, _ in kind}):
        expected = f"a domain without another arm, or run.arm=external (found {', '.join(others)})"
        raise ConfigError("ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID", "0"), expected)
    require_simulator()
    folder = Path(arm.enter_context(tempfile.TemporaryDirectory(prefix="tel_check_")))
    (folder / "run.yaml").write_text(dump_config(config), encoding="utf-8")
    nodes = NodeProcesses(folder / "run.yaml", ["sim_bridge"], folder / "log", namespace=namespace)
    return arm.enter_context(nodes)


def _wait_for_states(client: ArmClient, config: Config) -> None:
    # The simulated arm has to load its physics first.
    timeout_s = config.run.arm_timeout_s + (20.0 if config.run.arm == "sim" else 0.0)
    if not client.spin_until(lambda: bool(client.names), timeout_s):
        topic = client.node.resolve_topic_name(topics.JOINT_STATES)
        publishers, _, listeners = endpoints(client.node, topics.commands(config.arm))
        there = "Is the arm's driver running, its joint_state_broadcaster active, and ROS_DOMAIN_ID the same?"
        if publishers:
            there = f"{listed(publishers)} could publish them and does not."
        elif listeners:
            there = f"{listed(listeners)} takes commands: is its joint_state_broadcaster active?"
        hint = namespace_hint(client.node, topic)
        raise GraphError(f"no joint states on {topic} within {timeout_s:g} s.{hint} {there}")
    # Its first states come while everything else is still starting.
    client.spin_for(START_S)
    client.forget()


def _why_not_pulsed(
    client: ArmClient, config: Config, bounds: PulseBounds | None, agree: Agree, findings: list[Finding]
) -> str:
    """Return why the arm is not to be pulsed; empty once somebody has agreed and the channel is open."""
    blocking = dict.fromkeys(finding.check for finding in findings if finding.blocks)
    if bounds is None:
        return "--passive was given"
    if (interface := config.arm.command_interface) != "effort":
        # Zero effort, with which every pulse ends, would be a posture.
        takes = (
            "the drives take positions" if interface == "position" else "the controller takes trajectories"
        )
        return f"{takes} (arm.command_interface), and pulses are efforts"
    if blocking:
        return f"this has to be mended first: {', '.join(blocking)}"
    if config.run.arm != "sim" and not agree(_announcement(config, bounds)):
        return "nobody has agreed"
    layer = SafetyLayer(config.arm, config.safety, config.control.rate_hz)
    return "" if client.open_channel(layer, CHANNEL_TIMEOUT_S) else "nobody listens to the commands"


def _pulse(client: ArmClient, config: Config, bounds: PulseBounds, listened: Evidence) -> Evidence:
    heard, model = client.states(), _model(config.arm, client.newest.position_rad)
    client.forget()
    if not client.spin_until(lambda: len(client.states()) > 0, CHANNEL_TIMEOUT_S):
        raise GraphError("the joint states have stopped; nothing was commanded")
    state_gap_s = min(config.control.state_timeout_s, STATE_GAP_S)
    guard = PulseGuard(config.arm, bounds, client.newest, state_gap_s, heard.longest_still_s)
    damping = np.array(config.arm.damping_nms_per_rad)
    session = PulseSession(guard, damping, heard.resolution_rad(), client.states, model)
    client.run(session.course())
    return replace(listened, moving=client.states(), pulsed=session.shown())


def _model(arm: ArmConfig, position_rad: FloatArray) -> UrdfModel:
    found = described(arm)
    friction = np.array(found.viscous_friction_nms_per_rad)
    try:
        return UrdfModel(check_dynamics(found, arm.hand_link, position_rad=position_rad), friction)
    except InputFileError as error:
        return UrdfModel(None, friction, f"of the URDF: {error.found}")


def _announcement(config: Config, bounds: PulseBounds) -> str:
    arm = config.arm
    limits = zip(arm.joints, arm.effort_limit_nm, strict=True)
    efforts = ", ".join(f"{joint} ±{bounds.effort_share * limit:.3g} N·m" for joint, limit in limits)
    return (
        "The arm is going to move. One joint after the other gets torque pulses of up to 0.1 s (0.4 s where "
        f"its encoder hardly notices shorter ones), from weak to at most {bounds.effort_share:.1%} of its "
        f"limit ({efforts}). Everything ends with zero effort as soon as any joint is more than "
        f"{bounds.range_rad:g} rad away from where it is now. The arm has to rest without effort. Keep out "
        "of its reach, with a hand on the emergency stop.\n"
        f"May each joint move by {bounds.range_rad:g} rad?"
    )
