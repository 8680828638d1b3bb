"""Practice without ROS: the controller, the simulated arm and the learner in one process.

Tick for tick this is what the ROS graph does in lockstep: each state of the arm is answered by the
controller, each answer lets one period pass, and between trials time stands still. Equal goals give
bit-identical ticks here and there, so studies run here, and much faster. Nothing is recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np

from sim_bridge.arm import SimulatedArm
from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.errors import TrajectoryError
from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.learning.learner import Learner, TrainingOutcome
from tel_ros.core.practice.feasibility import require_within_velocity_limits
from tel_ros.core.practice.session import (
    CommandedTrial,
    PracticeSession,
    PractisedTrial,
    Prediction,
    predicted,
    trained,
)
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, PlannedTrial, Strategy
from tel_ros.core.springs import SpringChange, Springs
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Tick, Trial, TrialGoal, TrialReport
from tel_ros.core.types import FloatArray


class OfflineArm(AbstractContextManager["OfflineArm"]):
    """A simulated arm under the control of an :class:`EpController`. Use it with ``with``.

    Limits of the configured arm that are empty must have been filled from the URDF.

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

    def __exit__(self, *error: object) -> None:
        self._arm.close()

    @property
    def plant(self) -> SimulatedArm:
        """The simulated arm of the moment, with its true state; only trials should move it."""
        return self._arm

    def run_trial(self, goal: TrialGoal) -> Trial:
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
            if tick is None:
                assert controller.report is not None  # refused: nothing else leaves it idle
                raise TrajectoryError(controller.report.message)
            states.append(state)
            ticks.append(tick)
            arm.step(tick.command(self._config.arm.command_interface).tolist())
        assert controller.report is not None

        def column(name: str) -> FloatArray:
            return np.array([getattr(tick, name) for tick in ticks])

        return Trial(
            report=controller.report,
            joints=self._config.arm.joints,
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
            springs=SpringChange(goal.springs, Springs.of(self._config.arm)) if goal.springs else None,
        )

    def execute(self, commanded: CommandedTrial) -> tuple[TrialReport, Trial]:
        trial = self.run_trial(commanded.goal)
        return trial.report, trial

    def replace_arm(self, sim: SimConfig) -> None:
        """Go on with another arm, as when a payload is put on between two trials.

        It is at rest in the posture of the one before, whatever its initial position, and the controller
        still pulls to where it did. Time goes on; sensor noise does not repeat itself. Commands that were on
        their way are dropped.

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


class OfflinePractice(AbstractContextManager["OfflinePractice"]):
    """A practice run: predict, execute, learn, and so on. Use it with ``with``.

    The configuration is as for a run of the ROS graph. ``known_path``: at shape 0; None if it does not vary.
    It is itself the network of its session: a learner in this process, and its earlier states.

    Raises:
        InputFileError: the URDF cannot be read or simulated.
        ConfigError: a value does not fit the URDF, or there is no such strategy.
    """

    def __init__(self, config: Config, path: Path, learner: Learner, known_path: Path | None = None) -> None:
        self._config, self._path, self._known_path = config, path, known_path
        self.learner = learner
        """As it is after the last trial; may be replaced between trials."""
        self.after = {0: learner}
        """As it was after a trial that was learned from; 0: as the run began."""
        self.arm = OfflineArm(config)
        self.session = PracticeSession(config, path, known_path, make_strategy(config), self.arm, self)
        self.done: list[PractisedTrial[Trial]] = []
        """Trials of the last call of :meth:`run`, also if it raised."""
        self.ending: Ending | None = None
        """How it ended."""

    def __exit__(self, *error: object) -> None:
        self.arm.__exit__(*error)

    def run(
        self,
        strategy: Strategy | None = None,
        *,
        before_trial: Callable[[PlannedTrial], None] = lambda plan: None,
    ) -> list[PractisedTrial[Trial]]:
        """Run all trials of a strategy; None: the configured one.

        ``before_trial`` is called with each plan before the learner is asked: the place to replace the arm.

        Raises:
            ConfigError: the configured movements are too fast for the arm; nothing has moved.
            TelError: whatever :meth:`run_trial` raises.
        """
        if strategy is None:
            fastest = self.session.strategy.fastest_movements()
            require_within_velocity_limits(self._config, fastest, self._path, self._known_path)
        else:
            self.session.strategy = strategy
        self.done = []
        while isinstance(decision := self.session.next(), PlannedTrial):
            before_trial(decision)
            self.done.append(self.run_trial(decision))
        self.ending = decision
        return self.done

    def run_trial(self, plan: PlannedTrial) -> PractisedTrial[Trial]:
        """See :meth:`~tel_ros.core.practice.session.PracticeSession.run_trial`.

        Raises:
            SimulationError: the simulation was closed, or is no longer finite.
        """
        return self.session.run_trial(plan)

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        return predicted(self.learner, desired, self._config.control.rate_hz)

    def train(self, trial: Trial) -> TrainingOutcome:
        self.learner, training = trained(self.learner, trial, self._config)
        return training

    def save(self, index: int) -> None:
        self.after[index] = self.learner

    def load(self, index: int) -> None:
        self.learner = self.after[index]
