"""The practice step: go back, predict, command, execute, learn, look out for lock-up. Written here alone.

An arm executes goals, a network predicts and learns: two ports, behind which are ROS, a simulated arm in this
process, or the bags of an interrupted run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, Protocol, TypeVar

from tel_ros.core.config import Config
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.core.practice.movement_path import command, desired_trajectory, forecast_of, forecast_trajectory
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome, TrialGoal, TrialReport
from tel_ros.core.types import FloatArray

OnAbort = Literal["stop", "continue"]
TrainingT = TypeVar("TrainingT")
TrialT = TypeVar("TrialT")
"""What a network learns from: a trial in memory, or the folder of its bag."""
ExecutedT = TypeVar("ExecutedT", covariant=True)
LearnedT = TypeVar("LearnedT", contravariant=True)


class Prediction(NamedTuple):
    """What a network answers for a desired trajectory.

    Args:
        equilibrium_rad: û for the configured springs. Shape (n, n_joints).
        std_rad: its standard deviation; inf where nothing is known. Shape (n, n_joints).
        revision: of the network; may be empty.
    """

    equilibrium_rad: FloatArray
    std_rad: FloatArray
    revision: str = ""


@dataclass(frozen=True)
class CommandedTrial:
    """A trial as it goes to the arm.

    Args:
        plan: of the strategy.
        goal: for the controller.
        std_rad: standard deviation of û, for the springs of the trial. Shape (n, n_joints).
        revision: of the network that has predicted û.
    """

    plan: PlannedTrial
    goal: TrialGoal
    std_rad: FloatArray
    revision: str


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
    """One trial of a practice run and what was learned from it.

    Args:
        plan: of the strategy.
        report: how it went.
        trial: what was learned from.
        training: None if nothing was learned.
        note: why nothing was learned.
        warning: what is wrong with the course of learning, e.g. lock-up; empty: nothing.
    """

    plan: PlannedTrial
    report: TrialReport
    trial: TrialT
    training: TrainingOutcome | None
    note: str = ""
    warning: str = ""


class PracticeSession(Generic[TrialT]):
    """A practice run, trial by trial.

    Args:
        config: of the run.
        path: the configured path.
        known: the path at shape 0; None if the shape does not vary.
        strategy: what to try next.
        arm: executes the trials; None: trials are only replayed.
        network: what is trained. Both may be replaced between two trials.
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
        self.strategy, self.arm, self.network = strategy, arm, network
        self._last: TrialReport | None = None
        self._lock_up = LockUpMonitor(config.practice.tolerance_rad)

    def next(self) -> PlannedTrial | Ending:
        """Return what the strategy decides after the last trial. Ask once a trial: it is a state machine."""
        return self.strategy.next(self._last, self.forecast)

    def forecast(self, movement: Movement) -> Forecast:
        """Return what the network, as it is, expects of a movement.

        Raises:
            ConfigError: its shape varies, and no path is known.
        """
        desired = forecast_trajectory(self._path, self._known, movement)
        prediction = self.network.predict(desired)
        return forecast_of(
            desired, prediction.equilibrium_rad, prediction.std_rad, self._config.arm, movement
        )

    def run_trial(self, plan: PlannedTrial) -> PractisedTrial[TrialT]:
        """Predict, execute and learn.

        Raises:
            ConfigError: the shape varies, and no path is known; nothing has moved.
            TrajectoryError: the arm must not follow this trajectory; nothing has moved.
            TrainingError: the trial cannot be learned from; the network stays as it was.
        """
        if plan.go_back_to is not None:
            self.network.load(plan.go_back_to)
        assert self.arm is not None
        report, trial = self.arm.execute(self.commanded(plan))
        return self._learn(plan, report, trial)

    def replay_trial(self, plan: PlannedTrial, report: TrialReport, trial: TrialT) -> PractisedTrial[TrialT]:
        """Take in a planned trial that has been executed before, as :meth:`run_trial` would."""
        if plan.go_back_to is not None:
            self.network.load(plan.go_back_to)
        return self._learn(plan, report, trial)

    def commanded(self, plan: PlannedTrial) -> CommandedTrial:
        """Return a trial with the command that the network predicts for it."""
        movement = plan.movement
        desired = desired_trajectory(self._path, self._known, movement, self._config.control.rate_hz)
        prediction = self.network.predict(desired)
        asked = command(self._config.arm, movement, desired, prediction.equilibrium_rad)
        goal = TrialGoal(plan.index, plan.alpha, desired, asked.equilibrium_rad, asked.springs)
        # The same error in the effort takes a smaller error in û with stiffer springs.
        return CommandedTrial(plan, goal, prediction.std_rad / movement.stiffness, prediction.revision)

    def _learn(self, plan: PlannedTrial, report: TrialReport, trial: TrialT) -> PractisedTrial[TrialT]:
        self._last = report
        training, note = learned_or_passed_over(
            report.outcome,
            report.run_ns > 0,
            self._config.practice.on_abort,
            lambda: self.network.train(trial),
        )
        if training is not None or report.outcome == Outcome.COMPLETED:
            self.network.save(plan.index)  # the strategy may go back to it
        warning = ""
        if training is not None:
            warning = self._lock_up.after_trial(
                plan.alpha, report.rms_error_rad, training.rms_before_rad, training.rms_after_rad
            )
        return PractisedTrial(plan, report, trial, training, note, warning)


def learned_or_passed_over(
    outcome: Outcome, reached_run: bool, on_abort: OnAbort, train: Callable[[], TrainingT]
) -> tuple[TrainingT | None, str]:
    """Learn from a trial, or pass it over.

    A trial that was not completed is learned from only if it was aborted during its movement and practice
    goes on after aborts. Of a completed one too little may be left, because the effort was clipped or held
    back for late states: that ends practice unless it goes on after aborts.

    Args:
        outcome: of the trial.
        reached_run: whether it reached its movement.
        on_abort: ``practice.on_abort``.
        train: learns from it.

    Returns:
        What training gave, or None and the reason.

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
