"""The layer through which every effort goes before it may reach an arm, whoever computed it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.errors import EffortError
from tel_ros.core.safety.drives import DriveResponse
from tel_ros.core.safety.monitors import FrozenReadings
from tel_ros.core.safety.motion_rules import BrakingDistance, MotionLimits, SoftLimits
from tel_ros.core.safety.rules import (
    EffortLimit,
    EffortRate,
    LastEffort,
    LateStates,
    Permitted,
    QuietBounds,
    QuietZone,
    SafetyRule,
)
from tel_ros.core.types import NS_PER_S, FloatArray

LONGEST_GAP_S = 0.1
"""After this long without a command an arm has no effort (docs/arm-contract.md, Silence)."""


class SafetyLayer:
    """Makes a wanted effort one that the arm may get: at once, from the measured state and the last effort.

    It goes through :attr:`rules`, each of which wins over those before it. An effort that no rule objects to
    passes unchanged, to the last bit. Where the rules' own bounds tell that none will object, none is asked
    (:class:`~tel_ros.core.safety.rules.QuietZone`).

    The arm's empty limits must have been filled from the URDF; the rules' empty numbers are derived from it.
    ``own_rules`` win over all but the effort limit and the rule about late states. ConfigError: a value does
    not fit the arm.
    """

    def __init__(
        self, arm: ArmConfig, safety: SafetyConfig, rate_hz: float, own_rules: Sequence[SafetyRule] = ()
    ) -> None:
        safety.require_fits(arm)
        self._n_joints = len(arm.joints)
        self._period_s = 1.0 / rate_hz
        self.soft_limits = SoftLimits.of(arm, safety)
        limit = EffortLimit(arm)
        self.limit = limit.range
        self._rate = EffortRate.of(arm, safety, self._period_s)
        self._late = LateStates(self._period_s)
        self.rules: tuple[SafetyRule, ...] = (
            self._rate,
            BrakingDistance.of(arm, safety, self.soft_limits),
            MotionLimits(self.soft_limits),
            *own_rules,
            limit,
            self._late,
        )
        no_gap = QuietBounds(delay_s=LONGEST_GAP_S)
        self._quiet = QuietZone([no_gap, *(rule.quiet() for rule in self.rules)], self._n_joints)
        self.response = DriveResponse.of(arm, safety)
        """Whether the motors exert what is permitted."""
        self.readings = FrozenReadings(arm, safety)
        """Whether the readings can be true; otherwise nothing is permitted."""
        self._last_ns: int | None = None
        self.last_nm = np.zeros(self._n_joints)
        """What the arm was last permitted. Shape (n_joints,)."""
        self._nothing_changed = np.zeros(self._n_joints, dtype=bool)
        self._nothing_changed.flags.writeable = False

    @property
    def last_command(self) -> FloatArray:
        """What an arm that takes efforts is to get."""
        return self.last_nm

    def permit(
        self, state: ArmState, wanted_nm: FloatArray, pull_nm: Callable[[int], float] | None = None
    ) -> Permitted:
        """Return the effort that may be commanded in answer to a state.

        ``pull_nm`` tells how hard a joint's spring alone pulls towards the wanted position, if one is wanted:
        see :class:`~tel_ros.core.safety.monitors.FrozenReadings`.

        After a gap, or stamps that went back, nobody knows what has acted on the arm; and while a motor does
        not act (:attr:`response`), it is known that nothing has. Efforts grow from zero then, and a joint
        that is beyond a soft limit is led back (:class:`~tel_ros.core.safety.motion_rules.SoftLimits`).
        Raises EffortError: ``wanted_nm`` is not finite or not of shape (n_joints,). The last effort is zero
        from then on, and that is what is to be commanded: :meth:`none`.
        """
        self.response.look(state.time_ns, self.last_nm, state.effort_nm)
        # An effort that a motor withholds moves nothing, and that is no fault of the readings.
        withheld = state.effort_nm if self.response.waits else None
        acted_nm = self.last_nm if withheld is None else withheld
        self.readings.look(state, acted_nm, pull_nm, LONGEST_GAP_S)
        if self.readings.fault:
            return self.none()
        # In most ticks the last effort, the motors and the walls are as usual, and no rule will object.
        if (
            self._last_ns is not None
            and wanted_nm.shape == self.last_nm.shape
            and not (self.response.fault or self.soft_limits.lead)
            and self._quiet.has(state, wanted_nm, self.last_nm, state.time_ns - self._last_ns)
        ):
            self._last_ns, self.last_nm = state.time_ns, wanted_nm
            return Permitted(wanted_nm, self._nothing_changed)
        self._require_finite(wanted_nm)
        gap = self._last_ns is not None and not 0 < state.time_ns - self._last_ns <= LONGEST_GAP_S * NS_PER_S
        if gap or self.response.fault:
            self.none()
        # While what is permitted hardly reaches the arm (late states, or a driver that refuses) it waits.
        waits = self.soft_limits.lead and (self.is_late(state) or self.response.is_overdue(state.time_ns))
        if self._last_ns is None or waits:
            self.soft_limits.find(state.time_ns, state.position_rad)
        last, effort_nm = self._last(state.time_ns), wanted_nm
        for rule in self.rules:
            effort_nm = rule.permitted(state, last).nearest(effort_nm)
        self._last_ns, self.last_nm = state.time_ns, effort_nm
        return Permitted(effort_nm, effort_nm != wanted_nm)

    def is_late(self, state: ArmState) -> bool:
        """Return whether so little of an effort may act in answer to a state that nobody commands the arm."""
        share = self._late.share(self._last(state.time_ns).since_s, state.age_s)
        return share < LateStates.LEAST_SHARE

    def fading(self, time_ns: int) -> FloatArray:
        """Return the effort to want for the last one to fade to zero. Shape (n_joints,)."""
        return self._rate.towards_zero(self._last(time_ns))

    def permit_pulse(self, wanted_nm: FloatArray) -> Permitted:
        """Return the effort of a pulse, within the effort limits.

        The rules about motion would soften it, and what an arm does then would be judged wrongly. Narrower
        bounds hold it: :mod:`tel_ros.core.check.pulses`. Raises EffortError: as for :meth:`permit`.
        """
        self.none()
        self._require_finite(wanted_nm)
        self.last_nm = self.limit.nearest(wanted_nm)
        return Permitted(self.last_nm, self.last_nm != wanted_nm)

    def exerted(self, wanted_nm: FloatArray) -> Permitted:
        """Take note of what the springs of another controller exert, which knows the effort limits alone."""
        self.last_nm = self.limit.nearest(wanted_nm)
        return Permitted(self.last_nm, self.last_nm != wanted_nm)

    def none(self) -> Permitted:
        """Return no effort, and remember that there is none; zero is always permitted."""
        self._last_ns, self.last_nm = None, np.zeros(self._n_joints)
        return Permitted(self.last_nm, np.ones(self._n_joints, dtype=bool))

    def _last(self, time_ns: int) -> LastEffort:
        since_s = self._period_s if self._last_ns is None else (time_ns - self._last_ns) / NS_PER_S
        return LastEffort(self.last_nm, since_s)

    def _require_finite(self, effort_nm: FloatArray) -> None:
        if effort_nm.shape != (self._n_joints,) or not np.isfinite(effort_nm).all():
            self.none()
            raise EffortError(
                f"the wanted effort is {effort_nm.tolist()} N·m; expected {self._n_joints} finite numbers"
            )
