"""Telling whoever asked for a practice run how far it is."""

from __future__ import annotations

from rclpy.action.server import ServerGoalHandle
from tel_interfaces.action import ExecuteTrial, Practice
from tel_interfaces.msg import TrialResult

from tel_ros.core.practice.strategy import PlannedTrial
from tel_ros.core.types import FloatArray
from tel_ros.recording.summary import TrialRow


class Progress:
    """Fills and publishes the feedback of a practice run.

    Args:
        goal_handle: of the run.
        planned_durations_s: durations of all trials. Shape (n,).
    """

    def __init__(self, goal_handle: ServerGoalHandle, planned_durations_s: FloatArray) -> None:
        self._goal_handle = goal_handle
        self._planned_s = float(planned_durations_s.sum())
        self._done_s = 0.0
        self._feedback = Practice.Feedback(trials=len(planned_durations_s))

    def begin(self, plan: PlannedTrial) -> None:
        """Begin a trial."""
        feedback = self._feedback
        feedback.trial, feedback.alpha, feedback.duration_s = plan.index, plan.alpha, plan.duration_s
        feedback.max_error_rad, feedback.last, feedback.training_rms_rad = float("nan"), [], []
        self.stage("predicting")

    def stage(self, stage: str) -> None:
        """Go on to the next stage of the trial."""
        self._feedback.stage = stage
        self._publish(0.0)

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
