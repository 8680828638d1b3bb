"""Smaller efforts for states that come late."""

from __future__ import annotations

PUNCTUAL_S = 0.010
"""A state that comes within this time of the one before is not late..."""
PUNCTUAL_PERIODS = 2.0
"""... nor within this many control periods."""

AGE_COUNTS = 2.0
"""An effort that is held for a gap acts half of it after its state on average: age counts that much more."""

LEAST_SHARE = 0.5
"""Where less than this share of an effort may act nobody really commands the arm. What holds it, a brake that
was latched or a soft limit, begins anew with every state: it would be wound up meanwhile, and fling the arm
once states are punctual again."""


def punctual_s(period_s: float) -> float:
    """Return for how long [s] a state is awaited before it counts as late."""
    return max(PUNCTUAL_S, PUNCTUAL_PERIODS * period_s)


def share_of_effort(since_last_s: float, period_s: float, age_s: float = 0.0) -> float:
    """Return which share of an effort may act, given how long the last one had to and how old its state is.

    An effort acts until the next command, and the last gap is the best guess of how long that will be. A
    damper's effort that acts for long after the speed that it was made of feeds energy in, whether it is held
    for long or was late from the start: with one state every 20 to 60 ms, or states that are 20 to 60 ms old,
    each well within any time-out, the springs of the ready arms drive them beyond all limits. With the effort
    reduced in proportion, what it does until the next command is at most what it does when nothing is late.

    Args:
        since_last_s: time between the last two states that were answered.
        period_s: of control.
        age_s: how late the state has come.
    """
    in_time_s, late_s = punctual_s(period_s), since_last_s + AGE_COUNTS * age_s
    return 1.0 if late_s <= in_time_s else in_time_s / late_s
