"""The list of all checks, in the order in which a person reads them."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from tel_ros.core.check import driver, listening, response
from tel_ros.core.check.evidence import Check, Evidence, Finding, Needs, Verdict

CHECKS = (
    Check("publisher of states", Needs.GRAPH, listening.state_publisher),
    Check("other commands", Needs.GRAPH, listening.other_commanders),
    Check("listener to commands", Needs.GRAPH, listening.command_listener),
    Check("quality of service", Needs.GRAPH, listening.quality_of_service),
    Check("name", Needs.GRAPH, listening.joint_names),
    Check("fields", Needs.GRAPH, listening.fields),
    Check("states", Needs.GRAPH, listening.number_of_states),
    Check("rate of states", Needs.STATES, listening.rate_of_states),
    Check("rate of stamps", Needs.STATES, listening.rate_of_stamps),
    Check("jitter of arrival", Needs.STATES, listening.jitter),
    Check("order of stamps", Needs.STATES, listening.order_of_stamps),
    Check("age of states", Needs.STATES, listening.age),
    Check("positions", Needs.STATES, listening.positions),
    Check("velocities", Needs.STATES, listening.velocities),
    Check("efforts", Needs.STATES, listening.efforts),
    Check("posture", Needs.POSITIONS, listening.posture),
    Check("pulses", Needs.ATTEMPT, response.pulses),
    Check("effort channel", Needs.PULSES, response.effort_channel),
    Check("wiring", Needs.PULSES, response.wiring),
    Check("sign of effort", Needs.PULSES, response.sign),
    Check("both ways", Needs.PULSES, response.both_ways),
    Check("effort scale", Needs.PULSES, response.effort_scale),
    Check("round-trip delay", Needs.PULSES, driver.delay),
    Check("effort field", Needs.PULSES, driver.effort_field),
    Check("effort steps", Needs.PULSES, driver.effort_steps),
    Check("watchdog of the driver", Needs.PULSES, driver.watchdog),
    Check("velocity", Needs.MOTION, listening.velocity),
)
"""A new check is one function of :class:`Evidence` and one entry here."""

LISTENING = (Needs.GRAPH, Needs.STATES, Needs.POSITIONS)
"""Known before the arm is moved."""
MOVING = (Needs.ATTEMPT, Needs.PULSES, Needs.MOTION)
"""Known after that."""


def judge(evidence: Evidence, needs: Collection[Needs]) -> list[Finding]:
    """Return what the checks find that need one of these."""
    return [finding for check in CHECKS if check.needs in needs for finding in check.findings(evidence)]


def worst(findings: Iterable[Finding]) -> Verdict:
    """Return the verdict on all of it: wrong if one is, else a warning if there is one, else OK."""
    verdicts = {finding.verdict for finding in findings}
    for verdict in (Verdict.WRONG, Verdict.WARNING):
        if verdict in verdicts:
            return verdict
    return Verdict.OK
