"""Learning torque from recordings, and how good the result is where it was not learned.

At 125 Hz neighbours are nearly equal: to test, whole blocks of time are held out, with a distance that the
filter cannot bridge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tel_ros.core.errors import TrainingError, counted
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner
from tel_ros.core.learning.torque_samples import TorqueSamples, recorded_range
from tel_ros.core.types import BoolArray, FloatArray

UNCERTAIN = 0.5
"""Standard deviation, in units of the spread of the recorded torque, from which on a prediction says little:
an untrained guess has 1."""
_ROUNDING = 1e-9
_PORTION = 1000
"""Queries at a time: the standard deviation of a rigid arm needs all of its regressor."""
N_FOLDS = 5
_BLOCKS_PER_FOLD = 4
_SHORTEST_GAP_S = 0.2
_GAP_PERIODS = 2.0
"""Of the cutoff: the filter spreads an event over one of them to either side."""
_GAPS_PER_BLOCK = 4.0

NewLearner = Callable[[InputRange, FloatArray, FloatArray], Learner]
"""From the input ranges, and for each joint the unit of torque [N·m] and ``std_factor``, to a new learner."""


@dataclass(frozen=True)
class TorquePrediction:
    """What a learner says of n states of motion. Shapes (n, n_joints), ``outside`` (n, 3 * n_joints)."""

    torque_nm: FloatArray
    std_nm: FloatArray
    """Of its error, scaled by the errors that were tested; inf where nothing is known."""
    outside: BoolArray
    """Which inputs are outside of the learner's input range."""
    uncertain: BoolArray
    """Where the standard deviation is near that of a guess."""

    @property
    def extrapolated(self) -> BoolArray:
        """Where it is a guess in one respect or the other. Shape (n,)."""
        return np.asarray(self.outside.any(axis=1) | self.uncertain.any(axis=1), dtype=np.bool_)


def predict_torque(learner: Learner, inputs: FloatArray) -> TorquePrediction:
    """Ask a learner for torques: τ = K N(q, q̇, q̈) - B q̇, with the K and B that it has learned with.

    Of a learner of torque K is the spread of the recorded torques, and B is 0. A learner of equilibrium
    points does not know how large torques usually are; there only an unbounded standard deviation counts as
    uncertain. ``inputs`` are q, q̇, q̈ of shape (n, 3 * n_joints).
    """
    context = learner.context
    stiffness, damping = np.array(context.stiffness_nm_per_rad), np.array(context.damping_nms_per_rad)
    n_joints = len(context.joints)
    velocity = inputs[:, n_joints : 2 * n_joints]
    std = [learner.std(inputs[k : k + _PORTION]) for k in range(0, len(inputs), _PORTION)]
    std_rad = np.vstack(std or [np.empty((0, n_joints))])
    std_rad *= np.array(context.std_factor or (1.0,) * n_joints)
    allowed = UNCERTAIN if context.predicts == "torque" else np.finfo(np.float64).max
    range_ = context.input_range
    slack = _ROUNDING * range_.width
    return TorquePrediction(
        torque_nm=stiffness * learner.predict(inputs) - damping * velocity,
        std_nm=stiffness * std_rad,
        outside=(inputs < range_.low - slack) | (inputs > range_.high + slack),
        uncertain=~(std_rad <= allowed),
    )


@dataclass(frozen=True)
class HeldOutError:
    """Errors of predictions of blocks that were not learned from. Arrays of shape (n_joints,)."""

    nmse: FloatArray
    """Mean square error over variance of the torque."""
    rms_nm: FloatArray
    expected_rms_nm: FloatArray
    """From the learners' standard deviations."""
    within_2_std: float
    """Share of the errors within two standard deviations; 0.95 of a normal distribution."""
    extrapolated: float
    """Share of the samples that lay outside of what was learned from, or were uncertain."""
    n_samples: int

    @property
    def std_factor(self) -> FloatArray:
        """How many times larger errors were than expected; 1 where that is not known. Shape (n_joints,)."""
        known = np.isfinite(self.expected_rms_nm) & (self.expected_rms_nm > 0.0) & (self.rms_nm > 0.0)
        return np.divide(self.rms_nm, self.expected_rms_nm, out=np.ones(len(known)), where=known)


@dataclass(frozen=True)
class Fit:
    """A learner of torque that has learned from all blocks of time, and what is known of it."""

    learner: Learner
    held_out: HeldOutError
    """Of others like it, which had learned from four fifths and were asked for the rest."""
    n_blocks: int
    block_s: float
    """Mean duration."""


def fit_torque(parts: Sequence[TorqueSamples], new_learner: NewLearner) -> Fit:
    """Learn torque from unbroken parts: five times from four fifths, to see how good that is, then from all.

    Raises:
        TrainingError: too little was recorded, or what was learned is not finite.
    """
    blocks = blocks_of(parts)
    held_out = held_out_error([_asked(fold, new_learner) for fold in folds(parts, blocks)])
    whole = [block.of(parts) for block in blocks]
    learner = _learned(whole, new_learner, held_out.std_factor)
    return Fit(learner, held_out, len(blocks), float(np.mean([len(b) * b.period_s for b in whole])))


def held_out_error(asked: Sequence[tuple[FloatArray, TorquePrediction]]) -> HeldOutError:
    """Return the errors of predictions, from pairs of recorded torques (n, n_joints) and predictions."""
    torque_nm = np.vstack([recorded for recorded, _ in asked])
    error_nm = torque_nm - np.vstack([prediction.torque_nm for _, prediction in asked])
    square = np.mean(error_nm**2, axis=0)
    std_nm = np.vstack([prediction.std_nm for _, prediction in asked])
    extrapolated = np.concatenate([prediction.extrapolated for _, prediction in asked])
    return HeldOutError(
        nmse=square / np.var(torque_nm, axis=0),
        rms_nm=np.sqrt(square),
        expected_rms_nm=np.sqrt(np.mean(std_nm**2, axis=0)),
        within_2_std=float(np.mean(np.abs(error_nm) <= 2.0 * std_nm)),
        extrapolated=float(np.mean(extrapolated)),
        n_samples=len(torque_nm),
    )


def _asked(fold: Fold, new_learner: NewLearner) -> tuple[FloatArray, TorquePrediction]:
    torque_nm = np.vstack([block.torque_nm for block in fold.held_out])
    learner = _learned(fold.learned, new_learner, np.ones(torque_nm.shape[1]))
    return torque_nm, predict_torque(learner, np.vstack([block.inputs for block in fold.held_out]))


def _learned(samples: Sequence[TorqueSamples], new_learner: NewLearner, std_factor: FloatArray) -> Learner:
    """Return a learner that has learned from some samples, block by block."""
    unit_nm = np.vstack([block.torque_nm for block in samples]).std(axis=0)
    learner = new_learner(recorded_range(samples), unit_nm, std_factor)
    for block in samples:
        learner, _ = learner.trained_on(block.to_learn(unit_nm), "actual")
    return learner


class Block(NamedTuple):
    """A stretch of a recording: samples ``start`` to before ``end`` of the unbroken part number ``part``."""

    part: int
    start: int
    end: int

    def of(self, parts: Sequence[TorqueSamples]) -> TorqueSamples:
        """Return its samples."""
        return parts[self.part][self.start : self.end]


class Fold(NamedTuple):
    """One split: blocks to learn from, without what is too close to one that is held out, and the others."""

    learned: list[TorqueSamples]
    held_out: list[TorqueSamples]


def gap_s(parts: Sequence[TorqueSamples]) -> float:
    """Return how far apart in time samples to learn from and samples that are held out have to be."""
    return max([_SHORTEST_GAP_S, *(_GAP_PERIODS / part.bandwidth_hz for part in parts)])


def blocks_of(parts: Sequence[TorqueSamples]) -> list[Block]:
    """Return blocks of about equal duration, in the order of time: 20 of them, or 5 to 20 of a short record.

    Raises:
        TrainingError: it is too short to hold anything out.
    """
    total_s = sum(len(part) * part.period_s for part in parts)
    least_s = _GAPS_PER_BLOCK * gap_s(parts)
    block_s = max(total_s / (N_FOLDS * _BLOCKS_PER_FOLD), least_s)
    found = []
    for index, part in enumerate(parts):
        n_blocks = int(len(part) * part.period_s / block_s + 1e-6)
        bounds = np.linspace(0, len(part), n_blocks + 1).round().astype(int).tolist()
        found += [Block(index, a, b) for a, b in zip(bounds, bounds[1:], strict=False)]
    if len(found) < N_FOLDS:
        raise TrainingError(
            f"there are {total_s:.3g} s in {counted(len(parts), 'unbroken part')}, "
            f"which make {counted(len(found), 'block')} of {block_s:.3g} s; "
            f"expected at least {N_FOLDS}, so that some can be held out. Record longer."
        )
    return found


def folds(parts: Sequence[TorqueSamples], blocks: Sequence[Block]) -> list[Fold]:
    """Return five splits, each of which holds out every fifth block."""
    gap = gap_s(parts)
    found = []
    for number in range(N_FOLDS):
        held = blocks[number::N_FOLDS]
        learned = []
        for block in (block for block in blocks if block not in held):
            samples = block.of(parts)
            for other in held:
                if other.part == block.part:
                    first_s, last_s = parts[other.part].time_s[[other.start, other.end - 1]]
                    samples = samples[(samples.time_s < first_s - gap) | (samples.time_s > last_s + gap)]
            if len(samples):
                learned.append(samples)
        found.append(Fold(learned, [block.of(parts) for block in held]))
    return found
