"""What learners keep of earlier trials, and what each new trial decides before it is learned."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import BoolArray, FloatArray, IntArray

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
_LEAST_TRUST = 1e-12
"""Above zero, so that the weighted mean of samples none of which slides is one."""
_SAMPLES_PER_PERIOD = 5.0
"""Of the highest frequency that the filter has left: closer neighbours repeat each other."""


@dataclass(frozen=True)
class SampleMemory:
    """Weighted samples of all trials, oldest first. Shapes as in :meth:`empty`, with n rows."""

    inputs: FloatArray
    targets_rad: FloatArray
    noise: FloatArray
    """Standard deviation of the noise in each input."""
    weight: FloatArray
    trial: IntArray
    """Number of each sample's trial."""
    trust: FloatArray
    """Weight of each target, 0 to 1: less where the joint may have stuck."""

    @classmethod
    def empty(cls, n_joints: int) -> Self:
        """Return a memory without samples."""
        none = np.empty((0, 3 * n_joints))
        no_target = np.empty((0, n_joints))
        return cls(none, no_target, none, np.empty(0), np.empty(0, dtype=np.int64), no_target)

    @classmethod
    def of_trial(
        cls, samples: TrainingSamples, inputs: FloatArray, targets_rad: FloatArray, trial: int
    ) -> Self:
        """Return the samples of one trial, thinned out to those that add something new."""
        step = thinning(samples)
        inputs, targets_rad = inputs[::step], targets_rad[::step]
        noise = samples.input_noise if len(samples.input_noise) else np.zeros(inputs.shape[1])
        n = len(inputs)
        trust = np.ones(targets_rad.shape)
        return cls(inputs, targets_rad, np.tile(noise, (n, 1)), np.ones(n), np.full(n, trial), trust)

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], n_joints: int) -> Self:
        """Return a memory from its arrays; raise ValueError unless their shapes fit and all is finite."""
        n = len(arrays["memory_weight"])
        # Older files have no trust: everything was believed.
        known = {"memory_trust": np.ones((n, n_joints))} | dict(arrays)
        shapes = [(n, 3 * n_joints), (n, n_joints), (n, 3 * n_joints), (n,), (n,), (n, n_joints)]
        values = {field.name: known[f"memory_{field.name}"] for field in fields(cls)}
        for (name, array), shape in zip(values.items(), shapes, strict=True):
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise ValueError(f"memory_{name} has shape {array.shape}; expected finite numbers of {shape}")
        return cls(**values)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return it as arrays."""
        return {f"memory_{name}": array for name, array in vars(self).items()}

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.weight)

    def __getitem__(self, rows: slice | BoolArray) -> Self:
        """Return some of the samples."""
        return type(self)(*(array[rows] for array in vars(self).values()))

    def joined(self, newer: Self) -> Self:
        """Return this memory followed by another."""
        both = zip(vars(self).values(), vars(newer).values(), strict=True)
        return type(self)(*map(np.concatenate, both))

    def bounded(self, most: int) -> Self:
        """Return at most so many samples: of the oldest trials every second one goes, for double weight."""
        memory = self
        while len(memory) > most:
            old = np.flatnonzero(memory.trial <= np.quantile(memory.trial, 0.5, method="lower"))
            weight = memory.weight.copy()
            weight[old] *= 2.0
            keep = np.ones(len(memory), dtype=bool)
            keep[old[1::2]] = False
            memory = replace(memory, weight=weight)[keep]
        return memory


def thinning(samples: TrainingSamples) -> int:
    """Return n, where every n-th sample of a trial is enough to keep."""
    if not (samples.period_s > 0.0 and np.isfinite(samples.bandwidth_hz)):
        return 1
    return max(1, int(1.0 / (_SAMPLES_PER_PERIOD * samples.bandwidth_hz * samples.period_s)))


def counted(error_rad: FloatArray, trust: FloatArray) -> FloatArray:
    """Return errors scaled so that their mean squares are those of the given ones, weighted with trust > 0.

    All of shape (n, n_joints).
    """
    return error_rad * np.sqrt(trust / np.mean(trust, axis=0))


def stuck_trust(residual_rad: FloatArray, sliding: BoolArray, coulomb_rad: FloatArray) -> FloatArray:
    """Return the weight in a fit of a sample whose joint may stick, relative to one whose joint slides.

    That is the ratio of their variances: to the residual of the sliding ones, sticking adds a torque that may
    be anything within ±c, with variance c² / 3. Without dry friction all samples count the same. So they do
    for a joint that never slides: the torque that holds it still is all that can be learned.

    ``residual_rad``, shape (n, n_joints), is that of a fit to the samples that slide
    (:func:`~.noise.slides_throughout`), ``coulomb_rad`` the c / K that it has found. Above 0, up to 1.
    """
    n_sliding = np.count_nonzero(sliding, axis=0)
    squares = np.sum(np.where(sliding, residual_rad, 0.0) ** 2, axis=0)
    # Above zero, so that with neither friction nor residual there is no 0 / 0.
    variance = np.maximum(squares / np.maximum(n_sliding, 1), np.finfo(float).tiny)
    result: FloatArray = np.where(n_sliding > 0, variance / (variance + coulomb_rad**2 / 3.0), 1.0)
    return np.maximum(result, _LEAST_TRUST)


def alternate_slices(n: int) -> BoolArray:
    """Return which of n samples in a row to learn from when the others are held out: every second slice.

    Slices, because a sample between two others that have been learned from is no test.
    """
    return (np.arange(n) * min(_SLICES, n) // max(n, 1)) % 2 == 0


def better_strength(now: float, error_with: Callable[[float], float]) -> tuple[float, float]:
    """Return the strength of a prior to go on with (the same, ten times more or less) and its held-out error.

    ``error_with`` returns the held-out error with a strength.
    """
    best, least = now, error_with(now)
    for strength in (now * _FACTOR, now * (1.0 / _FACTOR)):
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
    """Return whether a trial shows another arm than the earlier ones.

    A bad prediction alone does not: the movement may be of a kind not seen before. But then model and trials
    fit together once the trial has been learned from. A change shows in a fit to all trials that is much
    worse for the new one than a fit to it alone, and much worse than such fits have been, averaged over
    joints.

    Errors of the prediction and what was expected of them have the shape (n, n_joints). ``usual_rad``, shape
    (n_joints,), is the RMS residual of the trial before, after it had been learned; ``residuals`` returns
    that of the new trial in a fit to all, and in a fit to it alone. It is called only after a surprise.
    """
    if np.sqrt(np.mean((error_rad / std_rad) ** 2)) < _SURPRISING:
        return False
    together_rad, alone_rad = residuals()
    least = np.finfo(float).tiny
    contradiction = together_rad / np.maximum(np.maximum(alone_rad, usual_rad), least)
    return bool(np.exp(np.mean(np.log(np.maximum(contradiction, least)))) > _CONTRADICTION)
