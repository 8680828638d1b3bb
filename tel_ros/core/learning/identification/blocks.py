"""Cutting recordings into blocks of time, some to learn from and some to be asked about.

A sample between two others that have been learned from is no test: its neighbours at 125 Hz are nearly
itself. So whole blocks are held out, and what is learned from keeps a distance from them that the filter
cannot bridge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.identification.torque_samples import TorqueSamples

N_FOLDS = 5
_BLOCKS_PER_FOLD = 4
_SHORTEST_GAP_S = 0.2
_GAP_PERIODS = 2.0
"""Of the cutoff: of what happened at one time, the filter has nothing left after one, on either side."""
_GAPS_PER_BLOCK = 4.0


@dataclass(frozen=True)
class Block:
    """A stretch of a recording.

    Args:
        part: index of the recording's unbroken part.
        start: first sample in it.
        end: behind the last one.
    """

    part: int
    start: int
    end: int


@dataclass(frozen=True)
class Fold:
    """One split.

    Args:
        learned: blocks to learn from, without what is too close to one that is held out.
        held_out: the others.
    """

    learned: tuple[TorqueSamples, ...]
    held_out: tuple[TorqueSamples, ...]


def gap_s(parts: Sequence[TorqueSamples]) -> float:
    """Return how far apart in time samples to learn from and samples that are held out have to be."""
    return max([_SHORTEST_GAP_S, *(_GAP_PERIODS / part.bandwidth_hz for part in parts)])


def blocks_of(parts: Sequence[TorqueSamples]) -> list[Block]:
    """Return blocks of about equal duration, in the order of time: 20 of them, or 5 to 20 of a short record.

    Args:
        parts: what was recorded, one for each unbroken stretch.

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
            f"there are {total_s:.3g} s in {len(parts)} unbroken parts, which make {len(found)} blocks of "
            f"{block_s:.3g} s; expected at least {N_FOLDS}, so that some can be held out. Record longer."
        )
    return found


def folds(parts: Sequence[TorqueSamples], blocks: Sequence[Block]) -> list[Fold]:
    """Return five splits, each of which holds out every fifth block."""
    gap = gap_s(parts)
    found = []
    for number in range(N_FOLDS):
        held = [block for k, block in enumerate(blocks) if k % N_FOLDS == number]
        learned = []
        for block in blocks:
            if block in held:
                continue
            samples = parts[block.part][block.start : block.end]
            for other in held:
                if other.part == block.part:
                    first_s, last_s = parts[other.part].time_s[[other.start, other.end - 1]]
                    samples = samples[(samples.time_s < first_s - gap) | (samples.time_s > last_s + gap)]
            if len(samples):
                learned.append(samples)
        held_out = tuple(parts[block.part][block.start : block.end] for block in held)
        found.append(Fold(tuple(learned), held_out))
    return found
