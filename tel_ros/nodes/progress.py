"""Telling whoever asked for a practice run how far it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rclpy.action.server import ServerGoalHandle
from tel_interfaces.action import ExecuteTrial, Practice
from tel_interfaces.msg import TrialResult

from tel_ros.core.practice.decisions import Movement, PlannedTrial
from tel_ros.recording.summary import TrialRow


class Progress:
    """Fills and publishes the feedback of a practice run.

    Args:
        goal_handle: of the run.
    """

    def __init__(self, goal_handle: ServerGoalHandle) -> None:
        self._goal_handle = goal_handle
        self._planned_s = math.inf
        self._done_s = 0.0
        self._feedback = Practice.Feedback()

    def begin(self, plan: PlannedTrial, preview: Sequence[Movement]) -> None:
        """Begin a trial, with what is to come after it as far as the strategy can tell."""
        feedback = self._feedback
        to_come_s = plan.movement.own_duration_s + sum(movement.own_duration_s for movement in preview)
        self._planned_s = self._done_s + to_come_s
        feedback.trials = plan.index + len(preview)
        feedback.reason, feedback.expected_rms_rad = plan.reason, plan.expected_rms_rad
        feedback.trial, feedback.alpha, feedback.duration_s = (
            plan.index,
            plan.alpha,
            plan.movement.own_duration_s,
        )
        feedback.max_error_rad, feedback.last, feedback.training_rms_rad = float("nan"), [], []
        self.stage("predicting")

    def stage(self, stage: str) -> None:
        """Go on to the next stage of the trial."""
        self._feedback.stage = stage
        self._publish(0.0)

    def paused(self) -> None:
        """Tell that the run waits between two trials; the last one has been told of."""
        self._feedback.last, self._feedback.training_rms_rad = [], []
        self.stage("paused")

    def moving(self, trial: ExecuteTrial.Feedback) -> None:
        """Pass on how far the movement is."""
        self._feedback.max_error_rad = trial.max_error_rad
        self._publish(min(max(trial.time_from_start_s, 0.0), self._feedback.duration_s))

    def trial_done(self, result: TrialResult, row: TrialRow) -> None:
        """Pass on how the trial went."""
        self._done_s += result.duration_s
        self._feedback.stage = "done"
        self._feedback.last = [result]
        self._feedback.training_rms_rad = [row.training_rms_before_rad, row.training_rms_after_rad]
        self._publish(0.0)

    def _publish(self, movement_s: float) -> None:
        self._feedback.progress = min(1.0, (self._done_s + movement_s) / self._planned_s)
        self._goal_handle.publish_feedback(self._feedback)
