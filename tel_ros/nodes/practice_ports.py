"""The ports of a practice session in the ROS graph: an arm behind an action, a network behind services."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from std_msgs.msg import Bool
from tel_interfaces.action import ExecuteTrial
from tel_interfaces.msg import TrialGoal, TrialResult
from tel_interfaces.srv import (
    LoadNetwork,
    PredictEquilibrium,
    SaveNetwork,
    StartRecording,
    StopRecording,
    TrainOnTrials,
)

from tel_ros.core.config import Config
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.session import CommandedTrial, Prediction
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import TrialReport
from tel_ros.nodes import qos
from tel_ros.nodes.command_channel import CompetingPublishers
from tel_ros.nodes.conversions import desired_message, equilibrium_of, to_array, to_goal_message
from tel_ros.nodes.run_progress import Progress
from tel_ros.nodes.waiting import (
    DeclinedError,
    LockedActionClient,
    NoAnswerError,
    ask,
    meet,
    namespace_hint,
    wait,
)
from tel_ros.recording import topics
from tel_ros.recording.run_folder import network_after, publish_network, trial_bag
from tel_ros.recording.trial_bag import trial_metadata
from tel_ros.recording.trial_result import report_of

ANSWER_TIMEOUT_S = 30.0
SILENCE_TIMEOUT_S = 10.0
TRAINING_TIMEOUT_S = 600.0


@dataclass(frozen=True)
class RunContext:
    """What the ports need to know of the run under way."""

    folder: Path
    written: Config
    """The configuration as written in the folder."""
    progress: Progress
    cancelled: Callable[[], bool]


class ReadyArm:
    """Whether the controller says that it sees the arm at rest, and that the arm hears it."""

    def __init__(self, node: Node, group: CallbackGroup, config: Config) -> None:
        self._node, self._config, self._ready = node, config, threading.Event()
        node.create_subscription(Bool, topics.READY, self._hear, qos.LATCHED, callback_group=group)

    def wait(self, timeout_s: float | None = None) -> None:
        """Return when the arm is ready; NoAnswerError: it is not in time (``run.arm_timeout_s``), and why."""
        node, timeout_s = self._node, self._config.run.arm_timeout_s if timeout_s is None else timeout_s
        if self._ready.wait(timeout_s):
            return
        commands = topics.commands(self._config.arm)
        competing = CompetingPublishers(
            node, commands, topics.absolute(topics.EP_CONTROLLER, node.get_namespace())
        )
        competing.look()
        if why := competing.of_states or competing.of_commands:
            raise NoAnswerError(f"no trial begins: {why}")
        missing = [topics.JOINT_STATES] if node.count_publishers(topics.JOINT_STATES) == 0 else []
        missing += [commands] if node.count_subscribers(commands) == 0 else []
        raise NoAnswerError(
            f"the arm is not there: within {timeout_s:.1f} s ep_controller has not seen "
            f"{node.resolve_topic_name(topics.JOINT_STATES)} and a subscriber of "
            f"{node.resolve_topic_name(commands)}, and the arm at rest.{namespace_hint(node, *missing)}"
        )

    def _hear(self, message: Bool) -> None:
        if message.data:
            self._ready.set()
        else:
            self._ready.clear()


class PracticePorts:
    """Arm and network of a practice session, as its other nodes offer them.

    Args:
        node: of the practice run.
        group: of callbacks that are served while a run waits.
        config: of the run, with files that can be read.
        wait_for_arm: returns when the arm is ready; raises if it is not in time.
        poll: called while an answer is awaited; may raise to end the waiting.
    """

    run: RunContext
    """Has to be set before a run begins."""
    training_timeout_s = TRAINING_TIMEOUT_S

    def __init__(
        self,
        node: Node,
        group: CallbackGroup,
        config: Config,
        wait_for_arm: Callable[[], None],
        poll: Callable[[], None],
    ) -> None:
        self._config, self._wait_for_arm, self._poll = config, wait_for_arm, poll

        def client(kind: type, name: str) -> Client:
            return node.create_client(kind, name, callback_group=group)

        self._predict = client(PredictEquilibrium, topics.PREDICT)
        self._train = client(TrainOnTrials, topics.TRAIN)
        self._save = client(SaveNetwork, topics.SAVE)
        self._load = client(LoadNetwork, topics.LOAD)
        self._start_recording = client(StartRecording, topics.START_RECORDING)
        self._stop_recording = client(StopRecording, topics.STOP_RECORDING)
        self._controller_state = client(GetState, f"{topics.EP_CONTROLLER}/get_state")
        self._change_state = client(ChangeState, f"{topics.EP_CONTROLLER}/change_state")
        self._execute = LockedActionClient(node, ExecuteTrial, topics.EXECUTE_TRIAL, callback_group=group)
        # For whoever watches; the controller gets it in its action, the recorder with its request.
        self._goal_pub = node.create_publisher(TrialGoal, topics.TRIAL_GOAL, qos.LATCHED)
        others = (topics.EP_CONTROLLER, "inverse_dynamics", "trial_recorder")
        self._others = [client(GetParameters, f"{name}/get_parameters") for name in others]

    def bring_up(self, timeout_s: float) -> None:
        """Meet the other nodes; configure and activate the controller, as far as it is not.

        Raises:
            NoAnswerError: an answer does not come in time, or is no.
        """
        name = topics.EP_CONTROLLER
        steps = {
            State.PRIMARY_STATE_UNCONFIGURED: (Transition.TRANSITION_CONFIGURE, "configured"),
            State.PRIMARY_STATE_INACTIVE: (Transition.TRANSITION_ACTIVATE, "activated"),
        }
        meet(self._others, timeout_s, self._poll)
        while True:
            state = ask(self._controller_state, GetState.Request(), timeout_s, self._poll).current_state
            if state.id == State.PRIMARY_STATE_ACTIVE:
                return
            if state.id not in steps:
                raise DeclinedError(f"{name} is {state.label}; expected a node that can be activated")
            transition, done = steps[state.id]
            request = ChangeState.Request(transition=Transition(id=transition))
            if not ask(self._change_state, request, timeout_s, self._poll).success:
                raise DeclinedError(f"{name} could not be {done}; its log says why")

    def execute(self, commanded: CommandedTrial) -> tuple[TrialReport, Path]:
        """Record and execute a trial; return its report and its bag.

        Raises:
            NoAnswerError: a node is not there, does not answer or fails; or the trial was refused.
        """
        plan, run = commanded.plan, self.run
        bag, arm = trial_bag(run.folder, plan.index), self._config.arm
        # Springs are told even if they are the configured ones: a bag then tells what its efforts came from.
        goal = replace(commanded.goal, springs=commanded.goal.springs or Springs.of(arm))
        message = to_goal_message(goal, arm.joints, to_array(commanded.std_rad))
        metadata = trial_metadata(plan, self._config, run.written, commanded.revision)
        self._wait_for_arm()  # it may have stood still since the last trial
        run.progress.stage("recording")
        request = StartRecording.Request(
            bag=str(bag), goal=message, metadata_keys=list(metadata), metadata_values=list(metadata.values())
        )
        self._call(self._start_recording, request, ANSWER_TIMEOUT_S)
        self._goal_pub.publish(message)
        self._wait_for_arm()  # a disturbed brake may have moved it meanwhile
        run.progress.stage("moving")
        result = self._moved(message)
        self._call(self._stop_recording, StopRecording.Request(result=result), ANSWER_TIMEOUT_S)
        if result.outcome == TrialResult.REFUSED:
            raise NoAnswerError(f"trial {plan.index} was refused: {result.message}")
        return report_of(result), bag

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        """Return the command for a trajectory."""
        joints = self._config.arm.joints
        request = PredictEquilibrium.Request(desired=desired_message(joints, desired))
        answer = self._call(self._predict, request, ANSWER_TIMEOUT_S)
        equilibrium_rad = equilibrium_of(answer.equilibrium, joints)
        std_rad = np.array(answer.std_rad).reshape(equilibrium_rad.shape)
        return Prediction(equilibrium_rad, std_rad, answer.revision)

    def train(self, bag: Path) -> TrainingOutcome:
        """Learn from the bag of a trial."""
        self.run.progress.stage("training")
        try:
            answer = self._call(self._train, TrainOnTrials.Request(bags=[str(bag)]), self.training_timeout_s)
        except DeclinedError as error:
            raise TrainingError(str(error)) from None
        return TrainingOutcome(
            answer.training_rms_before_rad,
            answer.training_rms_after_rad,
            answer.rms_command_change_rad,
            tuple(answer.grown),
        )

    def save(self, index: int) -> None:
        """Write the network as it is after a trial; after the first it is ``network/network.npz`` as well."""
        file = network_after(self.run.folder, index)
        self._call(self._save, SaveNetwork.Request(path=str(file)), ANSWER_TIMEOUT_S)
        if index > 0:
            publish_network(self.run.folder, index)

    def load(self, index: int) -> None:
        """Go back to the network as it was after a trial."""
        file = network_after(self.run.folder, index)
        self._call(self._load, LoadNetwork.Request(path=str(file)), ANSWER_TIMEOUT_S)

    def _moved(self, goal: TrialGoal) -> TrialResult:
        name, heard_at, cancelling = topics.EXECUTE_TRIAL, time.monotonic(), False

        def on_feedback(message: Any) -> None:  # of a type that rclpy makes
            nonlocal heard_at
            heard_at = time.monotonic()
            self.run.progress.moving(message.feedback)

        def watch() -> None:
            nonlocal cancelling
            if time.monotonic() - heard_at > SILENCE_TIMEOUT_S:
                raise NoAnswerError(f"{name} was silent for {SILENCE_TIMEOUT_S:.0f} s")
            self._poll()
            if self.run.cancelled() and not cancelling:
                cancelling = True
                handle.cancel_goal_async()

        if not self._execute.wait_for_server(timeout_sec=ANSWER_TIMEOUT_S):
            raise NoAnswerError(f"there is no action {name} (waited {ANSWER_TIMEOUT_S:.1f} s)")
        sent = self._execute.send_goal_async(ExecuteTrial.Goal(goal=goal), on_feedback)
        handle = wait(sent, ANSWER_TIMEOUT_S, name)
        if not handle.accepted:
            raise NoAnswerError(f"{name} rejected the goal")
        return wait(handle.get_result_async(), math.inf, name, watch).result.result

    def _call(self, client: Client, request: Any, timeout_s: float) -> Any:
        response = ask(client, request, timeout_s, self._poll)
        if not response.success:
            raise DeclinedError(f"{client.service_name}: {response.message}")
        return response
