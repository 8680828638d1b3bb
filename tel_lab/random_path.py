"""Random smooth paths: movements that nobody chose, to test with."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.paths import Derivatives, Path
from tel_ros.core.types import FloatArray

_CYCLES_CLOSED = (1.0, 2.0, 3.0)
_CYCLES_OPEN = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)

_REACH_RAD = (0.5, 0.9)
"""Between these lies the sum of a joint's amplitudes; planar_loops has 0.65 and 0.75."""

_SHARE_OF_RANGE = 0.4
"""The sum of a joint's amplitudes takes at most this share of its range, so that the middle can vary."""


def random_smooth_path(seed: int, low_rad: npt.ArrayLike, high_rad: npt.ArrayLike) -> Path:
    """Return a random sum of a few harmonics for each joint; it is ours, not the paper's.

    Each joint swings about a random angle, q = c + Σ a_k sin(2π k s + φ_k), with random a_k and φ_k. One path
    in two is closed (whole k up to 3, as in ``planar_loops``), the others have halves of k as well and end
    elsewhere; high k are favoured in proportion to k². The amplitudes of a joint add up to 0.5 to 0.9 rad, or
    to less where its range is narrower than that asks for. So the path stays inside the range at every s, all
    its derivatives are continuous, and it is about as demanding as ``planar_loops``: at equal duration the
    peak acceleration of nine in ten (two joints, wide ranges) is 0.45 to 1.35 times as high, in the median
    0.9 times. Equal arguments give equal paths.

    Args:
        seed: at least 0.
        low_rad: lower end of each joint's range. Shape (n_joints,).
        high_rad: upper end of each joint's range. Shape (n_joints,).

    Raises:
        ConfigError: the ranges are not finite, not of one shape or empty, or the seed is negative.
    """
    low, high = _checked_range(low_rad, high_rad)
    if seed < 0:
        raise ConfigError("seed", seed, "a whole number of at least 0")
    random = np.random.default_rng((_STREAM, seed))
    cycles = np.array(_CYCLES_CLOSED if random.random() < 0.5 else _CYCLES_OPEN)
    share = random.dirichlet(np.ones(len(cycles)), size=len(low)) * cycles**2
    share /= share.sum(axis=1, keepdims=True)
    reach = np.minimum(random.uniform(*_REACH_RAD, size=len(low)), _SHARE_OF_RANGE * (high - low))
    amplitude = reach[:, None] * share
    phase = random.uniform(0.0, 2.0 * math.pi, size=share.shape)
    centre = random.uniform(low + reach, high - reach)
    omega = 2.0 * math.pi * cycles

    def evaluate(s: FloatArray) -> Derivatives:
        angle = s[:, None, None] * omega + phase  # (n, n_joints, n_harmonics)
        sine, cosine = np.sin(angle), np.cos(angle)
        return (
            centre + np.sum(amplitude * sine, axis=2),
            np.sum(amplitude * omega * cosine, axis=2),
            -np.sum(amplitude * omega**2 * sine, axis=2),
        )

    return Path(f"random_{seed}", len(low), evaluate)


_STREAM = 0x70617468
"""Makes the draws for a seed independent of what other modules draw for the same seed."""


def _checked_range(low_rad: npt.ArrayLike, high_rad: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    low, high = np.asarray(low_rad, dtype=np.float64), np.asarray(high_rad, dtype=np.float64)
    if low.ndim != 1 or len(low) == 0 or not np.all(np.isfinite(low)):
        raise ConfigError("low_rad", _plain(low), "finite angles, one for each joint")
    if high.shape != low.shape or not np.all(np.isfinite(high)) or not np.all(low < high):
        raise ConfigError("high_rad", _plain(high), f"finite angles above {low.tolist()}")
    return low, high


def _plain(values: FloatArray) -> Sequence[float] | float:
    plain: Sequence[float] | float = values.tolist()
    return plain
