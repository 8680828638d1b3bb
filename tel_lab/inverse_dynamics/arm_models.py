"""Descriptions of arms: two joints in formulas, a seven-joint arm, and URDFs whose inertias are wrong."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tel_ros.core.learning.inputs import stack_inputs
from tel_ros.core.trajectories.paths import Derivatives
from tel_ros.core.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class TwoLinkArm:
    """A two-joint arm with vertical axes, in formulas: M(q) q̈ + h(q, q̇) + b q̇ = τ.

    Each link has its centre of mass in its middle, and its inertia about that.
    """

    length_m: tuple[float, float]
    mass_kg: tuple[float, float]
    inertia_kgm2: tuple[float, float]
    viscous_nms_per_rad: tuple[float, float]

    def torque_nm(self, inputs: FloatArray, inertia_scale: float = 1.0) -> FloatArray:
        """Return τ for inputs of shape (n, 6), all inertias multiplied by a factor. Shape (n, 2)."""
        (l1, l2), (m1, m2), (i1, i2) = self.length_m, self.mass_kg, self.inertia_kgm2
        _, q2, v1, v2, a1, a2 = inputs.T
        coupling = 0.5 * m2 * l1 * l2
        c, s = coupling * np.cos(q2), coupling * np.sin(q2)
        elbow = i2 + 0.25 * m2 * l2**2
        carried = i1 + 0.25 * m1 * l1**2 + m2 * l1**2
        at_shoulder = (carried + elbow + 2.0 * c) * a1 + (elbow + c) * a2 - s * (2.0 * v1 * v2 + v2**2)
        at_elbow = (elbow + c) * a1 + elbow * a2 + s * v1**2
        friction = inputs[:, 2:4] * self.viscous_nms_per_rad
        return inertia_scale * np.column_stack([at_shoulder, at_elbow]) + friction

    def urdf(self) -> str:
        """Return its description, with the right inertias."""
        limit = '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="20" velocity="15"/>'
        text, parent, at_m = '<link name="base"/>', "base", 0.0
        for name, child, kind, more in (
            ("shoulder", "link_1", "revolute", limit),
            ("elbow", "link_2", "revolute", limit),
            ("hand_mount", "hand", "fixed", ""),
        ):
            text += f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            text += f'<origin xyz="{at_m} 0 0"/>{more}</joint>'
            parent = child
            if child != "hand":
                i = int(child[-1]) - 1
                at_m, moment = self.length_m[i], self.inertia_kgm2[i]
                text += f'<link name="{child}"><inertial><origin xyz="{0.5 * at_m} 0 0"/>'
                text += f'<mass value="{self.mass_kg[i]}"/><inertia ixx="{moment}" iyy="{moment}" '
                text += f'izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        return f'<robot name="two_link">{text}<link name="hand"/></robot>'

    def joint_motion(self, hand: Derivatives) -> FloatArray:
        """Return q, q̇, q̈ of shape (n, 6) for a motion of the hand in the plane, the elbow bent to the left.

        Its position [m], velocity and acceleration are each of shape (n, 2).
        """
        (l1, l2), (p, v, a) = self.length_m, hand
        q2 = np.arccos((np.sum(p**2, axis=1) - l1**2 - l2**2) / (2.0 * l1 * l2))
        q1 = np.arctan2(p[:, 1], p[:, 0]) - np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))
        upper = l1 * np.column_stack([np.cos(q1), np.sin(q1)])
        fore = l2 * np.column_stack([np.cos(q1 + q2), np.sin(q1 + q2)])

        def turned(vectors: FloatArray) -> FloatArray:
            return np.column_stack([-vectors[:, 1], vectors[:, 0]])

        # The hand's velocity is J q̇; its acceleration J q̈ less what points to the shoulder and the elbow.
        jacobian = np.stack([turned(upper + fore), turned(fore)], axis=2)
        dq = np.asarray(np.linalg.solve(jacobian, v[:, :, None])[:, :, 0], dtype=np.float64)
        inwards = upper * dq[:, :1] ** 2 + fore * np.sum(dq, axis=1, keepdims=True) ** 2
        ddq = np.linalg.solve(jacobian, (a + inwards)[:, :, None])[:, :, 0]
        return stack_inputs(np.column_stack([q1, q2]), dq, ddq)


DEFAULT_ARM = TwoLinkArm(
    length_m=(0.33, 0.33), mass_kg=(2.0, 1.2), inertia_kgm2=(0.05, 0.02), viscous_nms_per_rad=(0.05, 0.05)
)
"""The arm of ``sim_bridge/urdf/planar_arm.urdf``."""

WRITING_ARM = TwoLinkArm(
    length_m=(0.30, 0.25), mass_kg=(1.4, 1.0), inertia_kgm2=(0.02, 0.012), viscous_nms_per_rad=(0.08, 0.05)
)


def iiwa_urdf() -> str:
    """Return the description of the seven-joint arm, with the inertias that its torques are made with."""
    import pybullet_data

    path = Path(pybullet_data.getDataPath()) / "kuka_iiwa" / "model.urdf"
    return path.read_text(encoding="utf-8")


def with_wrong_inertias(urdf: str) -> str:
    """Return a URDF with the same kinematics, but other masses, centres of mass, inertias and friction.

    Masses and moments change by factors from 1.4 to 3, up or down, centres of mass by up to 5 cm in each
    direction. What is said about friction is dropped, and so are shapes, which inertias could be guessed by.
    """
    robot, rng = _without(urdf, *_SHAPES, ("joint", "dynamics")), np.random.default_rng(4)
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


def without_shapes(urdf: str) -> str:
    """Return a URDF without what its links look like and collide with."""
    return ElementTree.tostring(_without(urdf, *_SHAPES), encoding="unicode")


_SHAPES = (("link", "visual"), ("link", "collision"))


def _without(urdf: str, *places: tuple[str, str]) -> ElementTree.Element:
    robot = ElementTree.fromstring(urdf)
    for tag, child_tag in places:
        for element in robot.iterfind(tag):
            for child in element.findall(child_tag):
                element.remove(child)
    return robot


def _scale(element: ElementTree.Element | None, keys: Iterable[str], factor: float) -> None:
    if element is not None:
        for key in keys:
            element.set(key, repr(float(element.get(key, "0")) * float(factor)))
