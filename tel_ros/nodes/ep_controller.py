"""The equilibrium-point controller: joint states in, commands out, one trial at a time."""

from __future__ import annotations

import math
import time

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import ControlState, TrialResult

from tel_ros.core.control.controller import EpController
from tel_ros.core.control.records import ArmState, Outcome, Tick
from tel_ros.core.errors import StateError, TelError, TrajectoryError
from tel_ros.nodes import qos
from tel_ros.nodes.command_channel import CommandChannel
from tel_ros.nodes.conversions import (
    ControlStateFiller,
    JointStateReader,
    idle_state,
    to_goal,
    to_result_message,
)
from tel_ros.nodes.hot_loop import BusyGroup
from tel_ros.nodes.parameters import load_parameters
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics

WATCHDOG_PERIOD_S = 0.02
FEEDBACK_PERIOD_S = 0.2
READY_PERIOD_S = 0.1
COMPLAINT_PERIOD_S = 1.0


class EpControllerNode(Node):
    """Answers every joint state with a command while a trial is under way or its end is held.

    Before the first trial nothing is commanded. An arm whose time stands still without commands (the
    simulated one in lockstep) is left alone between trials as well, so that a run does not depend on how
    long learning takes.
    """

    def __init__(self) -> None:
        super().__init__("ep_controller")
        config = load_parameters(self, "arm", "control", "run", "sim")
        self._joints = config.arm.joints
        self._controller = EpController(config.arm, config.control)
        self._answers_between_trials = not config.arm_waits_for_commands
        self._state_timeout_s = (
            config.sim.lockstep_timeout_s if config.arm_waits_for_commands else config.control.state_timeout_s
        )
        self._reader = JointStateReader(self._joints, config.control)
        self._estimated: tuple[str, ...] = ()
        self._control_state = ControlStateFiller()
        self._goal_handle: ServerGoalHandle | None = None
        self._seen: ArmState | None = None
        self._answered_ns = -1
        self._last_state_at = -math.inf
        self._commanding = False

        self._commands = CommandChannel(self, config.arm)
        self._state_pub = self.create_publisher(ControlState, topics.CONTROL_STATES, qos.STREAM)
        self.busy_subscriptions = [
            self.create_subscription(
                JointState,
                topics.JOINT_STATES,
                self._on_joint_state,
                qos.NEWEST,
                callback_group=BusyGroup(),
            )
        ]
        self.create_timer(WATCHDOG_PERIOD_S, self._watch_states)
        self.create_timer(FEEDBACK_PERIOD_S, self._publish_feedback)
        self._ready = Bool()
        self._ready_pub = self.create_publisher(Bool, topics.READY, qos.LATCHED)
        self._ready_pub.publish(self._ready)
        self.create_timer(READY_PERIOD_S, self._publish_ready)
        # The trial is driven by joint states. An execute callback that waited for its end would either block
        # them or keep the executor polling, so it runs at the end of the trial only, to hand over the result.
        self._server = ActionServer(
            self,
            ExecuteTrial,
            topics.EXECUTE_TRIAL,
            execute_callback=self._hand_over,
            handle_accepted_callback=self._take_up,
            cancel_callback=self._cancel,
        )
        self._result = TrialResult()
        # The first line that a process logs takes rclpy tens of milliseconds (it goes through all modules for
        # the caller): now, not in the first tick of a trial.
        self.get_logger().info(f"waits for {topics.JOINT_STATES}")

    def stop(self) -> None:
        """Bring a moving arm to rest."""
        self._controller.cancel()

    @property
    def stopped(self) -> bool:
        """Whether no trial is under way any more."""
        return not self._controller.active

    def destroy_node(self) -> None:
        """Let the arm go (zero effort, unless its drives hold it), then go."""
        if self._commanding:
            self._let_go()
        self._server.destroy()
        super().destroy_node()

    def _on_joint_state(self, message: JointState) -> None:
        try:
            state = self._reader.read(message)
        except StateError as error:
            self.get_logger().error(f"{error}; it is ignored", throttle_duration_sec=COMPLAINT_PERIOD_S)
            return
        if self._reader.estimated != self._estimated:
            self._say_what_is_estimated()
        is_new = self._seen is None or state.time_ns != self._seen.time_ns
        self._seen = state
        if is_new or not self._controller.active:
            self._last_state_at = time.monotonic()
        if not self._controller.active and not self._answers_between_trials:
            self._commanding = False
        elif state.time_ns != self._answered_ns:
            self._answer(state)
        elif self._controller.active:
            # A waiting arm repeats its state until it gets the answer.
            self._commands.repeat()

    def _say_what_is_estimated(self) -> None:
        self._estimated = self._reader.estimated
        if self._estimated:
            self.get_logger().warning(
                f"the joint states have no velocity for {', '.join(self._estimated)}: "
                "it is estimated from the positions (control.velocity_filter_hz)"
            )
        else:
            self.get_logger().info("the joint states have all velocities now: none is estimated")

    def _answer(self, state: ArmState) -> None:
        goal = self._controller.goal
        tick = self._controller.tick(state)
        if tick is not None:
            self._publish(goal.index if goal else 0, state, tick)
        self._finish_trial()

    def _publish(self, trial: int, state: ArmState, tick: Tick) -> None:
        self._commanding, self._answered_ns = True, state.time_ns
        self._commands.send(state.time_ns, tick)
        self._state_pub.publish(self._control_state.fill(trial, state, tick))

    def _let_go(self) -> None:
        self._commanding = False
        self._commands.let_go(self._seen.time_ns if self._seen else 0)

    def _states_are_fresh(self) -> bool:
        return time.monotonic() - self._last_state_at < self._state_timeout_s

    def _watch_states(self) -> None:
        if self._states_are_fresh() or not (self._commanding or self._controller.active):
            return
        message = f"no joint state for {self._state_timeout_s} s"
        self.get_logger().error(f"{message}: {self._commands.let_go_text}")
        self._let_go()
        self._controller.lose_states(message)
        self._finish_trial()

    def _take_up(self, goal_handle: ServerGoalHandle) -> None:
        try:
            if not self._states_are_fresh():
                raise StateError(f"no joint states on {topics.JOINT_STATES}")
            if not self._commands.is_heard:
                raise StateError(f"nobody listens to {self._commands.topic}")
            if self._goal_handle is not None:
                raise TrajectoryError("another trial is under way; one trial at a time")
            goal = to_goal(goal_handle.request.goal, self._joints)
            self._controller.start(goal)
        except TelError as error:
            asked = goal_handle.request.goal
            self.get_logger().warning(f"goal refused: {error}")
            refused = TrialResult(
                index=asked.trial,
                alpha=asked.alpha,
                outcome=int(Outcome.REFUSED),
                message=str(error),
                joint_names=list(self._joints),
                rms_error_rad=float("nan"),
                max_error_rad=float("nan"),
            )
            goal_handle.execute(lambda handle: self._end_goal(handle, refused))
            return
        self._goal_handle = goal_handle
        self.get_logger().info(f"trial {goal.index}: {goal.desired.duration_s:.3f} s")

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        if self._goal_handle is None or goal_handle.goal_id != self._goal_handle.goal_id:
            return CancelResponse.REJECT
        self._controller.cancel()
        return CancelResponse.ACCEPT

    def _finish_trial(self) -> None:
        report, handle = self._controller.report, self._goal_handle
        if report is None or handle is None:
            return
        if report.message:
            self.get_logger().warning(f"trial {report.index}: {report.outcome.name}: {report.message}")
        self._goal_handle, self._result = None, to_result_message(report, self._joints)
        handle.execute()

    def _hand_over(self, goal_handle: ServerGoalHandle) -> ExecuteTrial.Result:
        return self._end_goal(goal_handle, self._result)

    def _end_goal(self, goal_handle: ServerGoalHandle, result: TrialResult) -> ExecuteTrial.Result:
        if goal_handle.is_cancel_requested:
            goal_handle.canceled()
        elif result.outcome == TrialResult.COMPLETED:
            goal_handle.succeed()
        else:
            goal_handle.abort()
        return ExecuteTrial.Result(result=result)

    def _publish_ready(self) -> None:
        ready = self._states_are_fresh() and self._commands.is_heard
        if ready != self._ready.data:
            self._ready.data = ready
            self._ready_pub.publish(self._ready)
        if self._seen is not None and self._states_are_fresh() and not self._commanding:
            self._state_pub.publish(idle_state(self._seen))

    def _publish_feedback(self) -> None:
        handle, controller = self._goal_handle, self._controller
        if handle is None:
            return
        handle.publish_feedback(
            ExecuteTrial.Feedback(
                phase=int(controller.phase),
                time_from_start_s=controller.time_from_start_s,
                max_error_rad=controller.max_error_rad,
            )
        )


def main() -> None:
    """Run the node."""
    run_node(EpControllerNode)


if __name__ == "__main__":
    main()
