"""Random smooth paths: movements that nobody chose, to test with."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.paths import Derivatives, Path
from tel_ros.core.types import FloatArray

_REACH_RAD = (0.5, 0.9)
"""Between these lies the sum of a joint's amplitudes; planar_loops has 0.65 and 0.75. It takes at most 0.4 of
the joint's range, so that the middle can vary."""


def random_smooth_path(seed: int, low_rad: npt.ArrayLike, high_rad: npt.ArrayLike) -> Path:
    """Return a random sum of a few harmonics for each joint; it is ours, not the paper's.

    Each joint swings about a random angle, q = c + Σ a_k sin(2π k s + φ_k), with random a_k and φ_k. One path
    in two is closed (whole k up to 3, as in ``planar_loops``), the others have halves of k as well and end
    elsewhere; high k are favoured in proportion to k². The amplitudes of a joint add up to 0.5 to 0.9 rad, or
    to less where its range is narrower than that asks for. So the path stays inside the range at every s, all
    its derivatives are continuous, and it is about as demanding as ``planar_loops``: at equal duration the
    peak acceleration of nine in ten (two joints, wide ranges) is 0.45 to 1.35 times as high, in the median
    0.9 times. Equal arguments give equal paths.

    Raises:
        ConfigError: the ranges are not finite, not of one shape or empty, or the seed is negative.
    """
    low, high = np.asarray(low_rad, dtype=np.float64), np.asarray(high_rad, dtype=np.float64)
    if low.ndim != 1 or len(low) == 0 or not np.all(np.isfinite(low)):
        raise ConfigError("low_rad", low.tolist(), "finite angles, one for each joint")
    if high.shape != low.shape or not np.all(np.isfinite(high)) or not np.all(low < high):
        raise ConfigError("high_rad", high.tolist(), f"finite angles above {low.tolist()}")
    if seed < 0:
        raise ConfigError("seed", seed, "a whole number of at least 0")
    # With a stream of its own: the draws are independent of what other modules draw for the same seed.
    random = np.random.default_rng((0x70617468, seed))
    cycles = np.array((1.0, 2.0, 3.0) if random.random() < 0.5 else (0.5, 1.0, 1.5, 2.0, 2.5, 3.0))
    share = random.dirichlet(np.ones(len(cycles)), size=len(low)) * cycles**2
    share /= share.sum(axis=1, keepdims=True)
    reach = np.minimum(random.uniform(*_REACH_RAD, size=len(low)), 0.4 * (high - low))
    amplitude = reach[:, None] * share
    phase = random.uniform(0.0, 2.0 * math.pi, size=share.shape)
    centre = random.uniform(low + reach, high - reach)
    return sine_path(f"random_{seed}", centre, amplitude, 2.0 * math.pi * cycles, phase)


def sine_path(
    name: str, centre_rad: FloatArray, amplitude_rad: FloatArray, omega: FloatArray, phase: FloatArray
) -> Path:
    """Return a path on which every joint follows a sum of sines about its centre; arrays as for ``sines``."""

    def evaluate(s: FloatArray) -> Derivatives:
        position_rad, *derivatives = sines(s, amplitude_rad, omega, phase)
        return (centre_rad + position_rad, derivatives[0], derivatives[1])

    return Path(name, len(centre_rad), evaluate)


def sines(t: FloatArray, amplitude: FloatArray, omega: FloatArray, phase: FloatArray) -> Derivatives:
    """Return sums of sines at n moments with their derivatives, each of shape (n, n_joints).

    Amplitudes and phases are of shape (n_joints, n_sines); frequencies likewise, or the same for all joints.
    """
    angle = omega * t[:, None, None] + phase
    sine, cosine = np.sin(angle), np.cos(angle)
    return (
        np.sum(amplitude * sine, axis=2),
        np.sum(amplitude * omega * cosine, axis=2),
        -np.sum(amplitude * omega**2 * sine, axis=2),
    )
