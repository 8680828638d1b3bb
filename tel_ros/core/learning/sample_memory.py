"""The samples that a least-squares learner keeps, so that what grows later can still learn from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import BoolArray, FloatArray, IntArray

_SAMPLES_PER_PERIOD = 5.0
"""Samples kept for each period of the highest frequency that the filter has left: neighbours that lie
closer repeat each other."""


@dataclass(frozen=True)
class SampleMemory:
    """Weighted samples of all trials, oldest first.

    Args:
        inputs: SI units. Shape (n, 3 * n_joints).
        targets_rad: shape (n, n_joints).
        noise: standard deviation of the noise in each input. Shape (n, 3 * n_joints).
        weight: shape (n,).
        trial: number of the trial that each sample is from. Shape (n,).
        trust: how far each target can be believed, 0 to 1: less where the joint may have stuck (see
            :mod:`.sliding`). Shape (n, n_joints).
    """

    inputs: FloatArray
    targets_rad: FloatArray
    noise: FloatArray
    weight: FloatArray
    trial: IntArray
    trust: FloatArray

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
        """Return the samples of one trial, thinned out to what tells something new."""
        step = thinning(samples)
        inputs, targets_rad = inputs[::step], targets_rad[::step]
        noise = samples.input_noise if len(samples.input_noise) else np.zeros(inputs.shape[1])
        n = len(inputs)
        trust = np.ones(targets_rad.shape)
        return cls(inputs, targets_rad, np.tile(noise, (n, 1)), np.ones(n), np.full(n, trial), trust)

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], n_joints: int) -> Self:
        """Return a memory from its arrays.

        Raises:
            ValueError: their shapes do not fit together, or they hold numbers that are not finite.
        """
        names = ("inputs", "targets_rad", "noise", "weight", "trial", "trust")
        n = len(arrays["memory_weight"])
        # Files from before sticking was told apart have no trust: everything was believed.
        known = {"memory_trust": np.ones((n, n_joints))} | dict(arrays)
        values = [known[f"memory_{name}"] for name in names]
        shapes = [(n, 3 * n_joints), (n, n_joints), (n, 3 * n_joints), (n,), (n,), (n, n_joints)]
        for name, array, shape in zip(names, values, shapes, strict=True):
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise ValueError(f"memory_{name} has shape {array.shape}; expected finite numbers of {shape}")
        return cls(*values)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return it as arrays."""
        return {
            "memory_inputs": self.inputs,
            "memory_targets_rad": self.targets_rad,
            "memory_noise": self.noise,
            "memory_weight": self.weight,
            "memory_trial": self.trial,
            "memory_trust": self.trust,
        }

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.weight)

    def __getitem__(self, rows: slice | BoolArray) -> Self:
        """Return some of the samples."""
        return type(self)(
            self.inputs[rows],
            self.targets_rad[rows],
            self.noise[rows],
            self.weight[rows],
            self.trial[rows],
            self.trust[rows],
        )

    def joined(self, newer: Self) -> Self:
        """Return this memory followed by another."""
        return type(self)(
            np.concatenate([self.inputs, newer.inputs]),
            np.concatenate([self.targets_rad, newer.targets_rad]),
            np.concatenate([self.noise, newer.noise]),
            np.concatenate([self.weight, newer.weight]),
            np.concatenate([self.trial, newer.trial]),
            np.concatenate([self.trust, newer.trust]),
        )

    def trusted(self, trust: FloatArray) -> Self:
        """Return the same samples, believed this far. ``trust`` has shape (n, n_joints)."""
        return replace(self, trust=trust)

    def discounted(self, factor: float) -> Self:
        """Return the same samples with other weights."""
        return replace(self, weight=factor * self.weight)

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
    """Return of how many samples in a row one tells all that they tell."""
    if not (samples.period_s > 0.0 and np.isfinite(samples.bandwidth_hz)):
        return 1
    return max(1, int(1.0 / (_SAMPLES_PER_PERIOD * samples.bandwidth_hz * samples.period_s)))


def counted(error_rad: FloatArray, trust: FloatArray) -> FloatArray:
    """Return errors whose mean squares are the means of the squares of the given ones, weighted with trust.

    Args:
        error_rad: shape (n, n_joints).
        trust: above 0. Shape (n, n_joints).

    Returns:
        Shape (n, n_joints).
    """
    result: FloatArray = error_rad * np.sqrt(trust / np.mean(trust, axis=0))
    return result
