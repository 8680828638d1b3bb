"""Trials of the two-link arm as learners get them: exact, made from its formulas."""

from __future__ import annotations

import numpy as np
from two_link import ARM, TwoLinkArm, loops

from tel_ros.core.config import LearningConfig
from tel_ros.core.learning.inputs import InputRange, query_inputs
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray

JOINTS: tuple[str, ...] = ("shoulder", "elbow")
STIFFNESS, DAMPING = 15.0, 1.5
GOAL = loops(4.5).desired
INPUT_RANGE = InputRange.covering(GOAL, 1.3)

_JOINT = """
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="{at} 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.9" upper="2.9" effort="20" velocity="15"/>
  </joint>"""
_LINK = """
  <link name="{name}"><inertial>
    <origin xyz="{centre} 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/>
  </inertial></link>"""


def urdf(scale: float = 1.0, joints: tuple[str, ...] = JOINTS) -> str:
    """Return the URDF of the arm, its masses and inertias multiplied by a factor."""
    (m1, m2), (i1, i2) = TwoLinkArm.MASS, TwoLinkArm.INERTIA
    centre, length = TwoLinkArm.CENTRE, TwoLinkArm.LENGTH
    return (
        '<robot name="two_link"><link name="base"/>'
        + _JOINT.format(name=joints[0], parent="base", child="upper_arm", at=0.0)
        + _LINK.format(name="upper_arm", centre=centre, mass=scale * m1, inertia=scale * i1)
        + _JOINT.format(name=joints[1], parent="upper_arm", child="forearm", at=length)
        + _LINK.format(name="forearm", centre=centre, mass=scale * m2, inertia=scale * i2)
        + "</robot>"
    )


def context(seed: int = 1, input_range: InputRange = INPUT_RANGE, **learning: object) -> LearnerContext:
    """Return what a learner is told about the arm; its URDF has inertias that are wrong by far."""
    return LearnerContext(
        joints=JOINTS,
        stiffness_nm_per_rad=ARM["stiffness_nm_per_rad"],
        damping_nms_per_rad=ARM["damping_nms_per_rad"],
        input_range=input_range,
        learning=LearningConfig(**learning),
        seed=seed,
        urdf=urdf(scale=7.0),
    )


def truth_rad(inputs: FloatArray, arm: TwoLinkArm | None = None) -> FloatArray:
    """Return u - q = K⁻¹ (B q̇ + τ) of the arm."""
    q, v, a = np.split(inputs, 3, axis=1)
    return (DAMPING * v + (arm or TwoLinkArm()).inverse_dynamics(q, v, a)) / STIFFNESS


def trial(
    duration_s: float = 4.5,
    *,
    step: int = 10,
    first: int = 0,
    shift_rad: float = 0.0,
    arm: TwoLinkArm | None = None,
) -> TrainingSamples:
    """Return points of the project's figure; what the arm did lies beside it by a shift of all positions."""
    desired = query_inputs(loops(duration_s).desired, 0.002)[first::step]
    actual = desired.copy()
    actual[:, :2] += shift_rad
    return TrainingSamples(actual=actual, desired=desired, offset_rad=truth_rad(actual, arm))


def random_movement(rng: np.random.Generator, duration_s: float, size: float = 1.0) -> FloatArray:
    """Return a smooth movement from rest to rest of another shape, at 50 Hz. Shape (n, 6)."""
    time_s = np.arange(0.0, duration_s, 0.02)
    s = time_s / duration_s
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    q = np.tile([0.6, 1.1], (len(s), 1))
    for joint, amplitude in ((0, 0.45), (1, 0.5)):
        for k in (1, 2, 3):
            waves = np.sin(2 * np.pi * k * s + rng.uniform(0.0, 6.0))
            q[:, joint] += size * amplitude * rng.uniform(-1.0, 1.0) / 1.5 * waves
    v = np.gradient(q, 0.02, axis=0)
    return np.hstack([q, v, np.gradient(v, 0.02, axis=0)])[2:-2]
