"""The process of the live view: nothing in the graph waits for it."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import sys
import time
from pathlib import Path

import numpy as np
from rclpy.node import Node
from tel_interfaces.action import Practice
from tel_interfaces.msg import TrialGoal

from tel_ros.app.errors import Interruption
from tel_ros.app.plane import viewpoint
from tel_ros.app.view.graph import GraphView
from tel_ros.app.view.live_trial import History, LiveTrial
from tel_ros.app.view.page import Page
from tel_ros.app.view.server import OwnersServer
from tel_ros.core.config import Config
from tel_ros.core.errors import TelError
from tel_ros.nodes.conversions import to_goal
from tel_ros.nodes.hot_loop import serve_ready
from tel_ros.nodes.runner import client
from tel_ros.recording.config_file import load_config
from tel_ros.recording.urdf import described
from tel_ros.recording.waypoint_file import load_path

ARM_RATE_HZ = 20.0
"""How often the arm is looked at and drawn."""
LOCKSTEP_RATE_HZ = 100.0
"""How often the controller is looked at in lockstep, where a movement takes a second or two.

In real time once a picture is enough, and five times as many looks would cost the control loop time.
"""
END_TIMEOUT_S = 10.0
_WORDS_EVERY = 4
"""Words and plots change with every fourth picture only."""


class LiveView:
    """Keeps the page up to date with what is heard; ``token`` is the link's secret."""

    def __init__(self, config: Config, node: Node, token: str, port: int) -> None:
        self._config, self._node = config, node
        self._chain = described(config.arm).chain(config.arm.hand_link)
        path, points = load_path(config.path, config.arm), np.linspace(0.0, 1.0, 50)
        paths_rad = [each.evaluate(points)[0] for each in path.library or (path,)]
        path_m = self._chain.hand_positions(np.vstack(paths_rad))
        self._graph = GraphView(node, config, self._begin_trial, self._on_feedback)
        self._trial: LiveTrial | None = None
        self._history = History()
        self._feedback = Practice.Feedback(max_error_rad=float("nan"))
        self._server = OwnersServer(token, port, f"tel view: {config.arm.name}")
        self.link, self.close = self._server.link, self._server.stop
        seen = viewpoint(np.vstack([path_m, np.zeros((1, 3))]))
        try:
            self._page = Page(self._server.viser, config.arm, seen, self._graph)
            self._page.show_history(self._history)
        except BaseException:
            self.close()
            raise
        self._looks = 0

    def follow(self) -> None:
        """Look where the trial is, and keep it."""
        self._graph.look_at_controller()
        if self._graph.sample is not None and self._trial is not None:
            self._trial.see(self._graph.sample)

    def show(self) -> None:
        """Look at the arm, and show what has changed."""
        graph, page = self._graph, self._page
        graph.look_at_arm()
        self._looks += 1
        with self._server.viser.atomic():
            if graph.arm is not None:
                page.show_arm(graph.arm.position_rad)
            if graph.sample is not None:
                page.show_ghost(np.array(graph.sample.desired_position_rad))
            if self._looks % _WORDS_EVERY == 0:
                page.show_status(graph, self._feedback)
                page.show_history(self._history)
                if self._trial is not None:
                    page.show_progress(self._trial)

    def _begin_trial(self, message: TrialGoal) -> None:
        arm = self._config.arm
        try:
            goal = to_goal(message, arm.joints)
        except TelError as error:
            self._node.get_logger().warning(f"a goal that is not for this arm is not shown: {error}")
            return
        std_rad = np.array(message.std_rad)
        if len(std_rad) == goal.equilibrium_rad.size:
            columns = [list(message.joint_names).index(joint) for joint in arm.joints]
            std_rad = std_rad.reshape(goal.equilibrium_rad.shape)[:, columns]
        self._trial = LiveTrial(goal, std_rad, self._chain, arm.effort_limit_nm)
        self._page.show_plan(self._trial)

    def _on_feedback(self, feedback: Practice.Feedback) -> None:
        self._feedback = feedback
        for result in feedback.last:
            self._history.end(result, result.message or feedback.reason, self._trial)


def watch(config: Config, namespace: str = "/", port: int = 0) -> None:
    """Show a graph until SIGINT, SIGTERM or SIGHUP; print the link. Port 0: any that is free."""
    stopping: list[int] = []

    def on_signal(number: int, frame: object) -> None:
        if number == signal.SIGHUP:
            Interruption.leave_terminal()
        stopping.append(number)
        # Fast DDS sometimes blocks at its end for ever: then the kernel ends the process.
        signal.setitimer(signal.ITIMER_REAL, END_TIMEOUT_S)

    Interruption.handle(on_signal)
    os.nice(10)  # the processor is for the nodes that move the arm
    out = sys.stdout
    # viser talks
    with contextlib.redirect_stdout(sys.stderr), client("tel_view", namespace) as (node, executor):
        view = LiveView(config, node, secrets.token_urlsafe(), port)
        try:
            print(f"view    {view.link}", file=out, flush=True)
            look_s = 1.0 / (LOCKSTEP_RATE_HZ if config.arm_waits_for_commands else ARM_RATE_HZ)
            next_look = next_picture = time.monotonic()
            while not (stopping or Interruption.asked):
                # Counted from now: a view that is late does not hurry.
                now = time.monotonic()
                if now >= next_look:
                    view.follow()
                    next_look = now + look_s
                if now >= next_picture:
                    serve_ready(executor)  # a turn of it costs as much as ten looks
                    view.show()
                    next_picture = now + 1.0 / ARM_RATE_HZ
                time.sleep(max(0.0, min(next_look, next_picture) - time.monotonic()))
        finally:
            view.close()


if __name__ == "__main__":  # as a process beside `tel practice`: configuration and namespace
    try:
        watch(load_config(Path(sys.argv[1])), sys.argv[2])
    except TelError as problem:
        print(f"view    no live view: {problem}")
        sys.exit(2)
