"""Feedback-error learning: an inverse model that learns from what the servo had to add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tel_lab.comparison.feedforward import with_velocity_reference
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.learner import Learner
from tel_ros.core.learning.signals import TrialSignals, configured_samples
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray


class FeedbackErrorLearning:
    """τ = K (y - ŷ) + B (ẏ - ŷ̇) + K N(y), and N(y) ← N(y) + η K⁻¹ [K (y - ŷ) + B (ẏ - ŷ̇)].

    Kawato (1990): the effort of the feedback controller is the error signal of the inverse model, at the
    desired inputs. Here it is applied trial by trial. As an equilibrium point this is
    û = y + K⁻¹ B ẏ + N(y): the reference of the velocity belongs to the feedback controller of the textbook,
    so N does not have to learn the damping that the controller itself adds.

    Args:
        learner: N as it is at the beginning.
        control_period_s: how long one command acts.
        gain: η; of 0.05, 0.1, 0.2 and 0.5 the default left the least error after 15 trials (geometric mean
            over the arm of ``config/paper.yaml`` and two with 0.8 and 1.25 times its inertia).
    """

    learns = transfers = True

    def __init__(self, learner: Learner, control_period_s: float, gain: float = 0.1) -> None:
        self._learner, self._period_s, self._gain = learner, control_period_s, gain
        context = learner.context
        self._damping_s = np.array(context.damping_nms_per_rad) / np.array(context.stiffness_nm_per_rad)

    def command(self, desired: DesiredTrajectory) -> FloatArray:
        """Return û [rad]. Shape (n, n_joints)."""
        learned = self._learner.predict(query_inputs(desired, self._period_s))
        return with_velocity_reference(desired, self._damping_s) + learned

    def learn(self, trial: TrialSignals, completed: bool) -> None:
        """Train N with the feedback effort, of an aborted trial as far as it went.

        Raises:
            TrainingError: the record is too short, or what was learned is not finite.
        """
        learning = self._learner.context.learning
        samples = configured_samples(trial, learning)
        n_joints = len(self._learner.context.joints)
        error = samples.desired - samples.actual
        feedback_rad = error[:, :n_joints] + self._damping_s * error[:, n_joints : 2 * n_joints]
        # Desired training applies offset - N(ŷ) at y; so it applies the feedback itself.
        offset_rad = self._learner.predict(samples.actual) + self._gain * feedback_rad
        self._learner, _ = self._learner.trained_on(replace(samples, offset_rad=offset_rad), "desired")
