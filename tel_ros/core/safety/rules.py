"""The safety rules: what effort an arm may get in a state, one object a rule.

A new rule is a subclass of :class:`SafetyRule` and an entry in the list of
:class:`~tel_ros.core.safety.layer.SafetyLayer`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import reduce
from typing import NamedTuple

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

Bound = FloatArray | float
"""One a joint, shape (n_joints,), or one for all joints."""


@dataclass(frozen=True, slots=True)
class EffortRange:
    """What a rule permits: a range, and the share of an effort in it that may act."""

    low_nm: Bound
    high_nm: Bound
    share: float = 1.0

    def nearest(self, effort_nm: FloatArray) -> FloatArray:
        """Return the permitted effort nearest to a wanted one: a permitted one to the last bit."""
        if self is ANY_EFFORT:
            return effort_nm
        nearest: FloatArray = np.minimum(np.maximum(effort_nm, self.low_nm), self.high_nm)
        return nearest if self.share == 1.0 else self.share * nearest


ANY_EFFORT = EffortRange(-math.inf, math.inf)


class Permitted(NamedTuple):
    """What the layer made of a wanted effort. Shapes (n_joints,)."""

    effort_nm: FloatArray
    changed: BoolArray


class LastEffort(NamedTuple):
    """What the arm was last permitted, and how long ago."""

    effort_nm: FloatArray
    since_s: float
    """From then to the present state; one period if nothing is known to act on the arm."""


def delay_s(since_s: float, age_s: float) -> float:
    """Return how long after its state an effort acts.

    An effort acts until the next command, and the last gap is the best guess of how long that will be. Age
    counts twice, because an effort that is held for a gap acts half of it after its state on average.
    """
    return since_s + 2.0 * age_s


@dataclass(frozen=True, kw_only=True)
class QuietBounds:
    """Bounds within which a rule never objects; it may or may not object outside.

    Without arguments: the rule never objects.
    """

    low_rad: Bound = -math.inf
    high_rad: Bound = math.inf
    speed_rad_s: Bound = math.inf
    """Largest abs(v)."""
    effort_nm: Bound = math.inf
    """Largest abs(τ)."""
    step_nm: Bound = math.inf
    """Largest abs(τ − τ_last)."""
    damping_nms_per_rad: FloatArray | None = None
    """k."""
    damped_nm: Bound = math.inf
    """Largest abs(τ + k v)."""
    since_s: float = 0.0
    """Least time since the last effort."""
    delay_s: float = math.inf
    """Largest :func:`delay_s`."""

    def __and__(self, other: QuietBounds) -> QuietBounds:
        """Return bounds within which neither of two rules objects."""
        mine, its = self.damping_nms_per_rad, other.damping_nms_per_rad
        if mine is not None and its is not None and not np.array_equal(mine, its):
            return NEVER_QUIET  # one k a joint: two of them have no common bound here
        least = {
            bound.name: np.minimum(getattr(self, bound.name), getattr(other, bound.name))
            for bound in fields(self)
            if bound.name not in ("low_rad", "damping_nms_per_rad", "since_s")
        }
        return QuietBounds(
            low_rad=np.maximum(self.low_rad, other.low_rad),
            damping_nms_per_rad=its if mine is None else mine,
            since_s=max(self.since_s, other.since_s),
            **least,
        )


NEVER_QUIET = QuietBounds(delay_s=-math.inf)


class QuietZone:
    """One quick test in place of all rules, for the many ticks in which an arm is far from every bound.

    It is derived from what the rules say of themselves: the intersection of their quiet bounds.
    """

    _MARGIN = 1e-9
    """What lies this close to a bound is left to the rules: their arithmetic rounds differently."""

    def __init__(self, bounds: Iterable[QuietBounds], n_joints: int) -> None:
        both = reduce(QuietBounds.__and__, bounds, QuietBounds())
        shrink, k = 1.0 - self._MARGIN, both.damping_nms_per_rad
        self._shortest_ns = both.since_s * NS_PER_S + 1
        self._longest_ns = both.delay_s * NS_PER_S - 1
        columns = (
            both.low_rad * (1.0 + self._MARGIN * np.sign(both.low_rad)),
            both.high_rad * (1.0 - self._MARGIN * np.sign(both.high_rad)),
            shrink * both.speed_rad_s,
            shrink * both.effort_nm,
            shrink * both.step_nm,
            np.zeros(n_joints) if k is None else k,
            shrink * both.damped_nm,
        )
        rows = (np.broadcast_to(column, n_joints).tolist() for column in columns)
        self._by_joint = list(zip(*rows, strict=True))

    def has(self, state: ArmState, wanted_nm: FloatArray, last_nm: FloatArray, since_ns: int) -> bool:
        """Return whether no rule objects to an effort, ``since_ns`` after the last one, as far as this tells.

        An effort that is NaN is never in the zone. Shapes (n_joints,).
        """
        if not self._shortest_ns <= since_ns <= delay_s(since_ns, state.age_s * NS_PER_S) <= self._longest_ns:
            return False
        # In the control loop: so few numbers are compared faster one by one than as arrays.
        for (low, high, fastest, most, step, k, most_damped), q, v, wanted, last in zip(
            self._by_joint,
            state.positions,
            state.velocities,
            wanted_nm.tolist(),
            last_nm.tolist(),
        ):
            if not (
                -step <= wanted - last <= step
                and -most <= wanted <= most
                and -most_damped <= wanted + k * v <= most_damped
                and -fastest <= v <= fastest
                and low <= q <= high
            ):
                return False
        return True


class SafetyRule(ABC):
    """Narrows what an arm may get. Rules are applied in the order of their list; later ones win."""

    @abstractmethod
    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return the efforts that may answer a measured state."""

    def quiet(self) -> QuietBounds:
        """Return bounds within which the rule never objects; by default there are none."""
        return NEVER_QUIET


class EffortRate(SafetyRule):
    """Lets efforts grow by a rate, and fall to zero at once.

    A jump of the effort shakes an arm and strains its gears; so does one from a full push to a full pull. But
    a release is never held up: a limiter that went on pushing would delay every stop. Between the last effort
    τ and the next one there are at most rate · Δt, counted from zero where the sign changes:
    min(τ, 0) − rate Δt … max(τ, 0) + rate Δt, with Δt of two control periods at most.
    """

    FULL_SWING_S = 0.02
    """Default: from one effort limit to the opposite one within this time."""
    MOST_PERIODS = 2.0
    QUIET_PERIODS = 0.5

    def __init__(self, rate_nm_per_s: FloatArray, period_s: float) -> None:
        self.rate_nm_per_s, self._period_s = rate_nm_per_s, period_s

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig, period_s: float) -> EffortRate:
        """Return the rule with the configured rate, or the default one."""
        if safety.effort_rate_nm_per_s:
            return cls(np.array(safety.effort_rate_nm_per_s), period_s)
        return cls(2.0 * np.array(arm.effort_limit_nm) / cls.FULL_SWING_S, period_s)

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return what may follow the last effort."""
        effort_nm, step_nm = last.effort_nm, self._step_nm(last)
        return EffortRange(np.minimum(effort_nm, 0.0) - step_nm, np.maximum(effort_nm, 0.0) + step_nm)

    def quiet(self) -> QuietBounds:
        """Return the change that half a period permits, from half a period on."""
        since_s = self.QUIET_PERIODS * self._period_s
        return QuietBounds(step_nm=self.rate_nm_per_s * since_s, since_s=since_s)

    def towards_zero(self, last: LastEffort) -> FloatArray:
        """Return the effort that follows the last one if it fades as slowly as it may grow."""
        step_nm = self._step_nm(last)
        fading = last.effort_nm - np.copysign(step_nm, last.effort_nm)
        return np.where(np.abs(last.effort_nm) > step_nm, fading, 0.0)

    def _step_nm(self, last: LastEffort) -> FloatArray:
        return self.rate_nm_per_s * min(last.since_s, self.MOST_PERIODS * self._period_s)


class EffortLimit(SafetyRule):
    """Keeps efforts within the configured limits."""

    def __init__(self, arm: ArmConfig) -> None:
        limit_nm = np.array(arm.effort_limit_nm)
        self.range = EffortRange(-limit_nm, limit_nm)

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return the limits."""
        return self.range

    def quiet(self) -> QuietBounds:
        """Return the limits."""
        return QuietBounds(effort_nm=self.range.high_nm)


class LateStates(SafetyRule):
    """Reduces efforts that answer late states.

    A damper's effort that acts for long after the speed that it was computed from feeds energy in, whether
    it is held for long or was late from the start: with one state every 20 to 60 ms, or states that are 20 to
    60 ms old, each well within any time-out, the springs of the ready arms drive them beyond all limits. With
    the effort reduced in proportion, what it does until the next command is at most what it does when nothing
    is late.
    """

    PUNCTUAL_S, PUNCTUAL_PERIODS = 0.010, 2.0
    """A state whose effort acts within this time, or this many control periods, is not late."""
    LEAST_SHARE = 0.5
    """Where less than this share of an effort may act, nobody really commands the arm. What holds it, a
    latched brake or a soft limit, begins anew with every state: it would be wound up meanwhile, and fling the
    arm once states are punctual again."""

    def __init__(self, period_s: float) -> None:
        self.punctual_s = max(self.PUNCTUAL_S, self.PUNCTUAL_PERIODS * period_s)

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return the share of an effort that may act."""
        share = self.share(last.since_s, state.age_s)
        return ANY_EFFORT if share == 1.0 else EffortRange(-math.inf, math.inf, share)

    def share(self, since_s: float, age_s: float) -> float:
        """Return which share of an effort may act, for the time since the last one and the state's age."""
        late_s = delay_s(since_s, age_s)
        return 1.0 if late_s <= self.punctual_s else self.punctual_s / late_s

    def quiet(self) -> QuietBounds:
        """Return that states are punctual."""
        return QuietBounds(delay_s=self.punctual_s)
