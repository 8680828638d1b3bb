"""An inverse model that learns from the effort of the feedback controller."""

from __future__ import annotations

import numpy as np
import pytest
from servo_joint import DAMPING, INERTIA, PERIOD_S, STIFFNESS, execute, rms_error, swing

from tel_lab.comparison.servo_methods import FeedbackErrorLearning, Feedforward, servo
from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.signals import TrainingSamples


def context() -> LearnerContext:
    return LearnerContext(
        joints=("joint",),
        stiffness_nm_per_rad=(STIFFNESS,),
        damping_nms_per_rad=(DAMPING,),
        input_range=InputRange.covering(swing(), 1.3),
        learning=LearningConfig(filter="fixed", filter_cutoff_hz=15.0, passes=4),
        seed=1,
    )


def untrained(gain: float) -> FeedbackErrorLearning:
    return FeedbackErrorLearning(LmsLearner(context()), PERIOD_S, gain)


def test_untrained_it_is_a_servo_with_a_reference_of_the_velocity() -> None:
    desired = swing()
    expected = desired.position_rad + DAMPING / STIFFNESS * desired.velocity_rad_s
    np.testing.assert_allclose(untrained(0.5).command(desired), expected, atol=1e-15)


class Remembers:
    """Says 0.1 rad per rad of each joint, and remembers what it was to learn."""

    trials_learned = 0

    def __init__(self) -> None:
        self.context = context()
        self.lessons: list[tuple[TrainingSamples, str]] = []

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        return 0.1 * inputs[:, :1]

    def trained_on(self, samples: TrainingSamples, mode: str) -> tuple[Remembers, None]:
        self.lessons.append((samples, mode))
        return self, None


def test_what_the_model_learns_at_the_desired_inputs_is_a_share_of_the_feedback() -> None:
    """N(y) ← N(y) + η (e + K⁻¹ B ė): desired training adds offset - N(ŷ) to N(y)."""
    desired, learner, gain = swing(), Remembers(), 0.2
    method = FeedbackErrorLearning(learner, PERIOD_S, gain)  # type: ignore[arg-type]
    trial = execute(desired, method.command(desired))
    method.learn(trial, completed=True)
    ((samples, mode),) = learner.lessons
    error = (trial.desired[:, :1] - trial.position_rad)[trial.run]
    feedback = error + DAMPING / STIFFNESS * np.gradient(error, PERIOD_S, axis=0)
    added = samples.offset_rad - learner.predict(samples.actual)
    assert mode == "desired"
    # The low-pass of the recorded signals is all that is between the two.
    inner = slice(20, -20)
    assert np.abs(added - gain * feedback)[inner].max() < 0.03 * gain * np.abs(feedback).max()


def test_errors_fall_where_the_feedback_knows_the_right_direction() -> None:
    desired, method, errors = swing(), untrained(0.5), []
    for _ in range(6):
        trial = execute(desired, method.command(desired))
        errors.append(rms_error(trial))
        method.learn(trial, completed=True)
    assert errors[-1] < 0.5 * errors[0]


def test_it_has_a_command_for_any_movement() -> None:
    method = untrained(0.5)
    assert method.transfers
    assert method.command(swing(duration_s=3.0)).shape == swing(duration_s=3.0).position_rad.shape


def test_a_record_that_is_too_short_leaves_it_as_it_was() -> None:
    desired, method = swing(), untrained(0.5)
    before = method.command(desired)
    with pytest.raises(TrainingError):
        method.learn(execute(desired, before, n_run=20), completed=False)
    np.testing.assert_array_equal(method.command(desired), before)


def test_the_exact_model_needs_no_practice_and_the_servo_does_not_learn() -> None:
    """The joint of these tests: u - q = K⁻¹ (I q̈ + B q̇)."""
    desired = swing()
    exact = Feedforward(lambda x: (INERTIA * x[:, 2:] + DAMPING * x[:, 1:2]) / STIFFNESS, PERIOD_S)
    # Half a sample of delay is left: 0.8 rad/s times 2.5 ms.
    assert rms_error(execute(desired, exact.command(desired))) < 3e-3
    alone = servo(PERIOD_S)
    np.testing.assert_array_equal(alone.command(desired), desired.position_rad)
    trial = execute(desired, alone.command(desired))
    assert rms_error(trial) > 0.05
    alone.learn(trial, completed=True)
    np.testing.assert_array_equal(alone.command(desired), desired.position_rad)
