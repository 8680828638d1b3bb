"""What a practice run tells while it goes on, and how it is held between two trials."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence

from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import SetBool
from tel_interfaces.action import ExecuteTrial, Practice
from tel_interfaces.msg import TrialResult

from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.nodes import qos
from tel_ros.recording import topics
from tel_ros.recording.summary import TrialRow


class Progress:
    """Fills and publishes the feedback of a practice run."""

    def __init__(self, goal_handle: ServerGoalHandle) -> None:
        self._goal_handle = goal_handle
        self._planned_s = math.inf
        self._done_s = 0.0
        self._feedback = Practice.Feedback()

    def begin(self, plan: PlannedTrial, preview: Sequence[Movement]) -> None:
        """Begin a trial, with what is to come after it as far as the strategy can tell."""
        duration_s = plan.movement.own_duration_s
        to_come_s = duration_s + sum(movement.own_duration_s for movement in preview)
        self._planned_s = self._done_s + to_come_s
        self._feedback = Practice.Feedback(
            trial=plan.index,
            trials=plan.index + len(preview),
            alpha=plan.alpha,
            duration_s=duration_s,
            reason=plan.reason,
            expected_rms_rad=plan.expected_rms_rad,
            max_error_rad=math.nan,
        )
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


class Pause:
    """Whether the next trial has to wait. A trial that is under way goes on.

    A pause lasts until it is taken back, beyond the end of a run as well: whoever has said "not now" and
    turned away must not find the arm moving.
    """

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self._node = node
        self._go_on = threading.Event()
        self._go_on.set()
        self._paused_pub = node.create_publisher(Bool, topics.PAUSED, qos.LATCHED)
        self._paused_pub.publish(Bool(data=False))
        node.create_service(SetBool, topics.PAUSE, self._ask, callback_group=group)

    @property
    def asked(self) -> bool:
        """Whether a run has to wait before its next trial."""
        return not self._go_on.is_set()

    def wait(self, given_up: Callable[[], bool]) -> None:
        """Wait until the pause is taken back, or the run that waits is given up."""
        while not given_up() and not self._go_on.wait(0.1):
            pass

    def _ask(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._go_on.clear()
        else:
            self._go_on.set()
        self._paused_pub.publish(Bool(data=request.data))
        response.success = True
        response.message = "the next trial waits" if request.data else "the run goes on"
        self._node.get_logger().info(response.message)
        return response
