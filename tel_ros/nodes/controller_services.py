"""What a controller has next to its commands: trial action, sight of the arm, emergency stop, resuming."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import TrialResult

from tel_ros import local_stop
from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ControlConfig
from tel_ros.core.control.controller import EpController
from tel_ros.core.control.holding import RestDetector
from tel_ros.core.control.loop_timing import LoopTimer
from tel_ros.core.errors import BagError, StateError, TelError, TrajectoryError
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.local_stop import Answer
from tel_ros.nodes import qos
from tel_ros.nodes.clock import STEADY
from tel_ros.nodes.conversions import to_goal, to_result_message
from tel_ros.recording import topics
from tel_ros.recording.trial_result import timing_fields


class TrialServer:
    """Takes up one trial at a time, and hands its result over when the controller says that it has ended.

    An execute callback that waited for the end would block the joint states or keep the executor polling, so
    it runs at the end of the trial only. Every goal is accepted, and one that is not followed is answered
    with the outcome REFUSED and the reason: a rejection cannot carry one. ``controller``: returns the present
    one. ``obstacle``: tells why no trial can begin now, apart from what the controller knows; empty: one can.
    ``timer``: notes the ticks of a trial; None: they are not timed.
    """

    def __init__(
        self,
        node: Node,
        joints: Sequence[str],
        controller: Callable[[], EpController],
        obstacle: Callable[[], str],
        timer: LoopTimer | None,
    ) -> None:
        self._node, self._joints, self._timer = node, joints, timer
        self._controller, self._obstacle = controller, obstacle
        self._goal_handle: ServerGoalHandle | None = None
        self._result = TrialResult()
        self.last: TrialReport | None = None
        """Of the last trial that was not refused."""
        self._server = ActionServer(
            node,
            ExecuteTrial,
            topics.EXECUTE_TRIAL,
            lambda handle: _end_goal(handle, self._result),
            handle_accepted_callback=self._take_up,
            cancel_callback=self._cancel,
        )
        self.destroy = self._server.destroy
        node.create_timer(0.2, self._publish_feedback, clock=STEADY)

    @property
    def busy(self) -> bool:
        """Whether a trial is under way."""
        return self._goal_handle is not None

    def finish(self) -> None:
        """Hand over the result of the trial that is under way, if it has ended."""
        handle = self._goal_handle
        if handle is None or (report := self._controller().report) is None:
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

    def _publish_feedback(self) -> None:
        if self._goal_handle is not None:
            controller = self._controller()
            feedback = ExecuteTrial.Feedback(
                phase=int(controller.phase),
                time_from_start_s=controller.time_from_start_s,
                max_error_rad=controller.course.score.max_error_rad,
            )
            self._goal_handle.publish_feedback(feedback)

    def _take_up(self, goal_handle: ServerGoalHandle) -> None:
        asked = goal_handle.request.goal
        try:
            if self.busy:
                raise TrajectoryError("another trial is under way; one trial at a time")
            goal = to_goal(asked, self._joints)
            if obstacle := self._obstacle():
                raise StateError(obstacle)
            self._controller().start(goal)
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
            goal_handle.execute(lambda handle: _end_goal(handle, refused))
            return
        self._goal_handle = goal_handle
        if self._timer is not None:
            self._timer.reset()
        self._node.get_logger().info(f"trial {goal.index}: {goal.desired.duration_s:.3f} s")

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if self._goal_handle is None or goal_handle.goal_id != self._goal_handle.goal_id:
            return CancelResponse.REJECT
        self._controller().cancel()
        return CancelResponse.ACCEPT


def _end_goal(goal_handle: ServerGoalHandle, result: TrialResult) -> ExecuteTrial.Result:
    if goal_handle.is_cancel_requested:
        goal_handle.canceled()
    elif result.outcome == TrialResult.COMPLETED:
        goal_handle.succeed()
    else:
        goal_handle.abort()
    return ExecuteTrial.Result(result=result)


class SeenArm:
    """What a controller sees of its arm, and for how long it has seen nothing, by the steady clock."""

    def __init__(self, joints: Sequence[str], control: ControlConfig, timeout_s: float) -> None:
        self._joints, self.timeout_s = joints, timeout_s
        self._rest, self._rest_speed_rad_s = RestDetector.of(control), control.settle_speed_rad_s
        self.state: ArmState | None = None
        """The newest."""
        self.useless = ""
        """What is wrong with a message that is no new state."""
        self._new_at = self._heard_at = -math.inf

    def hear(self, state: ArmState | None, counts: bool, useless: str = "") -> None:
        """Take in that a message has come: with a state that counts as new, or useless."""
        self._heard_at, self.state = time.monotonic(), state or self.state
        if counts:
            self._new_at = self._heard_at
        else:
            self.useless = useless

    def settle(self) -> None:
        """Look whether the arm rests; once for each new state, when there is time."""
        self._rest.at_rest(self.state.time_ns, self.state.position_rad)

    @property
    def age_s(self) -> float:
        """Time since the last new state."""
        return time.monotonic() - self._new_at

    @property
    def is_fresh(self) -> bool:
        """Whether a new state has come in time."""
        return self.age_s < self.timeout_s

    @property
    def moves(self) -> bool:
        """Whether the arm moves, as far as its states tell; a coarse encoder makes speeds at rest."""
        if self.state is None or self._rest.still or not self.is_fresh:
            return False
        return bool(np.abs(self.state.velocity_rad_s).max() >= self._rest_speed_rad_s)

    def silence(self) -> str:
        """Say for how long no new state has come."""
        which, why = "joint state", ""
        if self._heard_at > self._new_at:
            which, why = "new joint state", f": {self.useless}"
        return f"no {which} for {self.age_s:.3f} s (time-out {self.timeout_s} s){why}"

    def last_words(self, controller: EpController) -> str:
        """Say what the states tell of the arm that is about to be left."""
        if controller.distrusts:
            return f"whether the arm rests was not seen: {controller.stopped_for}"
        if self.state is None or not self.is_fresh:
            return "no joint states came at the end: whether the arm rests was not seen"
        if self._rest.still or (controller.at_final_effort and not self.moves):
            return "the arm is at rest"
        fastest = int(np.abs(self.state.velocity_rad_s).argmax())
        speed_rad_s = abs(self.state.velocity_rad_s[fastest])
        return f"the arm was not seen at rest: {self._joints[fastest]} moves at {speed_rad_s:.2f} rad/s"


class SafetyServices:
    """The emergency stop in software: latched until it is reset, and told on a latched topic.

    Asked for by services, and on the same computer without ROS (``tel stop``): :meth:`serve` has to be called
    often. ``why_not_reset`` tells why a reset has to wait; empty: it need not.
    """

    def __init__(
        self, node: Node, controller: Callable[[], EpController], why_not_reset: Callable[[], str]
    ) -> None:
        self._node, self._controller, self._why_not_reset = node, controller, why_not_reset
        self.reason = ""
        """Why the stop is latched; empty: it is not."""
        self._stopped_pub = node.create_publisher(Bool, topics.SAFETY_STOPPED, qos.LATCHED)
        self._tell()
        self.stop_name, self.reset_name = (
            node.create_service(Trigger, name, partial(_answered, act)).service_name
            for name, act in ((topics.SAFETY_STOP, self._stop), (topics.SAFETY_RESET, self._reset))
        )
        """Full names of the services."""
        me = local_stop.Controller(node.context.get_domain_id(), os.getpid(), node.get_namespace())
        self.serve: Callable[[], None] = lambda: None
        try:
            answers = {local_stop.STOP: self._stop, local_stop.RESET: self._reset}
            self.serve = local_stop.Listener(me, answers).serve
        except OSError as error:
            node.get_logger().warning(f"`tel stop` has to take the way through the network here: {error}")

    def _tell(self) -> None:
        self._stopped_pub.publish(Bool(data=bool(self.reason)))

    def _stop(self) -> Answer:
        self.reason = f"emergency stop ({self.stop_name})"
        self._controller().stop_for(self.reason)  # also if it is latched: asking twice is asking to stop
        self._tell()
        self._node.get_logger().error(f"{self.reason}: latched until {self.reset_name}")
        return Answer(True, f"stopped until {self.reset_name}")

    def _reset(self) -> Answer:
        latched = self.reason or self._controller().stopped_for
        why_not = self._why_not_reset() if latched else "no stop is latched"
        if why_not:
            self._node.get_logger().warning(f"not reset: {why_not}")
            return Answer(False, f"not reset: {why_not}")
        self.reason = ""
        self._controller().reset_stop()
        self._tell()
        self._node.get_logger().info("reset: trials are accepted again")
        return Answer(True, "reset: trials are accepted again")


def _answered(
    act: Callable[[], Answer], request: Trigger.Request, response: Trigger.Response
) -> Trigger.Response:
    response.success, response.message = act()
    return response


def replay_control(controller: EpController, run: Path, joints: Sequence[str]) -> bool:
    """Let a new controller go through all trials of a run, so that it holds what it held after them.

    Nothing is sent anywhere. The controller is a function of goals and joint states: fed with the recorded
    ones it has to decide what is recorded. False: it did not, since something that is not recorded, such as
    an emergency stop, had a part; it must not be used then. Raises BagError: a bag cannot be read;
    TrajectoryError: a recorded goal is one that the arm must not follow.
    """
    # Imported late: a loop that begins anew needs no bags, and should not wait for their reader.
    from tel_ros.recording.run_folder import trial_bags
    from tel_ros.recording.trial_bag import read_topic, read_trial

    for bag in trial_bags(run):
        goals = read_topic(bag, topics.TRIAL_GOAL)
        trial = read_trial(bag)
        if trial.joints != tuple(joints):
            raise BagError(bag, f"is of the joints {', '.join(trial.joints)}", ", ".join(joints))
        controller.start(to_goal(goals[0][1], joints))
        rows = zip(trial.time_ns.tolist(), trial.position_rad, trial.velocity_rad_s, strict=True)
        for k, (time_ns, position_rad, velocity_rad_s) in enumerate(rows):
            tick = controller.tick(ArmState(time_ns, position_rad, velocity_rad_s))
            if (
                tick is None
                or tick.phase != trial.phase[k]
                or not np.array_equal(tick.equilibrium_rad, trial.equilibrium_rad[k])
                or not np.array_equal(tick.effort_nm, trial.effort_nm[k])
            ):
                return False
        if controller.active:
            return False
    return True
