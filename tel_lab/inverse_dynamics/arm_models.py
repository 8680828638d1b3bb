"""Arms in URDFs: one that writes, one with seven joints, the torques that they need, and wrong inertias."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.trajectories.paths import Derivatives
from tel_ros.core.types import FloatArray

GRAVITY_M_S2 = 9.80665
WRITING_ARM = Path(__file__).with_name("writing_arm.urdf").read_text(encoding="utf-8")
WRITING_LINKS_M = (0.30, 0.25)


def torque_nm(urdf: str, inputs: FloatArray, viscous_nms_per_rad: float | tuple[float, ...]) -> FloatArray:
    """Return the torque of rigid links with viscous friction for inputs of shape (n, 3 * n_joints)."""
    import pinocchio

    model = pinocchio.buildModelFromXML(urdf)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY_M_S2])
    data, parts = model.createData(), np.split(inputs, 3, axis=1)
    rigid = np.array([pinocchio.rnea(model, data, *row) for row in zip(*parts, strict=True)])
    return rigid + np.multiply(viscous_nms_per_rad, parts[1])


def writing_motion(hand: Derivatives) -> FloatArray:
    """Return q, q̇, q̈ of shape (n, 6) for a motion of the hand in the plane, the elbow bent to the left.

    Its position [m], velocity and acceleration are each of shape (n, 2).
    """
    (l1, l2), (p, v, a) = WRITING_LINKS_M, hand
    q2 = np.arccos((np.sum(p**2, axis=1) - l1**2 - l2**2) / (2.0 * l1 * l2))
    q1 = np.arctan2(p[:, 1], p[:, 0]) - np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))
    upper = l1 * np.column_stack([np.cos(q1), np.sin(q1)])
    fore = l2 * np.column_stack([np.cos(q1 + q2), np.sin(q1 + q2)])
    # The hand's velocity is J q̇; its acceleration J q̈ less what points to the shoulder and the elbow.
    jacobian = np.stack([upper + fore, fore], axis=2)[:, ::-1] * np.array([-1.0, 1.0])[:, None]
    dq = np.linalg.solve(jacobian, v[:, :, None])[:, :, 0]
    inwards = upper * dq[:, :1] ** 2 + fore * np.sum(dq, axis=1, keepdims=True) ** 2
    ddq = np.linalg.solve(jacobian, (a + inwards)[:, :, None])[:, :, 0]
    return stack_inputs(np.column_stack([q1, q2]), np.asarray(dq, dtype=np.float64), ddq)


def iiwa_urdf() -> str:
    import pybullet_data

    path = Path(pybullet_data.getDataPath()) / "kuka_iiwa" / "model.urdf"
    return path.read_text(encoding="utf-8")


def with_wrong_inertias(urdf: str) -> str:
    """Return a URDF with the same kinematics, but other masses, centres of mass, inertias and friction.

    Masses and moments change by factors from 1.4 to 3, up or down, centres of mass by up to 5 cm in each
    direction. What is said about friction is dropped, and so are shapes, which inertias could be guessed by.
    """
    robot, rng = ElementTree.fromstring(urdf), np.random.default_rng(4)
    for place, tag in (("link", "visual"), ("link", "collision"), ("joint", "dynamics")):
        for element in robot.iterfind(place):
            for child in element.findall(tag):
                element.remove(child)
    for inertial in robot.iterfind("link/inertial"):
        mass_factor, moment_factor = 3.0 ** (rng.choice((-1.0, 1.0), 2) * rng.uniform(0.3, 1.0, 2))
        shift_m = rng.uniform(-0.05, 0.05, 3)
        _scale(inertial.find("mass"), ("value",), mass_factor)
        _scale(inertial.find("inertia"), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), moment_factor)
        origin = inertial.find("origin")
        if origin is not None:
            centre_m = np.array(origin.get("xyz", "0 0 0").split(), dtype=np.float64) + shift_m
            origin.set("xyz", " ".join(map(repr, centre_m.tolist())))
    return ElementTree.tostring(robot, encoding="unicode")


def _scale(element: ElementTree.Element | None, keys: Iterable[str], factor: float) -> None:
    if element is not None:
        for key in keys:
            element.set(key, repr(float(element.get(key, "0")) * float(factor)))
