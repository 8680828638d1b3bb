"""Deciding by samples that have not been learned from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tel_ros.core.types import BoolArray, FloatArray

CLEARLY = 0.98
"""A held-out error has to fall below this part of what it was before anything is changed for it."""
_FACTOR = 10.0
_RANGE = (1e-7, 1e4)
_SLICES = 10
_SURPRISING = 1.5
"""RMS error in units of the expected one from which on a change of the arm is looked for."""
_CONTRADICTION = 2.4
"""How many times worse than it ought to be a fit to all trials has to be. On the default arm a payload of
0.5 kg makes 2.9 with much unmodelled friction and 26 without; new kinds of movements stay below 2.0."""
CHANGED = "the arm has changed: earlier trials are forgotten"


def alternate_slices(n: int) -> BoolArray:
    """Return which of n samples in a row to learn from when the others are held out: every second slice.

    Slices, because a sample between two others that have been learned from is no test.
    """
    slices: BoolArray = (np.arange(n) * min(_SLICES, n) // max(n, 1)) % 2 == 0
    return slices


def better_strength(now: float, error_with: Callable[[float], float]) -> tuple[float, float]:
    """Return the strength of a prior to go on with, and its held-out error.

    The strength stays as it is, or becomes ten times more or less.

    Args:
        now: strength at present.
        error_with: held-out error as a function of the strength.
    """
    best, least = now, error_with(now)
    for factor in (_FACTOR, 1.0 / _FACTOR):
        strength = now * factor
        if _RANGE[0] <= strength <= _RANGE[1]:
            error = error_with(strength)
            if error < CLEARLY * least:
                best, least = strength, error
    return best, least


def arm_has_changed(
    error_rad: FloatArray,
    std_rad: FloatArray,
    usual_rad: FloatArray,
    residuals: Callable[[], tuple[FloatArray, FloatArray]],
) -> bool:
    """Return whether a trial tells of another arm than the earlier ones.

    A bad prediction alone does not: the movement may be of a kind not seen before. But then model and trials
    go together once the trial has been learned from. A change shows in a fit to all trials that is much worse
    for the new one than a fit to it alone, and much worse than such fits have been, averaged over joints.

    Args:
        error_rad: of the prediction of the trial. Shape (n, n_joints).
        std_rad: what was expected of it. Shape (n, n_joints).
        usual_rad: RMS residual of the trial before, after it had been learned. Shape (n_joints,).
        residuals: RMS residual of the new trial in a fit to all, and in a fit to it alone, each of shape
            (n_joints,); asked for only if the trial is a surprise.
    """
    if np.sqrt(np.mean((error_rad / std_rad) ** 2)) < _SURPRISING:
        return False
    together_rad, alone_rad = residuals()
    least = np.finfo(float).tiny
    contradiction = together_rad / np.maximum(np.maximum(alone_rad, usual_rad), least)
    return bool(np.exp(np.mean(np.log(np.maximum(contradiction, least)))) > _CONTRADICTION)
