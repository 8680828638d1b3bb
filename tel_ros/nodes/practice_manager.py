"""The practice manager: asks the strategy for trials and takes each from the plan to the lesson learned."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool
from tel_interfaces.action import ExecuteTrial, Practice
from tel_interfaces.msg import TrialGoal, TrialResult
from tel_interfaces.srv import (
    LoadNetwork,
    PredictEquilibrium,
    SaveNetwork,
    StartRecording,
    StopRecording,
    TrainOnTrials,
)

from tel_ros.core.errors import ConfigError, TelError
from tel_ros.core.practice.decisions import Ending, Forecast, Movement, PlannedTrial
from tel_ros.core.practice.forecast import forecast_of, forecast_trajectory
from tel_ros.core.practice.lessons import has_to_teach, is_learned_from
from tel_ros.core.practice.movement_path import command, desired_trajectory
from tel_ros.core.practice.velocity_limit import require_within_velocity_limits
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import (
    desired_message,
    equilibrium_of,
    to_array,
    to_goal_message,
)
from tel_ros.nodes.lifecycle import LifecycleClient
from tel_ros.nodes.parameters import load_parameters
from tel_ros.nodes.pause import Pause
from tel_ros.nodes.progress import Progress
from tel_ros.nodes.resuming import declare_resume
from tel_ros.nodes.runner import run_node
from tel_ros.nodes.waiting import AGAIN_S, DeclinedError, NoAnswerError, call, namespace_hint, send_goal, wait
from tel_ros.recording import topics
from tel_ros.recording.run_folder import (
    NETWORK_FILE,
    network_after,
    open_run_folder,
    trial_bag,
    written_config,
)
from tel_ros.recording.run_state import RunState
from tel_ros.recording.summary import RunSummary, TrialRow
from tel_ros.recording.trial_metadata import trial_metadata
from tel_ros.recording.trial_report import to_report
from tel_ros.recording.waypoint_file import load_known_path, load_path

ANSWER_TIMEOUT_S = 30.0
SILENCE_TIMEOUT_S = 10.0
TRAINING_TIMEOUT_S = 600.0
REPLAY_TIMEOUT_S = 600.0
"""Arm and controller of a resumed run first go through the trials of before, a second or two for each."""
STOPPING_TIMEOUT_S = 2.5


class PracticeManagerNode(Node):
    """Runs one practice run at a time: desired trajectory → predict → record → execute → train."""

    def __init__(self) -> None:
        super().__init__("practice_manager")
        self._config = load_parameters(
            self, "arm", "path", "run", "practice", "learning", "control", "sim", "seed"
        )
        self._resumed = declare_resume(self)
        self._path = load_path(self._config.path, self._config.arm)
        self._known_path = load_known_path(self._config.path, self._config.arm)
        group = ReentrantCallbackGroup()
        self._predict = self.create_client(PredictEquilibrium, topics.PREDICT, callback_group=group)
        self._train = self.create_client(TrainOnTrials, topics.TRAIN, callback_group=group)
        self._save = self.create_client(SaveNetwork, topics.SAVE, callback_group=group)
        self._load = self.create_client(LoadNetwork, topics.LOAD, callback_group=group)
        self._start_recording = self.create_client(
            StartRecording, topics.START_RECORDING, callback_group=group
        )
        self._stop_recording = self.create_client(StopRecording, topics.STOP_RECORDING, callback_group=group)
        self._controller = LifecycleClient(self, topics.EP_CONTROLLER, group)
        self._execute = ActionClient(self, ExecuteTrial, topics.EXECUTE_TRIAL, callback_group=group)
        self._busy = self._stopping = False
        self._stopping_since = math.inf
        self._written = self._config
        self._ready = threading.Event()
        self._stop_latched = self._stop_seen = False
        self._emergency_stop = (
            f"emergency stop: as long as {topics.EP_CONTROLLER} runs on, nothing moves before "
            f"ros2 service call {self.resolve_service_name(topics.SAFETY_RESET)} std_srvs/srv/Trigger"
        )
        for topic, heard in ((topics.READY, self._on_ready), (topics.SAFETY_STOPPED, self._on_stopped)):
            self.create_subscription(Bool, topic, heard, qos.LATCHED, callback_group=group)
        self._pause = Pause(self, group)
        # For whoever watches; the controller gets it in its action, the recorder with its request.
        self._goal_pub = self.create_publisher(TrialGoal, topics.TRIAL_GOAL, qos.LATCHED)
        self._server = ActionServer(
            self,
            Practice,
            topics.PRACTICE,
            execute_callback=self._practise,
            goal_callback=self._consider,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            callback_group=group,
        )

    def stop(self) -> None:
        """Cancel the trial that is under way and end the run."""
        self._stopping, self._stopping_since = True, time.monotonic()

    @property
    def stopped(self) -> bool:
        """Whether no run is under way any more."""
        return not self._busy

    def _on_ready(self, message: Bool) -> None:
        if message.data:
            self._ready.set()
        else:
            self._ready.clear()

    def _on_stopped(self, message: Bool) -> None:
        self._stop_latched = message.data
        self._stop_seen |= message.data

    def _consider(self, goal: Practice.Goal) -> GoalResponse:
        if self._busy or self._stopping:
            self.get_logger().warning("goal rejected: another practice run is under way")
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    def _practise(self, goal_handle: ServerGoalHandle) -> Practice.Result:
        result = Practice.Result(run_dir=goal_handle.request.run_dir)
        try:
            if not goal_handle.request.run_dir:
                raise ConfigError("run_dir", "", "the folder of the run")
            require_within_velocity_limits(self._config, self._path, self._known_path)
            folder = Path(goal_handle.request.run_dir)
            resumes = self._resumed is not None and folder.resolve() == self._resumed.resolve()
            self._written = written_config(folder) if resumes else open_run_folder(folder, self._config)
            state = self._earlier(folder) if resumes else RunState.new(self._config)
            summary = RunSummary(folder, self._written)
            summary.rows = list(state.rows)
            self._run(goal_handle, folder, summary, state, result)
            result.outcome, result.message = summary.outcome, summary.message
        except TelError as error:
            result.outcome, result.message = "failed", str(error)
        if result.outcome == "failed":
            self.get_logger().error(result.message)
        if result.outcome == "completed":
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        self._busy = False
        return result

    def _earlier(self, folder: Path) -> RunState:
        # Imported late: learners take long to import, and only a resumed run asks them here.
        from tel_ros.recording.earlier_trials import earlier_trials

        return earlier_trials(folder, self._config)

    def _run(
        self,
        goal_handle: ServerGoalHandle,
        folder: Path,
        summary: RunSummary,
        state: RunState,
        result: Practice.Result,
    ) -> None:
        strategy, last, self._lock_up = state.strategy, state.last, state.lock_up
        progress = Progress(goal_handle)
        ending = Ending("cancelled", "the run was cancelled")
        # A stop ends the run in which it comes, even if it has been reset by the time that the trial is over.
        self._stop_seen = self._stop_latched
        try:
            patience_s = REPLAY_TIMEOUT_S if state.rows else 0.0
            self._controller.bring_up(max(ANSWER_TIMEOUT_S, patience_s), self._give_up_in_time)
            self._wait_for_arm(max(self._config.run.arm_timeout_s, patience_s))
            if state.network is None:
                self._save_network(network_after(folder, 0))
            else:
                self._load_network(state.network)
            while not self._cancelled(goal_handle):
                if self._pause.asked and not self._stop_seen:
                    progress.paused()
                    self._pause.wait(lambda: self._cancelled(goal_handle) or self._stop_seen)
                    continue
                if self._stop_seen:
                    # Whatever the strategy makes of a trial that was aborted: a person has said stop.
                    ending = Ending("aborted", self._emergency_stop)
                    break
                decision = strategy.next(last, self._forecast)
                if isinstance(decision, Ending):
                    ending = decision
                    break
                progress.begin(decision, strategy.preview())
                row, message = self._trial(goal_handle, folder, decision, progress)
                summary.add(row)
                last = row.report
                result.trials.append(message)
                progress.trial_done(message, row)
            summary.end(ending.outcome, ending.message)
        except TelError as error:
            if self._stop_seen:
                summary.end("aborted", f"{self._emergency_stop}; {error}")
            else:
                summary.end("cancelled" if self._cancelled(goal_handle) else "failed", str(error))

    def _wait_for_arm(self, timeout_s: float) -> None:
        if not self._ready.wait(timeout_s):
            commands = topics.COMMANDS[self._config.arm.command_interface]
            missing = [topics.JOINT_STATES] if self.count_publishers(topics.JOINT_STATES) == 0 else []
            missing += [commands] if self.count_subscribers(commands) == 0 else []
            raise NoAnswerError(
                f"the arm is not there: within {timeout_s:.1f} s ep_controller has not seen "
                f"{self.resolve_topic_name(topics.JOINT_STATES)} and a subscriber of "
                f"{self.resolve_topic_name(commands)}, and the arm at rest.{namespace_hint(self, *missing)}"
            )

    def _trial(
        self, goal_handle: ServerGoalHandle, folder: Path, plan: PlannedTrial, progress: Progress
    ) -> tuple[TrialRow, TrialResult]:
        started = time.monotonic()
        bag = trial_bag(folder, plan.index)
        if plan.go_back_to is not None:
            self._load_network(network_after(folder, plan.go_back_to))
        goal, revision = self._goal(plan)
        metadata = trial_metadata(plan, self._config, self._written, revision)
        self._wait_for_arm(self._config.run.arm_timeout_s)  # who may have stood still since the last trial
        progress.stage("recording")
        self._call(
            self._start_recording,
            StartRecording.Request(
                bag=str(bag),
                goal=goal,
                metadata_keys=list(metadata),
                metadata_values=list(metadata.values()),
            ),
            ANSWER_TIMEOUT_S,
        )
        self._goal_pub.publish(goal)
        self._wait_for_arm(self._config.run.arm_timeout_s)  # a disturbed brake may have moved it meanwhile
        progress.stage("moving")
        message = self._executed(goal_handle, goal, progress)
        self._call(self._stop_recording, StopRecording.Request(result=message), ANSWER_TIMEOUT_S)
        if message.outcome == TrialResult.REFUSED:
            raise NoAnswerError(f"trial {plan.index} was refused: {message.message}")
        report = to_report(message)
        row = TrialRow(plan=plan, report=report, bag=bag.name, wall_s=0.0)
        if is_learned_from(report.outcome, report.run_ns > 0, self._config.practice.on_abort):
            progress.stage("training")
            self._learn(row, bag, folder)
        row.wall_s = time.monotonic() - started
        return row, message

    def _goal(self, plan: PlannedTrial) -> tuple[TrialGoal, str]:
        """Return the goal of a trial, and the revision of the network that has said what to command."""
        joints = self._config.arm.joints
        movement = plan.movement
        desired = desired_trajectory(self._path, self._known_path, movement, self._config.control.rate_hz)
        prediction = self._prediction(desired)
        equilibrium_rad = equilibrium_of(prediction.equilibrium, joints)
        asked = command(self._config.arm, movement, desired, equilibrium_rad)
        # Said even if it is nothing new: a bag then tells what its efforts came from.
        springs = asked.springs or Springs.of(self._config.arm)
        # An error in the effort takes an error in û that is the smaller the stiffer the springs are.
        std_rad = to_array(np.array(prediction.std_rad) / movement.stiffness)
        goal = to_goal_message(
            plan.index, plan.alpha, joints, desired, asked.equilibrium_rad, std_rad, springs
        )
        return goal, prediction.revision

    def _prediction(self, desired: DesiredTrajectory) -> PredictEquilibrium.Response:
        request = PredictEquilibrium.Request(desired=desired_message(self._config.arm.joints, desired))
        prediction: PredictEquilibrium.Response = self._call(self._predict, request, ANSWER_TIMEOUT_S)
        return prediction

    def _forecast(self, movement: Movement) -> Forecast:
        """Return what the network, as it is, expects of a movement."""
        arm, desired = self._config.arm, forecast_trajectory(self._path, self._known_path, movement)
        prediction = self._prediction(desired)
        offset_rad = equilibrium_of(prediction.equilibrium, arm.joints) - desired.position_rad
        std_rad = np.array(prediction.std_rad).reshape(offset_rad.shape)
        return forecast_of(desired, offset_rad, std_rad, arm, movement)

    def _learn(self, row: TrialRow, bag: Path, folder: Path) -> None:
        try:
            trained = self._call(self._train, TrainOnTrials.Request(bags=[str(bag)]), TRAINING_TIMEOUT_S)
        except DeclinedError as error:
            if has_to_teach(row.report.outcome, self._config.practice.on_abort):
                raise
            self.get_logger().warning(f"nothing was learned from trial {row.plan.index}: {error}")
            if row.report.outcome == Outcome.COMPLETED:  # one to go back to
                self._save_network(network_after(folder, row.plan.index))
            return
        row.training_rms_before_rad = trained.training_rms_before_rad
        row.training_rms_after_rad = trained.training_rms_after_rad
        row.rms_command_change_rad = trained.rms_command_change_rad
        row.grown = list(trained.grown)
        row.warning = self._lock_up.after_trial(
            row.plan.alpha,
            row.report.rms_error_rad,
            row.training_rms_before_rad,
            row.training_rms_after_rad,
        )
        if row.warning:
            self.get_logger().warning(f"trial {row.plan.index}: {row.warning}")
        self._save_network(network_after(folder, row.plan.index))
        self._save_network(folder / NETWORK_FILE)

    def _save_network(self, file: Path) -> None:
        self._call(self._save, SaveNetwork.Request(path=str(file)), ANSWER_TIMEOUT_S)

    def _load_network(self, file: Path) -> None:
        self._call(self._load, LoadNetwork.Request(path=str(file)), ANSWER_TIMEOUT_S)

    def _executed(self, goal_handle: ServerGoalHandle, goal: TrialGoal, progress: Progress) -> TrialResult:
        heard_at = time.monotonic()
        cancelling = False

        def on_feedback(message) -> None:  # noqa: ANN001 - a type that rclpy makes
            nonlocal heard_at
            heard_at = time.monotonic()
            progress.moving(message.feedback)

        def watch() -> None:
            nonlocal cancelling
            if time.monotonic() - heard_at > SILENCE_TIMEOUT_S:
                raise NoAnswerError(f"{topics.EXECUTE_TRIAL} was silent for {SILENCE_TIMEOUT_S:.0f} s")
            self._give_up_in_time()
            if self._cancelled(goal_handle) and not cancelling:
                cancelling = True
                handle.cancel_goal_async()

        handle = send_goal(self._execute, ExecuteTrial.Goal(goal=goal), ANSWER_TIMEOUT_S, on_feedback)
        return wait(handle.get_result_async(), float("inf"), topics.EXECUTE_TRIAL, watch).result.result

    def _call(self, client: Client, request: Any, timeout_s: float) -> Any:
        may_be_done_twice = client in (self._predict, self._save, self._load)
        again_s = AGAIN_S if may_be_done_twice else math.inf
        return call(client, request, timeout_s, self._give_up_in_time, again_s)

    def _give_up_in_time(self) -> None:
        """When this node has to end, the others may have ended already: do not wait for long."""
        if time.monotonic() - self._stopping_since > STOPPING_TIMEOUT_S:
            raise NoAnswerError("the run was ended from outside")

    def _cancelled(self, goal_handle: ServerGoalHandle) -> bool:
        return self._stopping or goal_handle.is_cancel_requested


def main() -> None:
    """Run the node."""
    run_node(PracticeManagerNode, MultiThreadedExecutor)


if __name__ == "__main__":
    main()
