"""The learner that knows rigid links but no kinematics, against the formulas of the two-link arm."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from two_link import TwoLinkArm, loops
from two_link_trials import DAMPING, STIFFNESS, context, random_movement, trial, truth_rad

from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.learning.learner import LearnerContext, rms
from tel_ros.core.learning.polynomial import PolynomialLearner
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

FASTER = query_inputs(loops(2.25).desired, 0.002)[3::25]
OTHER = random_movement(np.random.default_rng(3), 3.0)[::3]
NOISE_RAD = 3e-4


def noisy(samples: TrainingSamples, seed: int) -> TrainingSamples:
    noise = NOISE_RAD * np.random.default_rng(seed).normal(size=samples.offset_rad.shape)
    return dataclasses.replace(samples, offset_rad=samples.offset_rad + noise)


@cache
def practised(n_trials: int = 2) -> PolynomialLearner:
    """Return a learner that has learned from noisy trials, the slowest first, without a URDF."""
    learner = learner_kind("polynomial").new(dataclasses.replace(context(name="polynomial"), urdf=""))
    for seed, duration_s in enumerate((9.0, 6.0, 4.5)[:n_trials]):
        learner, _ = learner.trained_on(noisy(trial(duration_s), seed), "actual")
    assert isinstance(learner, PolynomialLearner)
    return learner


def effort_nm(learner: PolynomialLearner, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return K (u - q) - B q̇."""
    return STIFFNESS * learner.predict(np.hstack([q, v, a])) - DAMPING * v


def test_along_a_path_effort_is_affine_in_the_acceleration_and_quadratic_in_the_speed() -> None:
    """Four probes at speeds at which dry friction has its full size tell all others."""
    rng = np.random.default_rng(0)
    q, tangent, bend = rng.uniform(-1.0, 1.0, (3, 40, 2))
    tangent += np.sign(tangent)

    def probe(speed: float, acceleration: float) -> FloatArray:
        return effort_nm(practised(), q, tangent * speed, bend * speed**2 + tangent * acceleration)

    one, two, three, pushed = probe(1.0, 0.0), probe(2.0, 0.0), probe(3.0, 0.0), probe(1.0, 1.0)
    quadratic = (three - 2.0 * two + one) / 2.0
    linear = two - one - 3.0 * quadratic
    constant = one - linear - quadratic
    for speed, acceleration in ((1.7, -4.0), (0.6, 11.0), (4.0, 2.5)):
        expected = (pushed - one) * acceleration + quadratic * speed**2 + linear * speed + constant
        np.testing.assert_allclose(probe(speed, acceleration), expected, atol=1e-9)


def test_a_trial_at_half_the_duration_and_another_movement_are_predicted_from_slow_ones() -> None:
    for inputs in (FASTER, OTHER):
        error_rad = practised().predict(inputs) - truth_rad(inputs)
        assert rms(error_rad) < 0.02 * rms(truth_rad(inputs))


@pytest.mark.parametrize("n_trials", [1, 2, 3])
def test_two_standard_deviations_hold_nearly_all_errors_of_faster_and_other_movements(n_trials: int) -> None:
    learner = practised(n_trials)
    for inputs in (FASTER, OTHER):
        error_rad = learner.predict(inputs) - truth_rad(inputs)
        assert np.mean(np.abs(error_rad) <= 2.0 * learner.std(inputs)) > 0.9


def test_standard_deviations_grow_with_speed() -> None:
    slow, fast = (practised().std(query_inputs(loops(d).desired, 0.002)[3::50]).mean() for d in (6.0, 1.5))
    assert fast > 2.0 * slow


def test_dry_friction_is_learned_and_a_joint_that_sticks_does_not_spoil_it() -> None:
    """A joint that sticks is held by a torque that says nothing about friction; here it is a large one."""
    samples = trial(6.0, step=5)
    coulomb = 0.4 / STIFFNESS
    sliding = np.abs(samples.actual[:, 2:4]) > 0.05
    dry = np.where(
        sliding, coulomb * np.sign(samples.actual[:, 2:4]), coulomb * np.sin(samples.actual[:, :2] * 40.0)
    )
    samples = dataclasses.replace(samples, offset_rad=samples.offset_rad + dry, sliding=sliding)
    learner, _ = PolynomialLearner(context()).trained_on(noisy(samples, 1), "actual")
    moving = np.abs(FASTER[:, 2:4]) > 0.1
    expected = truth_rad(FASTER) + coulomb * np.sign(FASTER[:, 2:4])
    assert rms((learner.predict(FASTER) - expected)[moving]) < 0.05 * coulomb + 0.01 * rms(expected)


def test_a_changed_arm_is_noticed_and_the_earlier_one_forgotten() -> None:
    heavy = TwoLinkArm(inertia_scale=1.2)
    learner, told = practised(3).trained_on(noisy(trial(4.5, arm=heavy), 7), "actual")
    assert any("has changed" in note for note in told.grown)
    assert rms(learner.predict(FASTER) - truth_rad(FASTER, heavy)) < 0.02 * rms(truth_rad(FASTER, heavy))
    _, told = practised(2).trained_on(noisy(trial(3.0), 8), "actual")
    assert told.grown == ()


def test_how_much_may_depend_on_a_joint_is_learned_and_networks_from_before_answer_as_they_did() -> None:
    stored = practised(3).stored()
    assert stored.arrays["prior_shape"][0] < 0.1, "nothing depends on where the first of two joints is"
    before = {name: array for name, array in stored.arrays.items() if name != "prior_shape"}
    same = before | {"prior_shape": np.array([0.7, 0.7])}
    kind, told = learner_kind("polynomial"), practised(3).context
    old, expected = (
        kind.restored(told, dataclasses.replace(stored, arrays=arrays)) for arrays in (before, same)
    )
    np.testing.assert_array_equal(old.predict(OTHER), expected.predict(OTHER))


def test_joints_may_come_in_another_order_than_they_carry_each_other() -> None:
    def swapped(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray(values.reshape(len(values), -1, 2)[:, :, ::-1].reshape(values.shape))

    told = context()
    forwards = PolynomialLearner(told)
    backwards = PolynomialLearner(dataclasses.replace(told, joints=told.joints[::-1]))
    samples = noisy(trial(6.0), 1)
    other = TrainingSamples(*map(swapped, (samples.actual, samples.desired, samples.offset_rad)))
    forwards, _ = forwards.trained_on(samples, "actual")
    backwards, _ = backwards.trained_on(other, "actual")
    np.testing.assert_allclose(
        backwards.predict(swapped(FASTER)), swapped(forwards.predict(FASTER)), atol=1e-6
    )


def test_a_urdf_without_the_joints_is_refused() -> None:
    with pytest.raises(ConfigError, match="name is 'polynomial'; expected a URDF with wrist, or none"):
        PolynomialLearner(dataclasses.replace(context(), joints=("shoulder", "wrist")))


class Slide:
    """A joint that slides and carries one that turns: τ = d/dt ∂T/∂q̇ - ∂T/∂q + ∂U/∂q in formulas."""

    MASSES, LENGTH, GRAVITY = (2.0, 1.0), 0.5, 9.81
    URDF = """<robot name="crane"><link name="base"/><link name="cart"/><link name="arm"/>
      <joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/>
        <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="20" velocity="5"/></joint>
      <joint name="pivot" type="revolute"><parent link="cart"/><child link="arm"/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="20" velocity="5"/></joint></robot>"""

    @classmethod
    def effort(cls, inputs: FloatArray) -> FloatArray:
        q, v, a = np.split(inputs, 3, axis=1)
        (cart, arm), length = cls.MASSES, cls.LENGTH
        rail = (cart + arm) * a[:, 0] + arm * length * (
            np.cos(q[:, 1]) * a[:, 1] - np.sin(q[:, 1]) * v[:, 1] ** 2
        )
        pivot = arm * length**2 * a[:, 1] + arm * length * np.cos(q[:, 1]) * a[:, 0]
        pivot += arm * cls.GRAVITY * length * np.sin(q[:, 1])
        return np.column_stack([rail, pivot])


def test_torques_of_joints_that_slide_and_of_joints_under_gravity_are_learned_as_well() -> None:
    """As a learner of torque: in units of what was recorded, without springs."""
    rng = np.random.default_rng(5)
    slow, fast = random_movement(rng, 6.0, 0.8), random_movement(rng, 3.0, 0.8)
    unit = Slide.effort(slow).std(axis=0)
    told = LearnerContext(
        joints=("rail", "pivot"),
        stiffness_nm_per_rad=tuple(unit.tolist()),
        damping_nms_per_rad=(0.0, 0.0),
        input_range=context().input_range,
        learning=context().learning,
        seed=1,
        urdf=Slide.URDF,
        predicts="torque",
    )
    learner, _ = PolynomialLearner(told).trained_on(
        TrainingSamples(slow, slow, Slide.effort(slow) / unit), "actual"
    )
    assert rms(unit * learner.predict(fast) - Slide.effort(fast)) < 0.02 * rms(Slide.effort(fast))
