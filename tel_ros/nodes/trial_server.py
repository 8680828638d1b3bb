"""The action ``/execute_trial`` of a controller that is driven by joint states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import TrialResult

from tel_ros.core.control.controller import EpController
from tel_ros.core.control.loop_timing import LoopTimer
from tel_ros.core.errors import TelError, TrajectoryError
from tel_ros.core.trial import Outcome, TrialGoal, TrialReport
from tel_ros.nodes.conversions import to_goal, to_result_message
from tel_ros.recording import topics
from tel_ros.recording.trial_timing import timing_fields

FEEDBACK_PERIOD_S = 0.2


class TrialServer:
    """Takes up one trial at a time, and hands its result over when the controller says that it has ended.

    An execute callback that waited for the end would either block the joint states or keep the executor
    polling, so it runs at the end of the trial only. Every goal is accepted, and one that is not followed is
    answered at once with the outcome REFUSED and the reason: an action server cannot give a reason when it
    rejects.

    Args:
        node: that has the action.
        joints: names, in the order of all arrays.
        begin: takes up a goal; raises a TelError to refuse it.
        cancel: begins to bring the arm to rest.
        timer: that the controller notes the ticks of a trial in; None: nobody times them.
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        begin: Callable[[TrialGoal], None],
        cancel: Callable[[], None],
        timer: LoopTimer | None = None,
    ) -> None:
        self._node, self._joints, self._begin, self._cancel_trial = node, joints, begin, cancel
        self._timer = timer
        self._goal_handle: ServerGoalHandle | None = None
        self._result = TrialResult()
        self.last: TrialReport | None = None
        """Of the last trial that was not refused."""
        self._server = ActionServer(
            node,
            ExecuteTrial,
            topics.EXECUTE_TRIAL,
            execute_callback=lambda handle: self._end_goal(handle, self._result),
            handle_accepted_callback=self._take_up,
            cancel_callback=self._cancel,
        )

    @property
    def busy(self) -> bool:
        """Whether a trial is under way."""
        return self._goal_handle is not None

    def finish(self, report: TrialReport | None) -> None:
        """Hand over the result of the trial that is under way, if it has ended.

        Args:
            report: of the trial; None: it has not ended.
        """
        handle = self._goal_handle
        if report is None or handle is None:
            return
        if self._timer is not None:
            report = replace(report, timing=self._timer.timing())
        if report.message:
            self._node.get_logger().warning(f"trial {report.index}: {report.outcome.name}: {report.message}")
        if report.timing is not None and report.timing.warning:
            self._node.get_logger().warning(f"trial {report.index}: {report.timing.warning}")
        self.last = report
        self._goal_handle, self._result = None, to_result_message(report, self._joints)
        handle.execute()

    def publish_feedback(self, controller: EpController) -> None:
        """Tell how far the trial that is under way is."""
        if self._goal_handle is None:
            return
        self._goal_handle.publish_feedback(
            ExecuteTrial.Feedback(
                phase=int(controller.phase),
                time_from_start_s=controller.time_from_start_s,
                max_error_rad=controller.max_error_rad,
            )
        )

    def destroy(self) -> None:
        """Take the action back."""
        self._server.destroy()

    def _take_up(self, goal_handle: ServerGoalHandle) -> None:
        asked = goal_handle.request.goal
        try:
            if self.busy:
                raise TrajectoryError("another trial is under way; one trial at a time")
            goal = to_goal(asked, self._joints)
            self._begin(goal)
        except TelError as error:
            self._node.get_logger().warning(f"goal refused: {error}")
            refused = TrialResult(
                index=asked.trial,
                alpha=asked.alpha,
                outcome=int(Outcome.REFUSED),
                message=str(error),
                joint_names=list(self._joints),
                rms_error_rad=float("nan"),
                max_error_rad=float("nan"),
                **timing_fields(None),
            )
            goal_handle.execute(lambda handle: self._end_goal(handle, refused))
            return
        self._goal_handle = goal_handle
        if self._timer is not None:
            self._timer.reset()
        self._node.get_logger().info(f"trial {goal.index}: {goal.desired.duration_s:.3f} s")

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if self._goal_handle is None or goal_handle.goal_id != self._goal_handle.goal_id:
            return CancelResponse.REJECT
        self._cancel_trial()
        return CancelResponse.ACCEPT

    def _end_goal(self, goal_handle: ServerGoalHandle, result: TrialResult) -> ExecuteTrial.Result:
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
        elif result.outcome == TrialResult.COMPLETED:
            goal_handle.succeed()
        else:
            goal_handle.abort()
        return ExecuteTrial.Result(result=result)
