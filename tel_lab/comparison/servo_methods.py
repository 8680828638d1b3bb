"""Methods that have a command for any movement: servos, and feedback-error learning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.learner import Learner
from tel_ros.core.learning.signals import TrialSignals, configured_samples
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


class Method(Protocol):
    """A way to find the commands of a movement. It changes with each trial that it learns from."""

    learns: bool
    """Whether trials change it; what does not learn does the same again in every trial."""
    transfers: bool
    """Whether it has a command for a movement that it never executed."""

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        """Return û [rad] for a movement, shape (n, n_joints); TrajectoryError if it has none for it."""
        ...

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Take in a trial; the record of an aborted one ends with the abort.

        Raises:
            TrainingError: it cannot be learned from; the method stays as it was.
        """
        ...


class Feedforward:
    """û = y + N(y) with an N that never changes.

    N turns inputs (q, q̇, q̈) of shape (n, 3 * n_joints) into offsets u - q [rad] of shape (n, n_joints).
    """

    learns, transfers = False, True

    def __init__(self, predict: Callable[[FloatArray], FloatArray], control_period_s: float) -> None:
        self._predict, self._period_s = predict, control_period_s

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        offset: FloatArray = self._predict(query_inputs(desired, self._period_s))
        return desired.position_rad + offset

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Do nothing."""


def servo(control_period_s: float) -> Feedforward:
    """Return what every arm can do: the equilibrium point is the desired position."""
    return Feedforward(lambda inputs: np.zeros((len(inputs), inputs.shape[1] // 3)), control_period_s)


def with_velocity_reference(desired: DesiredTrajectory, damping_s: FloatArray) -> FloatArray:
    """Return û [rad] of the servo τ = K (y - q) + B (ẏ - q̇), the usual form: û = y + K⁻¹ B ẏ.

    Whoever chose K and B knows it without any model of the arm. ``damping_s``: K⁻¹ B. Shape (n_joints,).
    """
    return desired.position_rad + damping_s * desired.velocity_rad_s


class FeedbackErrorLearning:
    """τ = K (y - ŷ) + B (ẏ - ŷ̇) + K N(y), and N(y) ← N(y) + η K⁻¹ [K (y - ŷ) + B (ẏ - ŷ̇)].

    Kawato (1990): the effort of the feedback controller is the error signal of the inverse model, at the
    desired inputs. Here it is applied trial by trial. As an equilibrium point this is
    û = y + K⁻¹ B ẏ + N(y): the reference of the velocity belongs to the feedback controller of the textbook,
    so N does not have to learn the damping that the controller itself adds.

    Of the gains η = 0.05, 0.1, 0.2 and 0.5 the default left the least error after 15 trials (geometric mean
    over the arm of ``config/paper.yaml`` and two with 0.8 and 1.25 times its inertia).
    """

    learns = transfers = True

    def __init__(self, learner: Learner, control_period_s: float, gain: float = 0.1) -> None:
        self._learner, self._period_s, self._gain = learner, control_period_s, gain
        context = learner.context
        self._damping_s = np.array(context.damping_nms_per_rad) / np.array(context.stiffness_nm_per_rad)

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        learned = self._learner.predict(query_inputs(desired, self._period_s))
        return with_velocity_reference(desired, self._damping_s) + learned

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Train N with the feedback effort, of an aborted trial as far as it went."""
        learning = self._learner.context.learning
        samples = configured_samples(trial, learning)
        n_joints = len(self._learner.context.joints)
        error = samples.desired - samples.actual
        feedback_rad = error[:, :n_joints] + self._damping_s * error[:, n_joints : 2 * n_joints]
        # Desired training applies offset - N(ŷ) at y; so it applies the feedback itself.
        offset_rad = self._learner.predict(samples.actual) + self._gain * feedback_rad
        self._learner, _ = self._learner.trained_on(replace(samples, offset_rad=offset_rad), "desired")
