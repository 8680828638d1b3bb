"""Arm, network and progress of a service in the ROS graph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import TrialGoal, TrialResult

from tel_ros.core.errors import NetworkFileError, TrainingError
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.session import CommandedTrial
from tel_ros.core.trial import TrialReport
from tel_ros.nodes.hot_loop import busy_subscription, take
from tel_ros.nodes.practice_ports import PracticePorts
from tel_ros.nodes.run_progress import Progress
from tel_ros.nodes.waiting import DeclinedError, NoAnswerError
from tel_ros.recording.run_folder import network_after
from tel_ros.recording.trial_result import report_of


class ServicePorts(PracticePorts):
    """Arm and network of a :class:`~tel_ros.core.serving.session.ServingSession`.

    A recording that fails at its end costs what could be learned, not the result of the movement.
    """

    training_timeout_s = 30.0
    """Somebody waits for the result: a network that has died does not answer."""
    _result: TrialResult | None = None
    _unrecorded = ""

    def execute(self, commanded: CommandedTrial) -> tuple[TrialReport, Path]:
        """Record and execute; NoAnswerError: nothing has moved, or nobody knows how it ended."""
        self._result, self._unrecorded = None, ""
        try:
            return super().execute(commanded)
        except NoAnswerError as error:
            result = self._result
            if result is None or result.outcome == TrialResult.REFUSED:
                raise
            self._unrecorded = str(error)
            return report_of(result), Path()

    def train(self, bag: Path) -> TrainingOutcome:
        """Learn from a recording; TrainingError: there is none, or too little in it."""
        if self._unrecorded:
            raise TrainingError(self._unrecorded)
        return super().train(bag)

    def load(self, index: int) -> None:
        """Go back to the network after an execution; NetworkFileError: it cannot be read."""
        try:
            super().load(index)
        except DeclinedError as error:
            file = network_after(self.run.folder, index)
            raise NetworkFileError(file, f"cannot be loaded ({error})", "a network of this arm") from None

    def _moved(self, goal: TrialGoal) -> TrialResult:
        self._result = super()._moved(goal)
        return self._result


class Silent(Progress):
    """The progress of a trial that nobody follows by stages."""

    def __init__(self) -> None:
        """Follow nothing."""

    def stage(self, stage: str) -> None:
        """Tell nobody."""

    def moving(self, trial: ExecuteTrial.Feedback) -> None:
        """Tell nobody: the states tell more."""


class Newest:
    """The newest message of a topic, taken when it is asked for: nothing is done for the others."""

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        self._kind, self._raw = kind, b""
        self._subscription = busy_subscription(node, kind, topic, self._hear)

    def take(self) -> Any | None:
        """Return a message that has come since the last time; None: none has."""
        self._raw = b""
        take(self._subscription)
        return deserialize_message(self._raw, self._kind) if self._raw else None

    def _hear(self, raw: bytes) -> None:
        self._raw = raw
