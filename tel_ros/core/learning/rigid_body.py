"""Inverse dynamics as what they are for rigid links: linear in masses, first and second moments.

τ = Y(q, q̇, q̈) π + viscous and Coulomb friction. Y follows from the kinematics alone, so the URDF need not
have right inertias. Y comes from Pinocchio (``pip install pin``), which is loaded when it is first used.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tel_ros.core.errors import ConfigError
from tel_ros.core.types import FloatArray

COULOMB_SPEED_RAD_S = 0.01
"""Where the smoothed sign function tanh(q̇ / v) of Coulomb friction has 3/4 of its full value. Desired
velocities have no noise that a steep sign would turn into torque, and a sign that comes late at each reversal
lets the arm stick there."""
_PER_LINK = 10


class RigidBodyRegressor:
    """The regressor Y of the joints of an arm, friction included.

    The parameters are, for each moving link, mass, three first moments and six second moments about the
    joint; then viscous, then Coulomb friction of each joint.

    Args:
        urdf: text of the URDF. Other joints than ``joints`` are taken as fixed at zero.
        joints: names, in the order of all arrays.

    Raises:
        ConfigError: Pinocchio is not installed, or the URDF does not have such joints.
    """

    def __init__(self, urdf: str, joints: Sequence[str]) -> None:
        try:
            import pinocchio
        except ImportError:
            raise ConfigError(
                "name", "rigid_body", "another learner, or Pinocchio installed (pip install pin)"
            ) from None
        self._pin: Any = pinocchio
        try:
            whole = pinocchio.buildModelFromXML(urdf)
        except (ValueError, RuntimeError) as error:
            raise ConfigError("name", "rigid_body", f"a URDF that Pinocchio reads ({error})") from None
        missing = [joint for joint in joints if not whole.existJointName(joint)]
        if missing:
            raise ConfigError("name", "rigid_body", f"a URDF with the moving joints {', '.join(missing)}")
        others = [k for k in range(1, whole.njoints) if whole.names[k] not in joints]
        model = pinocchio.buildReducedModel(whole, others, pinocchio.neutral(whole)) if others else whole
        if model.nq != len(joints) or model.nv != len(joints):
            raise ConfigError("name", "rigid_body", "revolute or prismatic joints with one coordinate each")
        self._model, self._data = model, model.createData()
        self._order = np.array([model.joints[model.getJointId(joint)].idx_v for joint in joints])
        self._in_order = bool(np.all(self._order == np.arange(len(joints))))
        self.n_joints = len(joints)
        self.n_parameters = _PER_LINK * (model.njoints - 1) + 2 * self.n_joints

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return Y for inputs of shape (n, 3 * n_joints). Shape (n, n_joints, n_parameters)."""
        n, n_joints, inertial = len(inputs), self.n_joints, self.n_parameters - 2 * self.n_joints
        result = np.zeros((n, n_joints, self.n_parameters))
        q, v, a = self._coordinates(inputs)
        compute, model, data = self._pin.computeJointTorqueRegressor, self._model, self._data
        for k in range(n):
            result[k, :, :inertial] = compute(model, data, q[k], v[k], a[k]).reshape(n_joints, -1)[
                self._order
            ]
        speed = inputs[:, n_joints : 2 * n_joints]
        joints = np.arange(n_joints)
        result[:, joints, inertial + joints] = speed
        result[:, joints, inertial + n_joints + joints] = np.tanh(speed / COULOMB_SPEED_RAD_S)
        return result

    def torque(self, inputs: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return Y π, without making all of Y. Shape (n, n_joints)."""
        n_joints = self.n_joints
        inertial, viscous = parameters[: -2 * n_joints], parameters[-2 * n_joints : -n_joints]
        coulomb = parameters[-n_joints:]
        q, v, a = self._coordinates(inputs)
        compute, model, data = self._pin.computeJointTorqueRegressor, self._model, self._data
        result = np.empty((len(inputs), n_joints))
        for k in range(len(inputs)):
            result[k] = compute(model, data, q[k], v[k], a[k]).reshape(n_joints, -1) @ inertial
        if not self._in_order:
            result = result[:, self._order]
        speed = inputs[:, n_joints : 2 * n_joints]
        result += viscous * speed + coulomb * np.tanh(speed / COULOMB_SPEED_RAD_S)
        return result

    def acceleration_slope(self, inputs: FloatArray, joint: int) -> FloatArray:
        """Return ∂Y / ∂q̈ of one joint, in which Y is linear. Shape (n, n_joints, n_parameters)."""
        at_rest = inputs.copy()
        at_rest[:, self.n_joints :] = 0.0
        pushed = at_rest.copy()
        pushed[:, 2 * self.n_joints + joint] = 1.0
        return self(pushed) - self(at_rest)

    def _coordinates(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        n = self.n_joints
        if self._in_order:
            return inputs[:, :n], inputs[:, n : 2 * n], inputs[:, 2 * n :]
        parts = []
        for part in np.split(inputs, 3, axis=1):
            ordered = np.empty_like(part)
            ordered[:, self._order] = part
            parts.append(ordered)
        return parts[0], parts[1], parts[2]
