"""A learner as the network of a practice session."""

from __future__ import annotations

from tel_ros.core.config import Config
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.learner import Learner, TrainingOutcome, std_along
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.practice.session import Prediction
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Trial


def predicted(learner: Learner, desired: DesiredTrajectory, rate_hz: float) -> Prediction:
    """Return what a learner predicts for a trajectory that is commanded ``rate_hz`` times a second."""
    inputs = query_inputs(desired, 1.0 / rate_hz)
    return Prediction(desired.position_rad + learner.predict(inputs), std_along(learner, inputs))


def trained(learner: Learner, trial: Trial, config: Config) -> tuple[Learner, TrainingOutcome]:
    """Let a learner learn from a trial as configured; the one that is given stays as it is.

    Raises:
        TrainingError: too little is left to learn from.
    """
    samples = configured_samples(learning_record(trial), config.learning)
    return learner.trained_on(samples, config.learning.training)


class LearnerNetwork:
    """A learner in this process, and its earlier states.

    Args:
        config: control rate and how to learn.
        learner: to begin with.
    """

    def __init__(self, config: Config, learner: Learner) -> None:
        self._config = config
        self.learner = learner
        """As it is now; may be replaced between two trials."""
        self.after = {0: learner}
        """By trial; 0: as the run began."""

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        """Return the command for a trajectory."""
        return predicted(self.learner, desired, self._config.control.rate_hz)

    def train(self, trial: Trial) -> TrainingOutcome:
        """Learn from a trial."""
        self.learner, training = trained(self.learner, trial, self._config)
        return training

    def save(self, index: int) -> None:
        """Keep the learner as it is after a trial."""
        self.after[index] = self.learner

    def load(self, index: int) -> None:
        """Go back to the learner as it was after a trial."""
        self.learner = self.after[index]
