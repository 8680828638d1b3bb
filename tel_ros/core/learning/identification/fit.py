"""Learning torque from recordings, and what the result is worth where it was not learned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tel_ros.core.learning.identification.blocks import Block, Fold, blocks_of, folds
from tel_ros.core.learning.identification.torque_prediction import TorquePrediction, predict_torque
from tel_ros.core.learning.identification.torque_samples import TorqueSamples, recorded_range
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner
from tel_ros.core.types import FloatArray

NewLearner = Callable[[InputRange, FloatArray, FloatArray], Learner]
"""From the ranges of the inputs, and for each joint the unit of torque [N·m] and the factor on the standard
deviation, to an untrained learner of torque."""


@dataclass(frozen=True)
class HeldOutError:
    """Errors of predictions of blocks that were not learned from.

    Args:
        nmse: mean square error over variance of the torque, per joint. Shape (n_joints,).
        rms_nm: shape (n_joints,).
        expected_rms_nm: what the learners' standard deviations made of it. Shape (n_joints,).
        within_2_std: share of the errors within two standard deviations; 0.95 of a normal distribution.
        extrapolated: share of the samples that lay outside of what was learned from, or were uncertain.
        n_samples: that were predicted.
    """

    nmse: FloatArray
    rms_nm: FloatArray
    expected_rms_nm: FloatArray
    within_2_std: float
    extrapolated: float
    n_samples: int

    @property
    def std_factor(self) -> FloatArray:
        """How many times larger errors were than expected; 1 where that is not known. Shape (n_joints,)."""
        known = np.isfinite(self.expected_rms_nm) & (self.expected_rms_nm > 0.0) & (self.rms_nm > 0.0)
        factor: FloatArray = np.divide(
            self.rms_nm, self.expected_rms_nm, out=np.ones(len(known)), where=known
        )
        return factor


@dataclass(frozen=True)
class Fit:
    """A learner of torque and what is known of it.

    Args:
        learner: has learned from all blocks.
        held_out: errors where others like it, which had learned from four fifths, were asked for the rest.
        n_blocks: blocks of time.
        block_s: mean duration of one.
    """

    learner: Learner
    held_out: HeldOutError
    n_blocks: int
    block_s: float


def fit_torque(parts: Sequence[TorqueSamples], new_learner: NewLearner) -> Fit:
    """Learn torque from recordings: five times from four fifths, to see how good that is, then from all.

    Args:
        parts: one for each unbroken stretch.
        new_learner: makes an untrained learner.

    Raises:
        TrainingError: too little was recorded, or what was learned is not finite.
    """
    blocks = blocks_of(parts)
    held_out = held_out_error([_asked(fold, new_learner) for fold in folds(parts, blocks)])
    learner = learned(_cut(parts, blocks), new_learner, held_out.std_factor)
    seconds = [(block.end - block.start) * parts[block.part].period_s for block in blocks]
    return Fit(learner, held_out, len(blocks), float(np.mean(seconds)))


def learned(samples: Sequence[TorqueSamples], new_learner: NewLearner, std_factor: FloatArray) -> Learner:
    """Return a learner that has learned from some samples, block by block.

    Raises:
        TrainingError: what was learned is not finite.
    """
    unit_nm = np.vstack([block.torque_nm for block in samples]).std(axis=0)
    learner = new_learner(recorded_range(samples), unit_nm, std_factor)
    for block in samples:
        learner, _ = learner.trained_on(block.to_learn(unit_nm), "actual")
    return learner


def held_out_error(asked: Sequence[tuple[FloatArray, TorquePrediction]]) -> HeldOutError:
    """Return the errors of predictions.

    Args:
        asked: recorded torques of shape (n, n_joints), and the predictions of them.
    """
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
    learner = learned(fold.learned, new_learner, np.ones(fold.held_out[0].torque_nm.shape[1]))
    inputs = np.vstack([block.inputs for block in fold.held_out])
    return np.vstack([block.torque_nm for block in fold.held_out]), predict_torque(learner, inputs)


def _cut(parts: Sequence[TorqueSamples], blocks: Sequence[Block]) -> list[TorqueSamples]:
    return [parts[block.part][block.start : block.end] for block in blocks]
