"""The inverse-dynamics network as a service: predict, train on bags, save, load."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from tel_interfaces.srv import LoadNetwork, PredictEquilibrium, SaveNetwork, TrainOnTrials

from tel_ros.core.errors import TelError, TrainingError, counted
from tel_ros.core.learning import tree_kernels  # noqa: F401 - before it is waited for
from tel_ros.core.learning.learner import Learner, TrainingOutcome
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.practice.session import predicted
from tel_ros.nodes.conversions import to_array, to_desired, to_trajectory_message
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.parameters import load_parameters
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics
from tel_ros.recording.network_file import PREDICTS_TORQUE, load_network, new_network, revision, save_network
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
        for kind, topic, serve in (
            (PredictEquilibrium, topics.PREDICT, self._predict),
            (TrainOnTrials, topics.TRAIN, self._train),
            (SaveNetwork, topics.SAVE, self._save),
            (LoadNetwork, topics.LOAD, self._load),
        ):
            self.create_service(kind, topics.private(topic), partial(self._answer, serve))

    def _answer(self, serve: Callable[[Any, Any], None], request: Any, response: Any) -> Any:
        try:
            serve(request, response)
            response.success = True
        except TelError as error:
            self._trouble = response.message = str(error)
            self.get_logger().error(self._trouble)
        return response

    def _predict(self, request: PredictEquilibrium.Request, response: PredictEquilibrium.Response) -> None:
        desired = to_desired(request.desired, self._joints)
        prediction = predicted(self._network, desired, self._config.control.rate_hz)
        response.equilibrium = to_trajectory_message(
            self._joints, desired.time_ns, positions=prediction.equilibrium_rad
        )
        response.std_rad = to_array(prediction.std_rad)
        response.revision, self._trouble = self._revision, ""

    def _train(self, request: TrainOnTrials.Request, response: TrainOnTrials.Response) -> None:
        # Told before the time that this takes: nothing else gets a turn meanwhile.
        self._doing = f"learns from {counted(len(request.bags), 'bag')}"
        self._diagnostics.publish()
        try:
            network, outcomes = self._trained(request, response)
        finally:
            self._doing = ""
        self._take_up(network)
        for name in ("training_rms_before_rad", "training_rms_after_rad", "rms_command_change_rad"):
            each = [getattr(outcome, name) for outcome in outcomes]
            setattr(response, name, float(np.sqrt(np.mean(np.square(each)))))
        response.grown = [text for outcome in outcomes for text in outcome.grown]
        response.subtrees = list(network.subtrees)
        response.revision = self._revision
        self._learned = (
            f"{counted(response.samples, 'sample')}: error {response.training_rms_before_rad:.4f} → "
            f"{response.training_rms_after_rad:.4f} rad"
        )
        self.get_logger().info(f"learned from {self._learned}")

    def _trained(
        self, request: TrainOnTrials.Request, response: TrainOnTrials.Response
    ) -> tuple[Learner, list[TrainingOutcome]]:
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
            self._require_own_joints(bag, trial.joints)
            samples = configured_samples(learning_record(trial), self._config.learning)
            network, outcome = network.trained_on(samples, mode)
            outcomes.append(outcome)
            response.samples += len(samples.offset_rad)
        return network, outcomes

    def _save(self, request: SaveNetwork.Request, response: SaveNetwork.Response) -> None:
        save_network(self._network, Path(request.path))
        response.revision = self._revision

    def _load(self, request: LoadNetwork.Request, response: LoadNetwork.Response) -> None:
        network = load_network(Path(request.path))
        self._require_own_joints(request.path, network.context.joints)
        if network.context.predicts == "torque":
            raise TrainingError(f"{request.path}: expected {PREDICTS_TORQUE}")
        self._take_up(network)
        response.revision = self._revision

    def _take_up(self, network: Learner) -> None:
        self._network, self._revision, self._trouble = network, revision(network), ""

    def _require_own_joints(self, source: str, joints: Sequence[str]) -> None:
        if joints != self._joints:
            expected = ", ".join(self._joints)
            raise TrainingError(f"{source} is for the joints {', '.join(joints)}; expected {expected}")

    def _health(self) -> Health:
        values = {"revision": self._revision, "last_training": self._learned}
        if self._trouble:
            return Health(Level.WARN, f"refused: {self._trouble}", values)
        return Health(Level.OK, self._doing or "ready", values)


main = partial(run_node, InverseDynamicsNode)

if __name__ == "__main__":
    main()
