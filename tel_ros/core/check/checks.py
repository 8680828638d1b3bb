"""The list of all checks, in the order in which a person reads them, and what each of them needs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tel_ros.core.check import driver, listening, response
from tel_ros.core.check.evidence import ENOUGH_STATES, Evidence, Finding, Verdict

IS_THERE: dict[str, Callable[[Evidence], bool]] = {
    "graph": lambda seen: True,  # who is on the topics, and the names in the joint states
    "states": lambda seen: len(seen.states) >= ENOUGH_STATES,
    "positions": lambda seen: IS_THERE["states"](seen) and bool(np.isfinite(seen.states.position_rad).all()),
    "motion": lambda seen: len(seen.moving) > 0 and bool(np.isfinite(seen.moving.position_rad).all()),
    "pulses": lambda seen: bool(seen.pulsed.pulses),
}
"""What checks need: whether it is there."""


@dataclass(frozen=True)
class Check:
    """One thing to find out about an arm, or about each of its joints."""

    title: str
    needs: str
    judge: Callable[..., Finding | None]
    """Gets the evidence, and the number of the joint if it is ``of_joints``; None: nothing to say."""
    blocks: bool = False
    """Whether an arm must not be moved with which this is wrong."""
    of_joints: bool = False

    def findings(self, seen: Evidence) -> list[Finding]:
        """Return what it finds, under its title; an empty list if what it needs is missing."""
        cases = [(name, (j,)) for j, name in enumerate(seen.arm.joints)] if self.of_joints else [("", ())]
        return [
            replace(f, check=self.title, joint=joint, blocks=self.blocks and f.verdict is Verdict.WRONG)
            for joint, which in (cases if IS_THERE[self.needs](seen) else ())
            if (f := self.judge(seen, *which))
        ]


_of_joints = partial(Check, of_joints=True)
LISTENING = (
    Check("publisher of states", "graph", listening.state_publisher, blocks=True),
    Check("other commands", "graph", listening.other_commanders, blocks=True),
    Check("listener to commands", "graph", listening.command_listener, blocks=True),
    Check("quality of service", "graph", listening.quality_of_service),
    _of_joints("name", "graph", listening.joint_name, blocks=True),
    Check("fields", "graph", listening.fields, blocks=True),
    Check("states", "graph", listening.number_of_states, blocks=True),
    Check("rate of states", "states", listening.rate_of_states),
    Check("rate of stamps", "states", listening.rate_of_stamps),
    Check("jitter of arrival", "states", listening.jitter),
    Check("order of stamps", "states", listening.order_of_stamps, blocks=True),
    Check("age of states", "states", listening.age, blocks=True),
    Check("positions", "states", listening.positions, blocks=True),
    Check("velocities", "states", listening.velocities),
    Check("efforts", "states", listening.efforts),
    _of_joints("posture", "positions", listening.posture, blocks=True),
)
"""Known before the arm is moved. A new check is a function of the evidence and an entry, here or below."""
MOVING = (
    Check("pulses", "graph", response.pulses),
    _of_joints("effort channel", "pulses", response.effort_channel),
    _of_joints("wiring", "pulses", response.wiring),
    _of_joints("sign of effort", "pulses", response.sign),
    _of_joints("both ways", "pulses", response.both_ways),
    _of_joints("effort scale", "pulses", response.effort_scale),
    Check("round-trip delay", "pulses", driver.delay),
    _of_joints("effort field", "pulses", driver.effort_field),
    _of_joints("effort steps", "motion", driver.effort_steps),
    Check("watchdog of the driver", "pulses", driver.watchdog),
    _of_joints("velocity", "motion", listening.velocity),
)
"""Known after that."""


def judge(evidence: Evidence, checks: Sequence[Check]) -> list[Finding]:
    """Return what these checks find."""
    return [finding for check in checks for finding in check.findings(evidence)]


def worst(findings: Iterable[Finding]) -> Verdict:
    """Return the verdict on all of it: wrong if one is, else a warning if there is one, else OK."""
    verdicts = {finding.verdict for finding in findings}
    return next((v for v in (Verdict.WRONG, Verdict.WARNING) if v in verdicts), Verdict.OK)
