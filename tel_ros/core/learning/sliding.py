"""When dry friction tells its size, and when it does not: joints that slide and joints that may stick.

A joint that slides is held back by c sgn(q̇). One that sticks is held by whatever keeps it still, anything
within ±c (the set-valued law of Coulomb, f ∈ c Sgn(q̇)). What was commanded then says next to nothing about
inertia, gravity or c, and where springs are weak it is far off.
"""

from __future__ import annotations

import numpy as np
import scipy  # loads its parts when they are first used: half a second that most processes do without

from tel_ros.core.types import BoolArray, FloatArray

SLOWEST_SLIDING_RAD_S = 0.05
"""A joint that is slower may stick and slip by turns, of which a low-pass leaves the mean."""
_CLEAR_OF_NOISE = 3.0
"""Standard deviations of the velocity that count as movement."""
_LEAST_TRUST = 1e-12
"""Above zero, so that the weighted mean of samples none of which slides is one."""


def slides_throughout(velocity_rad_s: FloatArray, noise_rad_s: FloatArray, reach: int) -> BoolArray:
    """Return when each joint moves in one direction in all that a sample is made of.

    The low-pass rounds the step that friction takes at a reversal, so the neighbourhood of a reversal is as
    little to be trusted as the reversal.

    Args:
        velocity_rad_s: filtered, evenly sampled. Shape (n, n_joints).
        noise_rad_s: standard deviation of what is left of the noise in it. Shape (n_joints,).
        reach: ticks on either side that the filter mixes into a sample.

    Returns:
        Shape (n, n_joints).
    """
    moves = np.maximum(SLOWEST_SLIDING_RAD_S, _CLEAR_OF_NOISE * noise_rad_s)
    size = 2 * reach + 1
    forwards = scipy.ndimage.minimum_filter1d(velocity_rad_s, size, axis=0, mode="nearest") > moves
    backwards = scipy.ndimage.maximum_filter1d(velocity_rad_s, size, axis=0, mode="nearest") < -moves
    result: BoolArray = forwards | backwards
    return result


def stuck_trust(residual_rad: FloatArray, sliding: BoolArray, coulomb_rad: FloatArray) -> FloatArray:
    """Return what a sample whose joint may stick counts in a fit, in units of one whose joint slides.

    That is the ratio of their variances: to the residual of the sliding ones, sticking adds a torque that may
    be anything within ±c, with variance c² / 3. Without dry friction all samples count the same. So they do
    for a joint that never slides: what holds it still is all that there is to learn.

    Args:
        residual_rad: of a fit to the sliding samples. Shape (n, n_joints).
        sliding: see :func:`slides_throughout`. Shape (n, n_joints).
        coulomb_rad: c / K that the fit has found. Shape (n_joints,).

    Returns:
        Above 0, up to 1. Shape (n_joints,).
    """
    n_sliding = np.count_nonzero(sliding, axis=0)
    squares = np.sum(np.where(sliding, residual_rad, 0.0) ** 2, axis=0)
    # Above zero, so that neither friction nor residual is no 0 / 0.
    variance = np.maximum(squares / np.maximum(n_sliding, 1), np.finfo(float).tiny)
    result: FloatArray = np.where(n_sliding > 0, variance / (variance + coulomb_rad**2 / 3.0), 1.0)
    return np.maximum(result, _LEAST_TRUST)
