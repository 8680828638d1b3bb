"""Practice without ROS: the controller, the simulated arm and the learner in one process.

Tick for tick this is what the ROS graph does in lockstep: each state of the arm is answered by the
controller, each answer lets one period pass, and between trials time stands still. Equal goals give
bit-identical ticks here and there, so benchmarks and studies can run here, and much faster. Nothing is
recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from sim_bridge.arm import SimulatedArm
from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import query_inputs, stack_inputs
from tel_ros.core.learning.learner import Learner, TrainingOutcome, std_along
from tel_ros.core.learning.signals import TrialSignals, configured_samples, learning_record
from tel_ros.core.practice.decisions import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.practice.forecast import forecast_of, forecast_trajectory
from tel_ros.core.practice.lessons import has_to_teach, is_learned_from
from tel_ros.core.practice.movement_path import command, desired_trajectory
from tel_ros.core.practice.strategy import make_strategy
from tel_ros.core.practice.velocity_limit import require_within_velocity_limits
from tel_ros.core.springs import SpringChange, Springs, learned_equilibrium
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Tick, TrialGoal, TrialReport
from tel_ros.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class OfflineTrial:
    """One trial; arrays have one row a tick, named and laid out as in a trial that is read from its bag.

    Args:
        report: how it went.
        time_ns: stamps of the states that were answered. Shape (n,).
        phase: numbers of :class:`~tel_ros.core.trial.Phase`. Shape (n,).
        desired: y as positions, velocities, accelerations. Shape (n, 3 * n_joints).
        equilibrium_rad: û. Shape (n, n_joints).
        position_rad: ŷ as measured. Shape (n, n_joints).
        velocity_rad_s: as measured. Shape (n, n_joints).
        effort_nm: as commanded, or as expected of position drives. Shape (n, n_joints).
        saturated: whether the effort was clipped. Shape (n, n_joints).
        springs: those of the trial, if they were not the configured ones.
    """

    report: TrialReport
    time_ns: IntArray
    phase: IntArray
    desired: FloatArray
    equilibrium_rad: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray
    saturated: BoolArray
    springs: SpringChange | None = None

    @property
    def signals(self) -> TrialSignals:
        """What the network learns from: the ticks from the start posture on."""
        return learning_record(
            time_ns=self.time_ns,
            phase=self.phase,
            desired=self.desired,
            position_rad=self.position_rad,
            equilibrium_rad=learned_equilibrium(
                self.springs, self.equilibrium_rad, self.position_rad, self.velocity_rad_s
            ),
            saturated=self.saturated,
        )


class OfflineArm:
    """A simulated arm under the control of an :class:`EpController`. Use it with ``with``.

    Args:
        config: arm, control, sim and seed are used; limits of the arm that are empty must have been filled
            from the URDF.

    Raises:
        InputFileError: the URDF cannot be read or simulated.
        ConfigError: a value does not fit the URDF.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._controller = EpController(config.arm, config.control, config.safety)
        self._n_replaced = 0
        self._start_ns = 0
        self._arm = self._new_arm(config.sim)

    def __enter__(self) -> Self:
        """Return the arm."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the arm."""
        self.close()

    def close(self) -> None:
        """End the simulation. A second time does nothing."""
        self._arm.close()

    @property
    def plant(self) -> SimulatedArm:
        """The simulated arm of the moment, with its true state; only trials should move it."""
        return self._arm

    def run_trial(self, goal: TrialGoal) -> OfflineTrial:
        """Execute a trial from its first tick to its end, however it ends.

        Raises:
            TrajectoryError: the arm must not follow this goal; nothing has moved.
            SimulationError: the simulation was closed, or is no longer finite.
        """
        arm, controller = self._arm, self._controller
        controller.start(goal)
        states: list[ArmState] = []
        ticks: list[Tick] = []
        while controller.active:
            reading = arm.reading()
            state = ArmState(
                time_ns=self._start_ns + reading.time_ns,
                position_rad=np.array(reading.position_rad),
                velocity_rad_s=np.array(reading.velocity_rad_s),
                effort_nm=np.array(reading.effort_nm),
            )
            tick = controller.tick(state)
            assert tick is not None  # it is not idle
            states.append(state)
            ticks.append(tick)
            arm.step(tick.command(self._config.arm.command_interface).tolist())
        assert controller.report is not None
        change = SpringChange(goal.springs, Springs.of(self._config.arm)) if goal.springs else None
        return _trial(controller.report, states, ticks, change)

    def replace_arm(self, sim: SimConfig) -> None:
        """Go on with another arm, as when a payload is put on between two trials.

        It is at rest in the posture of the one before, and the controller still pulls to where it did. Time
        goes on; sensor noise does not repeat itself. Commands that were on their way are dropped.

        Args:
            sim: the other arm; its initial position is not used.

        Raises:
            ConfigError: a value does not fit the URDF or the control rate, or the posture is beyond a hard
                stop. The old arm stays.
        """
        old = self._arm
        new = self._new_arm(sim, self._n_replaced + 1)
        try:
            new.set_state(old.true_position_rad, (0.0,) * len(old.true_position_rad))
        except BaseException:
            new.close()
            raise
        self._n_replaced += 1
        self._start_ns += old.time_ns
        self._arm = new
        old.close()

    def _new_arm(self, sim: SimConfig, n_before: int = 0) -> SimulatedArm:
        config = self._config
        return SimulatedArm(config.arm, sim, rate_hz=config.control.rate_hz, seed=config.seed + n_before)


@dataclass(frozen=True)
class PractisedTrial:
    """One trial of a practice run and what was learned from it.

    Args:
        plan: what was to be tried.
        goal: what the controller was asked to do.
        trial: what was done.
        learner: as it was after the trial.
        training: what learning did; None if there was nothing to learn from.
    """

    plan: PlannedTrial
    goal: TrialGoal
    trial: OfflineTrial
    learner: Learner
    training: TrainingOutcome | None


class OfflinePractice:
    """A practice run: predict, execute, learn, and so on. Use it with ``with``.

    Args:
        config: as for a run of the ROS graph.
        path: the configured path.
        learner: what it begins with.
        known_path: the path at shape 0; None if the shape does not vary.

    Raises:
        InputFileError: the URDF cannot be read or simulated.
        ConfigError: a value does not fit the URDF.
    """

    def __init__(self, config: Config, path: Path, learner: Learner, known_path: Path | None = None) -> None:
        self.learner = learner
        """As it is after the last trial; may be replaced between trials."""
        self.arm = OfflineArm(config)
        self.ending: Ending | None = None
        """How the last call of :meth:`run` ended."""
        self._config = config
        self._path = path
        self._known_path = known_path
        self._learner_after = {0: learner}

    def __enter__(self) -> Self:
        """Return the practice."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the arm."""
        self.arm.close()

    def run(
        self,
        strategy: Strategy | None = None,
        *,
        before_trial: Callable[[PlannedTrial], None] = lambda plan: None,
    ) -> list[PractisedTrial]:
        """Run all trials of a strategy.

        Args:
            strategy: what to try next; None: the configured one.
            before_trial: is called with each plan before the learner is asked: the place to replace the arm.

        Raises:
            ConfigError: the configured movements are too fast for the arm; nothing has moved.
            TelError: whatever :meth:`run_trial` raises.
        """
        if strategy is None:
            require_within_velocity_limits(self._config, self._path, self._known_path)
            strategy = make_strategy(self._config)
        done: list[PractisedTrial] = []
        last: TrialReport | None = None
        while isinstance(decision := strategy.next(last, self.forecast), PlannedTrial):
            before_trial(decision)
            done.append(self.run_trial(decision))
            last = done[-1].trial.report
        self.ending = decision
        return done

    def forecast(self, movement: Movement) -> Forecast:
        """Return what the learner expects of a movement.

        Raises:
            ConfigError: its shape varies, and no path is known.
        """
        desired = forecast_trajectory(self._path, self._known_path, movement)
        inputs = self._inputs(desired)
        offset_rad, std_rad = self.learner.predict(inputs), std_along(self.learner, inputs)
        return forecast_of(desired, offset_rad, std_rad, self._config.arm, movement)

    def run_trial(self, plan: PlannedTrial) -> PractisedTrial:
        """Ask the learner for the commands, execute them and let it learn.

        Raises:
            ConfigError: the shape varies, and no path is known; nothing has moved.
            TrajectoryError: the arm must not follow this trajectory; nothing has moved.
            SimulationError: the simulation was closed, or is no longer finite.
            TrainingError: the trial cannot be learned from; the learner stays as it was.
        """
        if plan.go_back_to is not None:
            self.learner = self._learner_after[plan.go_back_to]
        desired = desired_trajectory(
            self._path, self._known_path, plan.movement, self._config.control.rate_hz
        )
        equilibrium_rad = desired.position_rad + self.learner.predict(self._inputs(desired))
        asked = command(self._config.arm, plan.movement, desired, equilibrium_rad)
        goal = TrialGoal(plan.index, plan.alpha, desired, asked.equilibrium_rad, asked.springs)
        trial = self.arm.run_trial(goal)
        report, on_abort = trial.report, self._config.practice.on_abort
        learns = is_learned_from(report.outcome, report.run_ns > 0, on_abort)
        training = self._learn(trial) if learns else None
        self._learner_after[plan.index] = self.learner
        return PractisedTrial(plan, goal, trial, self.learner, training)

    def _inputs(self, desired: DesiredTrajectory) -> FloatArray:
        return query_inputs(desired, 1.0 / self._config.control.rate_hz)

    def _learn(self, trial: OfflineTrial) -> TrainingOutcome | None:
        learning = self._config.learning
        try:
            samples = configured_samples(trial.signals, learning)
            self.learner, training = self.learner.trained_on(samples, learning.training)
        except TrainingError:
            if has_to_teach(trial.report.outcome, self._config.practice.on_abort):
                raise
            return None
        return training


def _trial(
    report: TrialReport, states: list[ArmState], ticks: list[Tick], springs: SpringChange | None
) -> OfflineTrial:
    def column(name: str) -> FloatArray:
        return np.array([getattr(tick, name) for tick in ticks])

    return OfflineTrial(
        report=report,
        time_ns=np.array([state.time_ns for state in states], dtype=np.int64),
        phase=np.array([tick.phase for tick in ticks], dtype=np.int64),
        desired=stack_inputs(
            column("desired_position_rad"),
            column("desired_velocity_rad_s"),
            column("desired_acceleration_rad_s2"),
        ),
        equilibrium_rad=column("equilibrium_rad"),
        position_rad=np.array([state.position_rad for state in states]),
        velocity_rad_s=np.array([state.velocity_rad_s for state in states]),
        effort_nm=column("effort_nm"),
        saturated=column("saturated").astype(bool),
        springs=springs,
    )
