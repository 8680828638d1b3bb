"""The practice step: go back, predict, command, execute, learn, look out for lock-up.

An arm executes goals, a network predicts and learns: two ports, behind which are ROS, a simulated arm in this
process, or the bags of an interrupted run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

from tel_ros.core.config import Config
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.learner import Learner, TrainingOutcome, std_along
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.practice.learned_timings import LearnedTimings
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.core.practice.movement_path import command, desired_trajectory, forecast_of, forecast_trajectory
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome, Trial, TrialGoal, TrialReport
from tel_ros.core.types import FloatArray

TrainingT = TypeVar("TrainingT")
TrialT = TypeVar("TrialT")
"""What a network learns from: a trial in memory, or the folder of its bag."""
ExecutedT = TypeVar("ExecutedT", covariant=True)
LearnedT = TypeVar("LearnedT", contravariant=True)


class Prediction(NamedTuple):
    """What a network answers for a desired trajectory.

    û for the configured springs, its standard deviation (inf where nothing is known) and the revision of the
    network, which may be empty. Shapes (n, n_joints).
    """

    equilibrium_rad: FloatArray
    std_rad: FloatArray
    revision: str = ""


def predicted(learner: Learner, desired: DesiredTrajectory, rate_hz: float) -> Prediction:
    """Return what a learner predicts for a trajectory that is commanded ``rate_hz`` times a second."""
    inputs = query_inputs(desired, 1.0 / rate_hz)
    return Prediction(desired.position_rad + learner.predict(inputs), std_along(learner, inputs))


def trained(learner: Learner, trial: Trial, config: Config) -> tuple[Learner, TrainingOutcome]:
    """Let a learner learn from a trial; the one that is given stays as it is.

    Raises:
        TrainingError: too little is left to learn from.
    """
    samples = configured_samples(learning_record(trial), config.learning)
    return learner.trained_on(samples, config.learning.training)


@dataclass(frozen=True)
class CommandedTrial:
    """A trial as it goes to the arm."""

    plan: PlannedTrial
    goal: TrialGoal
    std_rad: FloatArray
    """Standard deviation of û, for the springs of the trial. Shape (n, n_joints)."""
    revision: str
    """Of the network that has predicted û."""


class PracticeArm(Protocol[ExecutedT]):
    """Executes trials."""

    def execute(self, commanded: CommandedTrial) -> tuple[TrialReport, ExecutedT]:
        """Execute a trial to its end, however it ends."""
        ...


class PracticeNetwork(Protocol[LearnedT]):
    """Predicts and learns."""

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        """Return the command for a trajectory."""
        ...

    def train(self, trial: LearnedT) -> TrainingOutcome:
        """Learn from a trial.

        Raises:
            TrainingError: too little is left to learn from; the network stays as it was.
        """
        ...

    def save(self, index: int) -> None:
        """Keep the network as it is after a trial."""
        ...

    def load(self, index: int) -> None:
        """Go back to the network as it was after a trial; 0: as the run began."""
        ...


@dataclass(frozen=True)
class PractisedTrial(Generic[TrialT]):
    """One trial of a practice run and what was learned from it."""

    plan: PlannedTrial
    report: TrialReport
    trial: TrialT
    training: TrainingOutcome | None
    """None if nothing was learned."""
    note: str = ""
    """Why nothing was learned."""
    warning: str = ""
    """What is wrong with the course of learning, e.g. lock-up; empty: nothing."""


class PracticeSession(Generic[TrialT]):
    """A practice run, trial by trial.

    Args:
        config: of the run.
        path: the configured path.
        known: the path at shape 0; None if the shape does not vary.
        strategy: what to try next; may be replaced between two trials, as arm and network.
        arm: executes the trials; None: trials are only replayed.
        network: what is trained.
    """

    def __init__(
        self,
        config: Config,
        path: Path,
        known: Path | None,
        strategy: Strategy,
        arm: PracticeArm[TrialT] | None,
        network: PracticeNetwork[TrialT],
    ) -> None:
        self._config, self._path, self._known = config, path, known
        self._springs = Springs.of(config.arm)
        self._timings = LearnedTimings(config, path, known)
        self.strategy, self.arm, self.network = strategy, arm, network
        self._last: TrialReport | None = None
        self._has_completed = False
        self._lock_up = {
            name: LockUpMonitor(config.practice.tolerance_rad) for name in config.path.names or ("",)
        }

    def next(self) -> PlannedTrial | Ending:
        """Return what the strategy decides after the last trial. Ask once a trial: it is a state machine.

        It is not asked after an abort while no trial has been completed: an arm that has not yet done what it
        is told is not tried again before somebody has looked at it.
        """
        last = self._last
        self._timings.forget()  # others may have replaced the network
        if last is not None and last.outcome == Outcome.ABORTED and not self._has_completed:
            why = f"trial {last.index} was aborted: {last.message}"
            return Ending("aborted", f"{why}. No other follows while none has been completed")
        return self.strategy.next(last, self.forecast)

    def forecast(self, movement: Movement) -> Forecast:
        """Return what the network, as it is, expects of a movement.

        Raises:
            ConfigError: its shape varies, and no path is known.
            TrajectoryError: it is to be as fast as efforts allow, and they do not allow it at any speed.
        """
        timing = self._timings.of(movement, self.network.predict)
        desired = forecast_trajectory(self._path, self._known, movement, timing)
        prediction = self.network.predict(desired)
        return forecast_of(desired, *prediction[:2], self._springs, movement)

    def run_trial(self, plan: PlannedTrial) -> PractisedTrial[TrialT]:
        """Predict, execute and learn.

        Raises:
            ConfigError: the shape varies, and no path is known; nothing has moved.
            TrajectoryError: the arm must not follow this trajectory; nothing has moved.
            TrainingError: the trial cannot be learned from; the network stays as it was.
        """
        assert self.arm is not None
        self._timings.forget()
        self._go_back(plan)
        return self._learn(plan, *self.arm.execute(self.commanded(plan)))

    def replay_trial(self, plan: PlannedTrial, report: TrialReport, trial: TrialT) -> PractisedTrial[TrialT]:
        """Take in a planned trial that has been executed before, as :meth:`run_trial` would."""
        self._go_back(plan)
        return self._learn(plan, report, trial)

    def commanded(self, plan: PlannedTrial) -> CommandedTrial:
        """Return a trial with the command that the network predicts for it."""
        movement = plan.movement
        timing = self._timings.of(movement, self.network.predict)
        rate_hz = self._config.control.rate_hz
        desired = desired_trajectory(self._path, self._known, movement, rate_hz, timing)
        prediction = self.network.predict(desired)
        springs, equilibrium_rad = command(self._springs, movement, desired, prediction.equilibrium_rad)
        goal = TrialGoal(plan.index, plan.alpha, desired, equilibrium_rad, springs)
        # The same error in the effort takes a smaller error in û with stiffer springs.
        return CommandedTrial(plan, goal, prediction.std_rad / movement.stiffness, prediction.revision)

    def _go_back(self, plan: PlannedTrial) -> None:
        if plan.go_back_to is not None:
            self.network.load(plan.go_back_to)

    def _learn(self, plan: PlannedTrial, report: TrialReport, trial: TrialT) -> PractisedTrial[TrialT]:
        self._last = report
        self._timings.heed(report.given_nm)
        self._has_completed |= report.outcome == Outcome.COMPLETED
        on_abort = self._config.practice.on_abort
        try:
            training, note = learned_or_passed_over(
                report.outcome, report.run_ns > 0, on_abort, lambda: self.network.train(trial)
            )
        except TrainingError as error:
            raise TrainingError(f"{report.message}; {error}") if report.message else error from None
        if training is not None or report.outcome == Outcome.COMPLETED:
            self.network.save(plan.index)  # the strategy may go back to it
        warning = ""
        if training is not None:
            learned_rad = training.training_rms_before_rad, training.training_rms_after_rad
            warning = self._lock_up[plan.movement.path].after_trial(
                plan.alpha, report.rms_error_rad, *learned_rad
            )
        return PractisedTrial(plan, report, trial, training, note, warning)


def learned_or_passed_over(
    outcome: Outcome, reached_run: bool, on_abort: str, train: Callable[[], TrainingT]
) -> tuple[TrainingT | None, str]:
    """Learn from a trial, or pass it over.

    A trial that was not completed is learned from only if it was aborted during its movement and practice
    goes on after aborts. Of a completed one too little may be left, because the effort was clipped or held
    back for late states: that ends practice unless it goes on after aborts.

    Returns:
        What ``train`` gave, or None and the reason.

    Raises:
        TrainingError: nothing can be learned from the trial, and that ends practice.
    """
    completed = outcome == Outcome.COMPLETED
    if not completed and not (outcome == Outcome.ABORTED and on_abort == "continue" and reached_run):
        return None, f"{outcome.text}: not learned from"
    try:
        return train(), ""
    except TrainingError as error:
        if completed and on_abort == "stop":
            raise
        return None, f"nothing was learned: {error}"
