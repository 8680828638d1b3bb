"""The exact inverse dynamics of the simulated arm: what practice is to learn, known beforehand."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from sim_bridge.physics import STANDARD_GRAVITY_M_S2, pybullet, rerouted
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.learning.learner import TrainingMode, TrainingOutcome
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.plain_urdf import plain_urdf
from tel_ros.core.types import FloatArray
from tel_ros.recording.urdf import described


class ExactInverseDynamics:
    """What a learner would know that knew the simulated arm: u - q = K⁻¹ (B q̇ + τ), τ of rigid bodies.

    Inertia, gravity, payload and friction are the simulated ones. Encoder, velocity filter and delay are not
    in it, and τ is that of the middle of each control period, so its error is small but not zero.
    """

    trials_learned = 0

    def __init__(self, config: Config, sim: SimConfig) -> None:
        arm = config.arm
        self._joints = arm.joints
        self._stiffness = np.array(arm.stiffness_nm_per_rad)
        self._damping = np.array(arm.damping_nms_per_rad)
        description = described(arm)
        self._viscous = np.array(sim.viscous_friction_nms_per_rad or description.viscous_friction_nms_per_rad)
        self._coulomb = np.array(sim.coulomb_friction_nm or description.coulomb_friction_nm)
        self._urdf = plain_urdf(
            description,
            inertia_scale=sim.inertia_scale,
            payload_kg=sim.payload_kg,
            hand_link=arm.hand_link,
            stops_rad=description.stops_rad(arm),
        )

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q in rad for (q, q̇, q̈) of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        q, v, a = np.split(inputs, 3, axis=1)
        torque_nm = self._rigid_body_torque_nm(q, v, a) + self._viscous * v + self._coulomb * np.sign(v)
        return (torque_nm + self._damping * v) / self._stiffness

    def std(self, inputs: FloatArray) -> FloatArray:
        return np.zeros((len(inputs), inputs.shape[1] // 3))

    def trained_on(
        self, samples: TrainingSamples, mode: TrainingMode
    ) -> tuple[ExactInverseDynamics, TrainingOutcome]:
        return self, TrainingOutcome(0.0, 0.0, 0.0, ())

    def _rigid_body_torque_nm(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        with rerouted(1, to=2), tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "arm.urdf"
            file.write_text(self._urdf, encoding="utf-8")
            client = pybullet.connect(pybullet.DIRECT)
            try:
                flags = pybullet.URDF_USE_INERTIA_FROM_FILE
                body = pybullet.loadURDF(str(file), useFixedBase=True, flags=flags, physicsClientId=client)
                pybullet.setGravity(0.0, 0.0, -STANDARD_GRAVITY_M_S2, physicsClientId=client)
                # Which of the arm's joints PyBullet's first, second, … movable joint is.
                n_joints = pybullet.getNumJoints(body, physicsClientId=client)
                infos = [pybullet.getJointInfo(body, i, physicsClientId=client) for i in range(n_joints)]
                names = [info[1].decode() for info in infos]
                order = [self._joints.index(name) for name in names if name in self._joints]
                torque_nm = np.zeros_like(q)
                for k, rows in enumerate(zip(*(x[:, order].tolist() for x in (q, v, a)), strict=True)):
                    torque_nm[k, order] = pybullet.calculateInverseDynamics(
                        body, *rows, physicsClientId=client
                    )
                return torque_nm
            finally:
                pybullet.disconnect(client)
