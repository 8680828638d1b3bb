"""What a method achieved on one arm, and the columns by which methods are compared."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TrialResult:
    """How one trial went.

    Errors are measured minus desired, of an aborted trial as far as it went; NaN if the movement did not
    begin. ``arm_s``: how long the arm was busy with it, approach and coming to rest included.
    """

    duration_s: float
    completed: bool
    rms_error_rad: float
    max_error_rad: float
    arm_s: float


@dataclass(frozen=True)
class MethodRun:
    """Practice with one method on one arm, and what it could do afterwards.

    The seed is that of the arm, its noise and the new path; the message says how practice ended.
    """

    method: str
    seed: int
    goal_duration_s: float
    tolerance_rad: float
    """RMS error at the goal duration that counts as having learned the movement."""
    trials: tuple[TrialResult, ...]
    final: TrialResult
    """One more trial of the movement with what was learned."""
    new_path: TrialResult | None
    """A movement that was never practised; None if the method has no command for it."""
    bound_s: float
    """How fast this arm could run the path at all."""
    cpu_s: float
    message: str = ""

    @property
    def arm_s(self) -> float:
        return _busy_s(*self.trials, self.final, *filter(None, [self.new_path]))

    @property
    def trials_to_tolerance(self) -> float:
        """Number of the first trial at the goal speed that was within the tolerance; inf if none was."""
        for number, trial in enumerate(self.trials, 1):
            # A duration is rounded up to a whole number of control periods.
            at_goal = trial.completed and math.isclose(trial.duration_s, self.goal_duration_s, rel_tol=1e-3)
            if at_goal and trial.rms_error_rad <= self.tolerance_rad:
                return number
        return math.inf

    @property
    def arm_s_to_tolerance(self) -> float:
        """Time of the arm until the end of that trial; inf if there was none."""
        number = self.trials_to_tolerance
        return number if math.isinf(number) else _busy_s(*self.trials[: int(number)])

    @property
    def time_over_bound(self) -> float:
        """Duration of the movement after practice, as a multiple of the time-optimal one; inf if aborted."""
        return self.final.duration_s / self.bound_s if self.final.completed else math.inf

    @property
    def final_error_rad(self) -> float:
        """RMS error of the movement after practice; inf if it was aborted."""
        return _error(self.final)

    @property
    def largest_deviation_rad(self) -> float:
        """Largest deviation of any joint in any trial of practice in which the movement began."""
        known = [trial.max_error_rad for trial in self.trials if not math.isnan(trial.max_error_rad)]
        return max(known, default=math.nan)

    @property
    def aborts(self) -> float:
        return sum(not trial.completed for trial in self.trials)

    @property
    def new_path_error_rad(self) -> float:
        """RMS error of the new movement; inf if it was aborted, NaN if there is no command for it."""
        return math.nan if self.new_path is None else _error(self.new_path)


def _busy_s(*trials: TrialResult) -> float:
    return math.fsum(trial.arm_s for trial in trials)


def _error(trial: TrialResult) -> float:
    return trial.rms_error_rad if trial.completed else math.inf


@dataclass(frozen=True)
class MeritColumn:
    """A figure of merit, a property of :class:`MethodRun`; less is better. Angles are shown in mrad."""

    key: str
    title: str

    @property
    def in_mrad(self) -> bool:
        return self.key.endswith("_rad")

    def value(self, run: MethodRun) -> float:
        return getattr(run, self.key)


COLUMNS = (
    MeritColumn("trials_to_tolerance", "trials to tolerance"),
    MeritColumn("arm_s_to_tolerance", "arm seconds to tolerance"),
    MeritColumn("final_error_rad", "final RMS error"),
    MeritColumn("time_over_bound", "time / time-optimal"),
    MeritColumn("largest_deviation_rad", "largest deviation"),
    MeritColumn("aborts", "aborts"),
    MeritColumn("new_path_error_rad", "RMS error on a new path"),
)
