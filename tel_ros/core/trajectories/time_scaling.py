"""Time scaling: how far along its path the movement is at each moment."""

from __future__ import annotations

import numpy as np

from tel_ros.core.types import FloatArray


def minimum_jerk(phase: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the minimum-jerk time scaling s and its first two derivatives.

    s = 10 p³ - 15 p⁴ + 6 p⁵ goes from rest at 0 to rest at 1 (Flash and Hogan 1985; the paper does not
    say which scaling it used, this one is our choice).

    Args:
        phase: elapsed share p of the duration; values outside 0 … 1 are held at the ends. Shape (n,).

    Returns:
        s, ds/dp and d²s/dp², each of shape (n,).
    """
    p = np.clip(phase, 0.0, 1.0)
    # Products, since NumPy's powers differ in the last bit from one processor to another.
    s = p * p * p * (10.0 + p * (-15.0 + 6.0 * p))
    ds = 30.0 * p**2 * (1.0 - p) ** 2
    dds = 60.0 * p * (1.0 - p) * (1.0 - 2.0 * p)
    return s, ds, dds


MINIMUM_JERK_PEAK_SPEED = 1.875
"""Peak of ds/dp, at p = 1/2."""
