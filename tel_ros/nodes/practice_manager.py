"""The practice manager: a practice session whose arm and network are the other nodes of the graph."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Bool
from tel_interfaces.action import Practice

from tel_ros.core.errors import ConfigError, TelError
from tel_ros.core.practice.feasibility import require_within_velocity_limits
from tel_ros.core.practice.session import PracticeSession
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending
from tel_ros.nodes import qos
from tel_ros.nodes.conversions import to_result_message
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.parameters import declare_resume, load_parameters, on_set
from tel_ros.nodes.practice_ports import ANSWER_TIMEOUT_S, PracticePorts, ReadyArm, RunContext
from tel_ros.nodes.run_progress import Pause, Progress
from tel_ros.nodes.runner import run_node
from tel_ros.nodes.waiting import NoAnswerError, PatientExecutor
from tel_ros.recording import topics
from tel_ros.recording.config_file import with_values
from tel_ros.recording.run_folder import open_run_folder, written_config
from tel_ros.recording.summary import RunSummary, TrialRow
from tel_ros.recording.waypoint_file import load_known_path, load_path

REPLAY_TIMEOUT_S = 600.0
"""Arm and controller of a resumed run first go through the earlier trials, a second or two for each."""
STOPPING_TIMEOUT_S = 2.5
REPORT_TIMEOUT_S = 120.0
CLIENT_GONE_S = 3.0
"""After how long without anybody who waits for the result the client counts as gone."""
SETTABLE = tuple(f"practice.{key}" for key in ("trials", "tolerance_rad", "step_tolerance_rad", "on_abort"))
"""Parameters that hold from the next run on; other nodes do not depend on them."""


class PracticeManagerNode(Node):
    """Runs one practice run at a time; pause, emergency stop and cancellation act between two trials.

    A goal is rejected only while another run is under way or the node ends: a rejection carries no reason.
    Whatever else is wrong with it is told by its result, before anything moves.
    """

    def __init__(self) -> None:
        super().__init__("practice_manager")
        sections = ("arm", "path", "run", "practice", "learning", "control", "sim", "seed")
        self._config = load_parameters(self, *sections, settable=SETTABLE)
        on_set(self, SETTABLE, self._change)
        self._changing = threading.Lock()
        self._resumed = declare_resume(self)
        self._path = load_path(self._config.path, self._config.arm)
        self._known_path = load_known_path(self._config.path, self._config.arm)
        group = ReentrantCallbackGroup()
        self._arm = ReadyArm(self, group, self._config)
        self._ports = PracticePorts(self, group, self._config, self._arm.wait, self._give_up_in_time)
        about = ParameterDescriptor(description="whether a run ends with its report", read_only=True)
        self._makes_report = bool(self.declare_parameter("report", True, about).value)
        self._busy = self._stopping = False
        self._doing, self._last = "waits for a run", Health(Level.OK, "waits for a run")
        self._client_seen_at, self._client_gone = 0.0, False
        self._result_service = f"{self.resolve_service_name(topics.PRACTICE)}/_action/get_result"
        self._stopping_since = math.inf
        self._stop_latched = self._stop_seen = False
        self.create_subscription(
            Bool, topics.SAFETY_STOPPED, self._on_stopped, qos.LATCHED, callback_group=group
        )
        self._emergency_stop = (
            f"emergency stop: as long as {topics.EP_CONTROLLER} runs on, nothing moves before "
            f"tel reset (service {self.resolve_service_name(topics.SAFETY_RESET)})"
        )
        self._pause = Pause(self, group)
        self._server = ActionServer(
            self,
            Practice,
            topics.PRACTICE,
            execute_callback=self._practise,
            goal_callback=self._consider,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            callback_group=group,
        )
        self._diagnostics = Diagnostics(self, "practice", self._config.arm.name, self._health, group)

    def stop(self) -> None:
        """Cancel the trial that is under way and end the run."""
        self._stopping, self._stopping_since = True, time.monotonic()

    @property
    def stopped(self) -> bool:
        """Whether no run is under way any more."""
        return not self._busy

    def _on_stopped(self, message: Bool) -> None:
        self._stop_latched = message.data
        self._stop_seen |= message.data

    def _change(self, values: Mapping[str, Any]) -> None:
        with self._changing:
            if self._busy:
                raise TelError("a practice run is under way and keeps its configuration; set it afterwards")
            self._config = with_values(self._config, values, "ros2 param set")

    def _consider(self, goal: Practice.Goal) -> GoalResponse:
        with self._changing:
            if self._busy or self._stopping:
                why = "the node is ending" if self._stopping else "another practice run is under way"
                self.get_logger().warning(f"goal rejected: {why}")
                return GoalResponse.REJECT
            self._busy, self._client_seen_at = True, time.monotonic()
        return GoalResponse.ACCEPT

    def _practise(self, goal_handle: ServerGoalHandle) -> Practice.Result:
        result = Practice.Result(run_dir=goal_handle.request.run_dir)
        self._doing = f"run {result.run_dir} begins"
        self.get_logger().info(self._doing)
        try:
            summary = self._run(goal_handle, result)
            result.outcome, result.message = summary.outcome, summary.message
        except TelError as error:
            result.outcome, result.message = "failed", str(error)
        except BaseException:
            self._busy = False  # else no other run would be taken up, and this node would not end
            raise
        ended = f"run {result.run_dir} {result.outcome}" + (result.message and f": {result.message}")
        good = result.outcome in ("completed", "stopped", "cancelled")
        self.get_logger().info(ended) if good else self.get_logger().error(ended)
        if result.trials and self._makes_report and not self._stopping:
            self._report(result.run_dir)
        self._last = Health(Level.OK if good else Level.WARN, ended)
        if result.outcome == "completed":
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        self._busy = False
        return result

    def _run(self, goal_handle: ServerGoalHandle, result: Practice.Result) -> RunSummary:
        if not goal_handle.request.run_dir:
            raise ConfigError("run_dir", "", "the folder of the run")
        folder, strategy = Path(goal_handle.request.run_dir), make_strategy(self._config)
        if not folder.is_absolute():
            raise ConfigError("run_dir", str(folder), "an absolute path (a node runs in another folder)")
        fastest = strategy.fastest_movements()
        require_within_velocity_limits(self._config, fastest, self._path, self._known_path)
        rows: Sequence[TrialRow] = ()
        network_after = 0
        if self._resumed is not None and folder.resolve() == self._resumed.resolve():
            # Imported late: learners take long to import, and only a resumed run asks them here.
            from tel_ros.recording.resumption import earlier_trials

            written, earlier = written_config(folder), earlier_trials(folder, self._config)
            session, rows, network_after = earlier.session, earlier.rows, earlier.network_after
            session.arm = session.network = self._ports
        else:
            written = open_run_folder(folder, self._config)
            session = PracticeSession(
                self._config, self._path, self._known_path, strategy, self._ports, self._ports
            )
        summary = RunSummary(folder, written)
        summary.rows = list(rows)

        def cancelled() -> bool:
            return self._stopping or goal_handle.is_cancel_requested

        self._ports.run = RunContext(folder, written, Progress(goal_handle), cancelled)
        # A stop ends the run in which it comes, even if it has been reset by the time that the trial is over.
        self._stop_seen = self._stop_latched
        try:
            patience_s = REPLAY_TIMEOUT_S if rows else 0.0
            self._ports.bring_up(max(ANSWER_TIMEOUT_S, patience_s))
            self._arm.wait(max(self._config.run.arm_timeout_s, patience_s))
            if rows:
                self._ports.load(network_after)
            else:
                self._ports.save(0)
            ending = self._trials(session, summary, result)
            summary.end(ending.outcome, ending.message)
        except TelError as error:
            if self._stop_seen:
                summary.end("aborted", f"{self._emergency_stop}; {error}")
            else:
                summary.end("cancelled" if cancelled() else "failed", str(error))
        return summary

    def _trials(self, session: PracticeSession[Path], summary: RunSummary, result: Practice.Result) -> Ending:
        """Run trial after trial until the strategy, a person or a cancellation ends it."""
        progress, cancelled = self._ports.run.progress, self._ports.run.cancelled
        while not cancelled():
            if self._pause.asked and not self._stop_seen:
                progress.paused()
                self._pause.wait(lambda: cancelled() or self._stop_seen)
                continue
            if self._stop_seen:
                # Whatever the strategy makes of a trial that was aborted: a person has said stop.
                return Ending("aborted", self._emergency_stop)
            plan = session.next()
            if isinstance(plan, Ending):
                return plan
            started = time.monotonic()
            self._doing = f"trial {plan.index} of the run in {result.run_dir}"
            progress.begin(plan, session.strategy.preview())
            done = session.run_trial(plan)
            for text in filter(None, (done.note, done.warning)):
                self.get_logger().warning(f"trial {plan.index}: {text}")
            row = TrialRow.of(done, done.trial.name, time.monotonic() - started)
            summary.add(row)
            message = to_result_message(done.report, self._config.arm.joints)
            result.trials.append(message)
            progress.trial_done(message, row)
        return Ending("cancelled", "the run was cancelled")

    def _report(self, folder: str) -> None:
        """Make the report in a process of its own: drawing takes libraries that no node should load."""
        command = [sys.executable, "-m", "tel_ros.app.cli", "report", folder]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=REPORT_TIMEOUT_S, check=True
            )
            self.get_logger().info(f"report: {done.stdout.strip()}")
        except subprocess.CalledProcessError as error:
            self.get_logger().warning(f"no report: {error.stderr.strip()}")
        except subprocess.TimeoutExpired:
            self.get_logger().warning(f"no report: not ready within {REPORT_TIMEOUT_S:g} s")

    def _health(self) -> Health:
        """Say what the run does, and notice when nobody waits for its result any more."""
        if not self._busy:
            return self._last
        now = time.monotonic()
        if self.count_clients(self._result_service):
            self._client_seen_at, self._client_gone = now, False
        if now - self._client_seen_at < CLIENT_GONE_S:
            return Health(Level.OK, self._doing)
        text = "whoever asked for the run is gone; it goes on until it is cancelled"
        if not self._client_gone:
            self._client_gone = True
            self.get_logger().warning(text)
        return Health(Level.WARN, f"{self._doing}; {text}")

    def _give_up_in_time(self) -> None:
        """When this node has to end, the others may have ended already: do not wait for long."""
        if time.monotonic() - self._stopping_since > STOPPING_TIMEOUT_S:
            raise NoAnswerError("the run was ended from outside")


main = partial(run_node, PracticeManagerNode, PatientExecutor)

if __name__ == "__main__":
    main()
