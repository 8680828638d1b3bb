"""The list of all checks, in the order in which a person reads them, and what each of them needs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from tel_ros.core.check import driver, listening, response
from tel_ros.core.check.evidence import ENOUGH_STATES, Evidence, Finding, Verdict


class Needs(Enum):
    """What has to be there for a check to be made."""

    GRAPH = "who is on the topics, and the names in the joint states"
    STATES = "enough states that name all joints"
    POSITIONS = "such states with finite positions"
    MOTION = "states heard after that, with finite positions"
    ATTEMPT = "an attempt to pulse the arm"
    PULSES = "pulses that were sent"

    def met_by(self, evidence: Evidence) -> bool:
        """Return whether it is there."""
        states = evidence.moving if self is Needs.MOTION else evidence.states
        finite = states is not None and bool(np.isfinite(states.position_rad).all())
        enough = len(evidence.states) >= ENOUGH_STATES
        met = {Needs.STATES: enough, Needs.POSITIONS: enough and finite, Needs.MOTION: finite}
        return met.get(self, self is not Needs.PULSES or bool(evidence.pulses and evidence.pulses.pulses))


@dataclass(frozen=True)
class Check:
    """One thing to find out about an arm: from the evidence to findings for the arm or for each joint."""

    title: str
    needs: Needs
    judge: Callable[[Evidence], Iterable[Finding]]

    def findings(self, evidence: Evidence) -> list[Finding]:
        """Return what it finds, under its title; an empty list if what it needs is missing."""
        found = self.judge(evidence) if self.needs.met_by(evidence) else ()
        return [replace(finding, check=self.title) for finding in found]


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
    Check("effort steps", Needs.MOTION, driver.effort_steps),
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
    return next((v for v in (Verdict.WRONG, Verdict.WARNING) if v in verdicts), Verdict.OK)
