"""What a controller offers next to its commands: the trial action, the emergency stop, and its health."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import TrialResult

from tel_ros.core.control.controller import EpController
from tel_ros.core.control.loop_timing import LoopTimer
from tel_ros.core.errors import TelError, TrajectoryError
from tel_ros.core.trial import Outcome, TrialGoal, TrialReport
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_goal, to_result_message
from tel_ros.nodes.diagnostics import Health, Level
from tel_ros.recording import topics
from tel_ros.recording.trial_result import timing_fields


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
        timer: that the controller notes the ticks of a trial in; None: they are not timed.
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
        """Hand over the result of the trial that is under way; None: it has not ended."""
        handle = self._goal_handle
        if report is None or handle is None:
            return
        if self._timer is not None:
            report = replace(report, timing=self._timer.timing())
        log = self._node.get_logger()
        if report.message:
            log.warning(f"trial {report.index}: {report.outcome.name}: {report.message}")
        if report.timing is not None and report.timing.warning:
            log.warning(f"trial {report.index}: {report.timing.warning}")
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


class SafetyServices:
    """The emergency stop in software: latched until it is reset, and told on a latched topic.

    Args:
        node: that commands the arm.
        controller: returns the present one.
        why_not_reset: tells why a reset has to wait; empty: it need not.
    """

    def __init__(
        self, node: Node, controller: Callable[[], EpController], why_not_reset: Callable[[], str]
    ) -> None:
        self._node, self._controller, self._why_not_reset = node, controller, why_not_reset
        self.reason = ""
        """Why the stop is latched; empty: it is not."""
        self._stopped_pub = node.create_publisher(Bool, topics.SAFETY_STOPPED, qos.LATCHED)
        self._tell()
        self.stop_name = node.create_service(Trigger, topics.SAFETY_STOP, self._stop).service_name
        self.reset_name = node.create_service(Trigger, topics.SAFETY_RESET, self._reset).service_name
        """Full names of the services."""

    def _tell(self) -> None:
        self._stopped_pub.publish(Bool(data=bool(self.reason)))

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.reason = f"emergency stop ({self.stop_name})"
        self._controller().stop_for(
            self.reason
        )  # also if it is latched already: asking twice is asking to stop
        self._tell()
        self._node.get_logger().error(f"{self.reason}: latched until {self.reset_name}")
        response.success, response.message = True, f"stopped until {self.reset_name}"
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        why_not = self._why_not_reset() if self.reason else "no stop is latched"
        if why_not:
            response.message = f"not reset: {why_not}"
            self._node.get_logger().warning(response.message)
            return response
        self.reason = ""
        self._controller().reset_stop()
        self._tell()
        response.success, response.message = True, "reset: trials are accepted again"
        self._node.get_logger().info(response.message)
        return response


def controller_health(
    controller: EpController,
    *,
    lifecycle: str,
    refusal: str,
    stopped: str,
    reset_name: str,
    states_topic: str,
    commands_topic: str,
    states_rate_hz: float,
    states_age_s: float,
    states_are_fresh: bool,
    listeners: int,
    last: TrialReport | None,
) -> Health:
    """Return what a controller says about itself: the worst that is known, and all values.

    Args:
        controller: of the node.
        lifecycle: state of the node.
        refusal: why the last transition that was asked for was refused.
        stopped: why an emergency stop is latched; empty: none is.
        reset_name: the service that ends it.
        states_topic: full name.
        commands_topic: full name.
        states_rate_hz: of the joint states.
        states_age_s: since the newest one arrived (wall clock).
        states_are_fresh: whether that is recent enough.
        listeners: subscriptions of the commands.
        last: the trial that ended last.
    """
    trial, phase = controller.goal.index if controller.goal else 0, controller.phase.name
    ended = f"trial {last.index}: {last.outcome.name}" if last else "none"
    ended += f": {last.message}" if last and last.message else ""
    found = (
        (stopped, Level.ERROR, f"{stopped}; {reset_name} ends it"),
        (lifecycle != "active", Level.WARN, f"{lifecycle}: it commands nothing"),
        (not states_are_fresh, Level.ERROR, f"no joint states on {states_topic}"),
        (listeners == 0, Level.ERROR, f"nobody listens to {commands_topic}"),
        (trial, Level.OK, f"trial {trial}: {phase}"),
        (last and last.outcome == Outcome.ABORTED, Level.WARN, f"{ended}; {phase}"),
        (True, Level.OK, phase),
    )
    level, message = next((level, message) for holds, level, message in found if holds)
    values: dict[str, object] = {
        "lifecycle": lifecycle,
        "phase": phase,
        "trial": trial or "none",
        "emergency_stop": stopped or "not latched",
        "states_rate_hz": f"{states_rate_hz:.1f}",
        "states_age_s": f"{states_age_s:.3f}",
        "listeners_to_commands": listeners,
        "last_refusal": refusal or "none",
        "last_trial": ended,
    }
    return Health(level, message, values)
