"""The inverse-dynamics network as a service: predict, train on bags, save, load."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from tel_interfaces.srv import LoadNetwork, PredictEquilibrium, SaveNetwork, TrainOnTrials

from tel_ros.core.errors import TelError, TrainingError
from tel_ros.core.learning.learner import Learner, TrainingOutcome
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.practice.session import predicted
from tel_ros.nodes.conversions import to_array, to_desired, to_trajectory_message
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.parameters import load_parameters
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics
from tel_ros.recording.network_file import load_network, revision, save_network
from tel_ros.recording.new_network import PREDICTS_TORQUE, new_network
from tel_ros.recording.retraining import require_same_arm
from tel_ros.recording.trial_bag import read_metadata, read_trial


class InverseDynamicsNode(Node):
    """Holds the network. Whatever goes wrong, the network stays as it was."""

    def __init__(self) -> None:
        super().__init__("inverse_dynamics")
        self._config = load_parameters(self, "arm", "path", "practice", "control", "learning", "seed")
        self._network = new_network(self._config)
        self._joints = self._config.arm.joints
        self._doing, self._trouble, self._learned = "", "", "nothing yet"
        self._revision = revision(self._network)
        self._diagnostics = Diagnostics(self, "network", self._config.arm.name, self._health)
        self.create_service(PredictEquilibrium, topics.private(topics.PREDICT), self._predict)
        self.create_service(TrainOnTrials, topics.private(topics.TRAIN), self._train)
        self.create_service(SaveNetwork, topics.private(topics.SAVE), self._save)
        self.create_service(LoadNetwork, topics.private(topics.LOAD), self._load)

    def _predict(
        self, request: PredictEquilibrium.Request, response: PredictEquilibrium.Response
    ) -> PredictEquilibrium.Response:
        try:
            desired = to_desired(request.desired, self._joints)
        except TelError as error:
            return self._refuse(response, error)
        prediction = predicted(self._network, desired, self._config.control.rate_hz)
        response.equilibrium = to_trajectory_message(
            self._joints, desired.time_ns, positions=prediction.equilibrium_rad
        )
        response.std_rad = to_array(prediction.std_rad)
        response.revision = self._revision
        response.success, self._trouble = True, ""
        return response

    def _train(
        self, request: TrainOnTrials.Request, response: TrainOnTrials.Response
    ) -> TrainOnTrials.Response:
        self._say(f"learns from {len(request.bags)} bags")
        try:
            mode = request.training or self._config.learning.training
            if mode not in ("actual", "desired"):
                raise TrainingError(f"training is {mode!r}; expected 'actual' or 'desired'")
            if not request.bags:
                raise TrainingError("bags is empty; expected at least one bag to learn from")
            bags = [(Path(bag), read_metadata(Path(bag))) for bag in request.bags]
            require_same_arm(bags, self._config.arm)
            network, outcomes = self._network, []
            for bag in request.bags:
                trial = read_trial(Path(bag))
                if trial.joints != self._joints:
                    raise _other_joints(bag, trial.joints, self._joints)
                samples = configured_samples(learning_record(trial), self._config.learning)
                network, outcome = network.trained_on(samples, mode)
                outcomes.append(outcome)
                response.samples += len(samples.offset_rad)
        except TelError as error:
            return self._refuse(response, error)
        finally:
            self._doing = ""
        self._take_up(network)
        _fill(response, outcomes)
        response.subtrees = list(network.subtrees)
        response.revision = self._revision
        response.success = True
        self._learned = (
            f"{response.samples} samples: error {response.training_rms_before_rad:.4f} → "
            f"{response.training_rms_after_rad:.4f} rad"
        )
        self.get_logger().info(f"learned from {self._learned}")
        return response

    def _save(self, request: SaveNetwork.Request, response: SaveNetwork.Response) -> SaveNetwork.Response:
        try:
            save_network(self._network, Path(request.path))
        except TelError as error:
            return self._refuse(response, error)
        response.revision, response.success = revision(self._network), True
        return response

    def _load(self, request: LoadNetwork.Request, response: LoadNetwork.Response) -> LoadNetwork.Response:
        try:
            network = load_network(Path(request.path))
            if network.context.joints != self._joints:
                raise _other_joints(request.path, network.context.joints, self._joints)
            if network.context.predicts == "torque":
                raise TrainingError(f"{request.path}: expected {PREDICTS_TORQUE}")
        except TelError as error:
            return self._refuse(response, error)
        self._take_up(network)
        response.revision, response.success = self._revision, True
        return response

    def _take_up(self, network: Learner) -> None:
        self._network, self._revision, self._trouble = network, revision(network), ""

    def _say(self, doing: str) -> None:
        """Tell the world before the time that this takes: nothing else gets a turn meanwhile."""
        self._doing = doing
        self._diagnostics.publish()

    def _health(self) -> Health:
        values = {"revision": self._revision, "last_training": self._learned}
        if self._trouble:
            return Health(Level.WARN, f"refused: {self._trouble}", values)
        return Health(Level.OK, self._doing or "ready", values)

    def _refuse(self, response: Any, error: TelError) -> Any:  # any of the four responses
        self.get_logger().error(str(error))
        self._trouble = str(error)
        response.success, response.message = False, str(error)
        return response


def _other_joints(source: str, found: Sequence[str], expected: Sequence[str]) -> TrainingError:
    return TrainingError(f"{source} is for the joints {', '.join(found)}; expected {', '.join(expected)}")


def _fill(response: TrainOnTrials.Response, outcomes: Sequence[TrainingOutcome]) -> None:
    def rms(values: Sequence[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    response.training_rms_before_rad = rms([outcome.rms_before_rad for outcome in outcomes])
    response.training_rms_after_rad = rms([outcome.rms_after_rad for outcome in outcomes])
    response.rms_command_change_rad = rms([outcome.rms_command_change_rad for outcome in outcomes])
    response.grown = [text for outcome in outcomes for text in outcome.grown]


def main() -> None:
    """Run the node."""
    run_node(InverseDynamicsNode)


if __name__ == "__main__":
    main()
