"""What strategies decide, and what they may know: movements, forecasts, plans, endings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from tel_ros.core.trial import TrialReport
from tel_ros.core.types import FloatArray


@dataclass(frozen=True)
class Movement:
    """One desired movement: everything that a practice parameter can vary ([Practice] A5).

    Args:
        duration_s: of the whole path, from rest to rest; a part of it takes its share.
        amplitude: of the path about its first posture; 1: as configured.
        shape: 0: the known path, 1: the configured one, between them a blend.
        stiffness: factor on K. B goes with its square root, which keeps the damping ratio.
        start: where on the path the movement begins, 0 to 1.
        end: where it ends; above ``start``.
    """

    duration_s: float
    amplitude: float = 1.0
    shape: float = 1.0
    stiffness: float = 1.0
    start: float = 0.0
    end: float = 1.0

    @property
    def own_duration_s(self) -> float:
        """How long this movement itself takes."""
        return self.duration_s * (self.end - self.start)


@dataclass(frozen=True)
class Forecast:
    """What the learner expects of a movement, at points along it that are equally distant in time.

    Args:
        std_rad: standard deviation of the error in the command, for springs as stiff as those of the
            movement; inf where nothing is known.
            Shape (n, n_joints).
        effort_nm: what the movement needs, as far as the learner knows. Shape (n, n_joints).
    """

    std_rad: FloatArray
    effort_nm: FloatArray


Forecaster = Callable[[Movement], Forecast]


@dataclass(frozen=True)
class PlannedTrial:
    """What to try next.

    Args:
        index: number of the trial, from 1.
        alpha: practice parameter; 1 is the movement that was asked for ([Practice] A5).
        movement: what to do.
        go_back_to: the trial after which the network was as it has to be again, before this trial is
            predicted; 0: the network that the run began with; None: as it is.
        reason: why this one, for people.
        expected_rms_rad: the tracking error that the strategy expects; NaN if it expects nothing.
    """

    index: int
    alpha: float
    movement: Movement
    go_back_to: int | None = None
    reason: str = ""
    expected_rms_rad: float = math.nan


@dataclass(frozen=True)
class Ending:
    """The end of a run.

    Args:
        outcome: ``completed``: the goal was reached as far as the strategy looks; ``stopped``: the strategy
            has found that it cannot be reached; ``aborted`` and ``cancelled``: as the last trial.
        message: why, for people; empty if there is nothing to say.
    """

    outcome: Literal["completed", "stopped", "aborted", "cancelled"]
    message: str = ""


class Strategy(Protocol):
    """Decides after each trial what to do next. A state machine: no clock, no files, nothing random."""

    def preview(self) -> Sequence[Movement]:
        """Return the movements that are still to come, this far as it looks now."""
        ...

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice.

        Args:
            last: the trial that has just ended; None at the beginning.
            forecast: asks the learner as it is now.
        """
        ...
