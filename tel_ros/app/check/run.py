"""Checking an arm: listens first; then, if nothing forbids it and somebody agrees, pulses the joints."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from tel_ros.app.bring_up import NodeProcesses, require_simulator
from tel_ros.app.errors import GraphError
from tel_ros.core.check.checks import LISTENING, MOVING, judge
from tel_ros.core.check.evidence import ENOUGH_STATES, Evidence, Finding
from tel_ros.core.check.pulses import MOST_STATE_GAP_S, PulseBounds, PulseGuard
from tel_ros.core.check.session import PulseSession
from tel_ros.core.config import ArmConfig, Config
from tel_ros.core.errors import ConfigError
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.types import FloatArray
from tel_ros.nodes.arm_check import ArmClient, endpoints
from tel_ros.nodes.waiting import namespace_hint
from tel_ros.recording import topics
from tel_ros.recording.config_file import dump_config
from tel_ros.recording.urdf import described, urdf_text

CHANNEL_TIMEOUT_S = 5.0
DISCOVERY_S = 0.5

Agree = Callable[[str], bool]


def check_arm(
    config: Config, bounds: PulseBounds | None, agree: Agree, listen_s: float = 2.0, namespace: str = "/"
) -> list[Finding]:
    """Check an arm and return all findings, in the order of the table; a simulated one is started for that.

    Without bounds of pulses it only listens. ``agree`` is asked before a real arm is pulsed, with what is
    going to happen.

    Raises:
        ConfigError: something about the configuration is wrong; nothing has moved.
        GraphError: no joint states within ``run.arm_timeout_s``, or the simulated arm died.
        KeyboardInterrupt: passed on after zero effort was commanded.
    """
    if not 0.5 <= listen_s <= 600.0:
        raise ConfigError("listen_s", listen_s, "0.5 to 600 s")
    config = replace(config, sim=replace(config.sim, clock="realtime"))
    if config.run.arm == "sim":
        # The simulated arm concerns nobody else on the network.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with (
        _arm_of(config, namespace) as still_there,
        ArmClient(config.arm.joints, still_there, namespace) as client,
    ):
        _wait_for_states(client, config)
        client.spin_for(listen_s)
        listened = Evidence(
            config.arm,
            config.control.rate_hz,
            client.states(),
            *endpoints(client.node, topics.COMMANDS[config.arm.command_interface]),
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
            moved = replace(listened, not_pulsed=why, moving=states if enough else None)
        return findings + judge(moved, MOVING)


@contextmanager
def _arm_of(config: Config, namespace: str) -> Iterator[Callable[[], None]]:
    """Start the simulated arm if there is to be one; yield what raises when it has died."""
    if config.run.arm != "sim":
        yield lambda: None
        return
    _refuse_other_arm(config, namespace)
    require_simulator()
    with tempfile.TemporaryDirectory(prefix="tel_check_") as folder:
        file = Path(folder) / "run.yaml"
        file.write_text(dump_config(config), encoding="utf-8")
        log = Path(folder) / "log"
        with NodeProcesses(file, ["sim_bridge"], log, namespace=namespace) as processes:
            yield processes.check


def _refuse_other_arm(config: Config, namespace: str) -> None:
    """Make sure that a check of the simulated arm cannot reach another one."""
    with ArmClient(config.arm.joints, namespace=namespace) as client:
        client.spin_for(DISCOVERY_S)
        found = endpoints(client.node, topics.COMMANDS[config.arm.command_interface])
    others = sorted({node for kind in found for node, _, _ in kind})
    if others:
        expected = f"a domain without another arm, or run.arm=external (found {', '.join(others)})"
        raise ConfigError("ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID", "0"), expected)


def _wait_for_states(client: ArmClient, config: Config) -> None:
    # The simulated arm has to load its physics first.
    timeout_s = config.run.arm_timeout_s + (20.0 if config.run.arm == "sim" else 0.0)
    if not client.spin_until(lambda: bool(client.names), timeout_s):
        topic = client.node.resolve_topic_name(topics.JOINT_STATES)
        raise GraphError(
            f"no joint states on {topic} within {timeout_s:g} s.{namespace_hint(client.node, topic)} "
            "Is the arm's driver running, its joint_state_broadcaster active, and ROS_DOMAIN_ID the same?"
        )
    # Its first states come while everything else is still starting.
    client.spin_for(DISCOVERY_S)
    client.forget()


def _why_not_pulsed(
    client: ArmClient, config: Config, bounds: PulseBounds | None, agree: Agree, findings: list[Finding]
) -> str:
    """Return why the arm is not to be pulsed; empty once somebody has agreed and the channel is open."""
    blocking = dict.fromkeys(finding.check for finding in findings if finding.blocks)
    if bounds is None:
        return "not sent, as asked"
    if config.arm.command_interface == "position":
        # Zero effort, with which every pulse ends, would be a posture.
        return "not sent: the drives take positions (arm.command_interface), and pulses are efforts"
    if blocking:
        return f"not sent until this is fixed: {', '.join(blocking)}"
    if config.run.arm != "sim" and not agree(_announcement(config, bounds)):
        return "not sent: nobody has agreed"
    layer = SafetyLayer(config.arm, config.safety, config.control.rate_hz)
    return "" if client.open_channel(layer, CHANNEL_TIMEOUT_S) else "not sent: nobody listens to the commands"


def _pulse(client: ArmClient, config: Config, bounds: PulseBounds, listened: Evidence) -> Evidence:
    resolution = client.states().resolution_rad()
    client.forget()
    if not client.spin_until(lambda: len(client.states()) > 0, CHANNEL_TIMEOUT_S):
        raise GraphError("the joint states have stopped")
    start = client.states()
    state_gap_s = min(config.control.state_timeout_s, MOST_STATE_GAP_S)
    guard = PulseGuard(config.arm, bounds, start.position_rad[-1], time.monotonic(), state_gap_s)
    session = PulseSession(guard, np.array(config.arm.damping_nms_per_rad), resolution, client.states)
    client.run(session.programs())
    states = client.states()
    return replace(listened, moving=states, pulses=session.shown(*_model(config.arm, states.position_rad[0])))


def _model(arm: ArmConfig, position_rad: FloatArray) -> tuple[FloatArray | None, FloatArray]:
    """Return what the URDF says of the arm: its inertia at a posture, if known, and viscous friction."""
    from tel_ros.core.learning.rigid_body import inertia_matrix  # late: it loads what learning needs

    found = described(arm)
    friction = np.array(found.viscous_friction_nms_per_rad)
    return inertia_matrix(urdf_text(found), arm.joints, position_rad), friction


def _announcement(config: Config, bounds: PulseBounds) -> str:
    arm = config.arm
    limits = zip(arm.joints, arm.effort_limit_nm, strict=True)
    efforts = ", ".join(f"{joint} ±{bounds.effort_share * limit:.3g} N·m" for joint, limit in limits)
    return (
        "The arm is going to move. One joint after the other gets torque pulses of up to 0.1 s, from weak to "
        f"at most {bounds.effort_share:.1%} of its limit ({efforts}). Everything ends with zero effort as "
        f"soon as any joint is more than {bounds.range_rad:g} rad away from where it is now. The arm has to "
        "rest without effort. Keep out of its reach, with a hand on the emergency stop.\n"
        f"May each joint move by {bounds.range_rad:g} rad?"
    )
