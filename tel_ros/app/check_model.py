"""What the URDF says of an arm's inertia, by Pinocchio where it is installed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.types import FloatArray
from tel_ros.recording.urdf import read_urdf


def inertia_and_friction(arm: ArmConfig, position_rad: FloatArray) -> tuple[FloatArray | None, FloatArray]:
    """Return the inertia matrix of the arm's joints at a posture, and their viscous friction.

    Args:
        arm: joints and URDF. Other joints are taken as fixed at zero.
        position_rad: shape (n_joints,).

    Returns:
        Inertia in kg·m² of shape (n_joints, n_joints), None if Pinocchio is not installed or the matrix is
        not positive definite (a URDF without masses); viscous friction in N·m·s/rad of shape (n_joints,).
    """
    joint_map = read_urdf(Path(arm.urdf)).joint_map
    dynamics = [joint_map[name].dynamics for name in arm.joints]
    friction = np.array([float((d and d.damping) or 0.0) for d in dynamics])
    try:
        import pinocchio
    except ImportError:
        return None, friction
    whole = pinocchio.buildModelFromXML(Path(arm.urdf).read_text(encoding="utf-8"))
    others = [k for k in range(1, whole.njoints) if whole.names[k] not in arm.joints]
    model = pinocchio.buildReducedModel(whole, others, pinocchio.neutral(whole)) if others else whole
    order = [model.joints[model.getJointId(name)].idx_v for name in arm.joints]
    q = pinocchio.neutral(model)
    for name, value in zip(arm.joints, position_rad, strict=True):
        joint = model.joints[model.getJointId(name)]
        # A continuous joint has a cosine and a sine.
        q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]
    upper = np.triu(pinocchio.crba(model, model.createData(), q))
    full = upper + np.triu(upper, 1).T
    inertia = np.asarray(full[np.ix_(order, order)], dtype=np.float64)
    if not np.all(np.linalg.eigvalsh(inertia) > 0.0):
        return None, friction
    return inertia, friction
