"""Where a trial's command error is applied, and what training changed."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import Learner, TrainingMode, TrainingOutcome
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

_ENOUGH = 1000
"""Samples, evenly spread over a trial, that an RMS value is computed from."""


def training_pair(
    mode: TrainingMode, samples: TrainingSamples, predict: Callable[[FloatArray], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the inputs to train the network at, and what it should say there.

    Only the command û that was sent has a known outcome ŷ, so the error is always δ = û - N(ŷ). ``actual``
    removes it at ŷ, ``desired`` changes the output at y by the same δ ([Practice] Sec. 2.1 and Fig. 1;
    convergence by Theorems 2 and 1). δ is that of the network before training, as in Theorem 1.

    Args:
        mode: where to apply the error.
        samples: one trial.
        predict: N, from shape (n, 3 * n_joints) to offsets u - q of shape (n, n_joints).

    Returns:
        Inputs of shape (n, 3 * n_joints) and targets in rad of shape (n, n_joints).
    """
    for name in ("actual", "desired", "offset_rad"):
        if not np.all(np.isfinite(getattr(samples, name))):
            raise TrainingError(f"{name} has values that are not finite; the network is unchanged")
    if mode == "actual":
        return samples.actual, samples.offset_rad
    return samples.desired, predict(samples.desired) + samples.offset_rad - predict(samples.actual)


def outcome(
    before: Learner, after: Learner, samples: TrainingSamples, grown: tuple[str, ...]
) -> TrainingOutcome:
    """Return what training on a trial has changed.

    Raises:
        TrainingError: a figure is not finite; ``after`` must not be used then.
    """
    rows = slice(None, None, max(1, len(samples.offset_rad) // _ENOUGH))
    desired, actual, offset_rad = samples.desired[rows], samples.actual[rows], samples.offset_rad[rows]
    rms_rad = (
        rms(offset_rad - before.predict(actual)),
        rms(offset_rad - after.predict(actual)),
        rms(after.predict(desired) - before.predict(desired)),
    )
    if not all(map(math.isfinite, rms_rad)):
        raise TrainingError(f"the RMS errors {rms_rad} rad are not finite; the network is unchanged")
    return TrainingOutcome(*rms_rad, grown=grown)


def rms(values: FloatArray) -> float:
    """Return the root of the mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))
