"""What a practice strategy is asked and what it answers: movements, forecasts, plans, endings."""

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
        duration_s: of the whole path, from rest to rest; a part of it takes its share. An estimate where an
            effort share is given.
        amplitude: of the path about its first posture; 1: as configured.
        shape: 0: the known path, 1: the configured one, between them a blend.
        stiffness: factor on K. B goes with its square root, which keeps the damping ratio.
        start: where on the path the movement begins, 0 to 1.
        end: where it ends; above ``start``.
        effort_share: how much of the effort limits the movement may use, and then it is as fast as what has
            been learned allows (``practice.timing``). None: minimum jerk in the duration.
        path: which, where practice has several; empty: the only one.
    """

    duration_s: float
    amplitude: float = 1.0
    shape: float = 1.0
    stiffness: float = 1.0
    start: float = 0.0
    end: float = 1.0
    effort_share: float | None = None
    path: str = ""

    @property
    def own_duration_s(self) -> float:
        """Duration of this part of the path."""
        return self.duration_s * (self.end - self.start)

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole path."""
        return (self.start, self.end) == (0.0, 1.0)

    @property
    def part_text(self) -> str:
        """Which part of the path it is."""
        return f"from {self.start:.3g} to {self.end:.3g} of the path"


@dataclass(frozen=True)
class Forecast:
    """What the learner expects of a movement, at n points that are equally distant in time."""

    std_rad: FloatArray
    """Standard deviation of the error in the command, for springs as stiff as those of the movement; inf
    where nothing is known. Shape (n, n_joints)."""
    effort_nm: FloatArray
    """What the movement needs, as far as the learner knows. Shape (n, n_joints)."""
    velocity_rad_s: FloatArray
    """Shape (n, n_joints)."""
    duration_s: float
    """How long it takes."""


Forecaster = Callable[[Movement], Forecast]


@dataclass(frozen=True)
class PlannedTrial:
    """What to try next: number of the trial, from 1, practice parameter (1 at the goal), movement."""

    index: int
    alpha: float
    movement: Movement
    go_back_to: int | None = None
    """First restore the network as it was after this trial (0: as the run began); None: keep it."""
    reason: str = ""
    """For people."""
    expected_rms_rad: float = math.nan
    """Tracking error; NaN: no expectation."""
    possible_s: float = math.nan
    """Duration that is believed possible with ``practice.effort_share``; NaN: not asked for, or not known."""


@dataclass(frozen=True)
class Ending:
    """The end of a run."""

    outcome: Literal["completed", "stopped", "aborted", "cancelled"]
    """``stopped``: the strategy finds that the goal cannot be reached; the last two: as the last trial."""
    message: str = ""
    """Why, for people; may be empty."""


class Strategy(Protocol):
    """Decides after each trial what to do next. A state machine: no clock, no files, no randomness.

    Resuming a run feeds a new strategy with the recorded trials, so equal inputs must give equal decisions.
    """

    def preview(self) -> Sequence[Movement]:
        """Return the movements still to come, as far as the strategy knows now."""
        ...

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return what follows a trial (None: the beginning); ``forecast`` asks the learner as it is now."""
        ...

    def movements_to_cover(self) -> Sequence[Movement]:
        """Return movements that together bound all of practice in position, velocity and acceleration.

        The input ranges of a new network cover them.
        """
        ...

    def fastest_movements(self) -> Sequence[Movement]:
        """Return movements of which one is as fast, joint by joint, as any that may be tried.

        Practice is refused before anything moves if one of them exceeds a velocity limit. A class that
        derives from this one may leave the method out.
        """
        return self.movements_to_cover()
