"""Inverse dynamics of rigid links, linear in masses, first and second moments, learned by least squares.

τ = Y(q, q̇, q̈) π + what each joint has of its own: inertia of its drive, viscous and Coulomb friction. Y
follows from the kinematics alone, so the URDF need not have right inertias. It comes from Pinocchio
(``pip install pin``), which is loaded when it is first used. Its parameters are few, so that few samples are
enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Self

import numpy as np

from tel_ros.core.arm_description import ENDLESS_RAD, ArmDescription
from tel_ros.core.errors import ConfigError, TelError
from tel_ros.core.learning.calibration import CalibratedLearner
from tel_ros.core.learning.experience import (
    CHANGED,
    SampleMemory,
    alternate_slices,
    better_strength,
    counted,
    stuck_trust,
    thinning,
)
from tel_ros.core.learning.learner import LearnerContext, StoredLearner, rms
from tel_ros.core.learning.least_squares import NormalEquations, on_one_thread
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.plain_urdf import plain_urdf
from tel_ros.core.types import BoolArray, FloatArray
from tel_ros.core.urdf import Urdf

COULOMB_SPEED_RAD_S = 0.01
"""Where the smoothed sign function tanh(q̇ / v) of Coulomb friction has 3/4 of its full value. Desired
velocities have no noise that a steep sign would turn into torque, and a sign that comes late at each reversal
lets the arm stick there."""
_PER_LINK, _PER_JOINT = 10, 3
_FIRST_STRENGTH = 1e-4


class RigidBodyRegressor:
    """The regressor Y of the joints of an arm, drives and friction included.

    The parameters are, for each moving link, mass, three first moments and six second moments about the
    joint; then, of each joint, inertia of its drive, viscous and Coulomb friction. That inertia is the one of
    a rotor behind its gear, less what the control loop takes off: damping B that comes late by t works like
    -B t. Joints of the URDF (its text) that are not named are taken as held: at 0, or as near as they can be.

    Raises:
        ConfigError: Pinocchio is not installed, or the URDF does not have such joints.
    """

    def __init__(self, urdf: str, joints: Sequence[str]) -> None:
        def refused(expected: str) -> ConfigError:
            return ConfigError("name", "rigid_body", expected)

        try:
            import pinocchio
        except ImportError:
            raise refused("another learner, or Pinocchio installed (pip install pin)") from None
        try:
            model = _model(pinocchio, urdf, joints)
        except (TelError, ValueError, RuntimeError) as error:
            raise refused(f"a URDF with these joints that Pinocchio reads ({error})") from None
        self._regressor = partial(pinocchio.computeJointTorqueRegressor, model, model.createData())
        self.described = np.concatenate([body.toDynamicParameters() for body in model.inertias.tolist()[1:]])
        """What the URDF says of the links: parameters without drives and friction."""
        self._order = np.array([model.joints[model.getJointId(joint)].idx_v for joint in joints])
        self.n_joints = len(joints)
        self.n_parameters = _PER_LINK * (model.njoints - 1) + _PER_JOINT * self.n_joints

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return Y for inputs of shape (n, 3 * n_joints). Shape (n, n_joints, n_parameters)."""
        inertial = self.n_parameters - _PER_JOINT * self.n_joints
        result = np.zeros((len(inputs), self.n_joints, self.n_parameters))
        for k, rows in enumerate(self._inertial(inputs)):
            result[k, :, :inertial] = rows[self._order]
        joints = np.arange(self.n_joints)
        for k, column in enumerate(self._own(inputs)):
            result[:, joints, inertial + k * self.n_joints + joints] = column
        return result

    def torque(self, inputs: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return Y π, without making all of Y. Shape (n, n_joints)."""
        inertial, own = np.split(parameters, [-_PER_JOINT * self.n_joints])
        result = np.empty((len(inputs), self.n_joints))
        for k, rows in enumerate(self._inertial(inputs)):
            result[k] = (rows @ inertial)[self._order]
        for each, column in zip(np.split(own, _PER_JOINT), self._own(inputs), strict=True):
            result += each * column
        return result

    def _own(self, inputs: FloatArray) -> tuple[FloatArray, ...]:
        """Return q̈, q̇ and the smoothed sign of q̇: what each joint's own parameters are multiplied by."""
        _, v, a = np.split(inputs, 3, axis=1)
        return a, v, np.tanh(v / COULOMB_SPEED_RAD_S)

    def _inertial(self, inputs: FloatArray) -> Iterator[FloatArray]:
        """Yield Y of the links for each sample, rows in the order of the model."""
        back = np.argsort(self._order)
        for q, v, a in zip(*(part[:, back] for part in np.split(inputs, 3, axis=1)), strict=True):
            yield self._regressor(q, v, a).reshape(self.n_joints, -1)

    def acceleration_slope(self, inputs: FloatArray, joint: int) -> FloatArray:
        """Return ∂Y / ∂q̈ of one joint, in which Y is linear. Shape (n, n_joints, n_parameters)."""
        at_rest = inputs.copy()
        at_rest[:, self.n_joints :] = 0.0
        pushed = at_rest.copy()
        pushed[:, 2 * self.n_joints + joint] = 1.0
        return self(pushed) - self(at_rest)


def _model(pinocchio: Any, urdf: str, joints: Sequence[str]) -> Any:
    """Return a model in which all other joints are fixed, and those have one coordinate each."""
    endless = (-ENDLESS_RAD,) * len(joints), (ENDLESS_RAD,) * len(joints)
    arm = ArmDescription(Urdf(urdf.encode(), "the URDF"), joints)
    return pinocchio.buildModelFromXML(plain_urdf(arm, stops_rad=endless))


class RigidBodyLearner(CalibratedLearner):
    """The arm as rigid links with drives and friction: u - q = K⁻¹ (B q̇ + Y π), linear in its parameters π.

    The normal equations are those of all trials; a ridge in units of each parameter's own effect suppresses
    combinations that the movements have not shown. Its strength is chosen by predicting each trial before
    learning from it.

    Raises:
        ConfigError: Pinocchio is not installed, or cannot use the URDF.
    """

    def __init__(self, context: LearnerContext) -> None:
        super().__init__(context)
        self.stuck_trust = np.ones(len(context.joints))
        """How far samples of the latest trial were believed whose joint may stick. Shape (n_joints,)."""
        self._regressor = RigidBodyRegressor(context.urdf, context.joints)
        n = self._regressor.n_parameters
        self._stiffness = np.array(context.stiffness_nm_per_rad)
        self._damping = np.array(context.damping_nms_per_rad)
        self._equations = NormalEquations.empty(n)
        self._strength = _FIRST_STRENGTH
        self._parameters = np.zeros(n)

    @classmethod
    def restored(cls, context: LearnerContext, stored: StoredLearner) -> Self:
        """Return a learner from its description."""
        learner = cls(context)
        learner._take_up(stored)
        learner._strength = float(stored.header["prior_strength"])
        if not 0.0 < learner._strength < np.inf:
            raise ValueError(f"prior_strength is {learner._strength}; expected a finite number above 0")
        n, n_joints = learner._regressor.n_parameters, len(context.joints)
        shapes = {"gram": (n, n), "moment": (n,), "effect": (n,), "parameters": (n,)}
        arrays = {name: stored.arrays[name] for name in shapes}
        if len(arrays["parameters"]) == n - n_joints:  # older files: drives without inertia
            drives = np.full(n_joints, n - _PER_JOINT * n_joints)
            for name, array in arrays.items():
                for axis in range(array.ndim):
                    array = np.insert(array, drives, 0.0, axis=axis)
                arrays[name] = array
        for name, shape in shapes.items():
            if arrays[name].shape != shape:
                raise ValueError(f"{name} has shape {arrays[name].shape}; expected {shape}")
        *equations, learner._parameters = arrays.values()
        learner._equations = NormalEquations(*equations)
        return learner

    def stored(self) -> StoredLearner:
        """Return everything that predictions and further training depend on."""
        header = {"trials_learned": self.trials_learned, "prior_strength": self._strength}
        arrays = vars(self._equations) | {"parameters": self._parameters}
        return StoredLearner(header, arrays | self.calibration.arrays())

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return u - q [rad] for inputs of shape (n, 3 * n_joints). Shape (n, n_joints)."""
        if self.trials_learned == 0:
            return np.zeros((len(inputs), len(self.context.joints)))
        torque_nm = self._regressor.torque(inputs, self._parameters)
        torque_nm += self._damping * inputs[:, len(self._damping) : 2 * len(self._damping)]
        torque_nm /= self._stiffness
        return torque_nm

    @on_one_thread
    def leverage(self, inputs: FloatArray) -> FloatArray:
        """Return the variance of the prediction in units of that of a sample. Shape (n, n_joints)."""
        if self.trials_learned == 0:
            return np.zeros((len(inputs), len(self.context.joints)))
        inverse = np.linalg.inv(self._equations.regular(self._strength))
        rows = self._rows(inputs)
        result: FloatArray = np.einsum("njp,pq,njq->nj", rows, inverse, rows, optimize=True)
        return np.maximum(result, 0.0)

    @on_one_thread
    def _learn(
        self, before: Self, samples: TrainingSamples, inputs: FloatArray, targets_rad: FloatArray
    ) -> list[str]:
        new = SampleMemory.of_trial(samples, inputs, targets_rad, before.trials_learned)
        old = self._equations.scaled(self.context.learning.forgetting)
        sliding = samples.certain[:: thinning(samples)]
        self.stuck_trust = self._stuck_trust(old, new, sliding)
        new = replace(new, trust=np.where(sliding, 1.0, self.stuck_trust))
        added = self._equations_of(new)
        changed = before._is_contradicted(new, lambda: self._residuals(old, added, new))
        if changed:
            old = NormalEquations.empty(len(added.moment))
            self._strength = _FIRST_STRENGTH
        else:
            self._strength = before._best_strength(old, new)
        self._equations = old + added
        self._parameters = self._equations.solution(self._strength)
        self._calibrate(before, new.inputs, new.targets_rad, new.trust)
        return [CHANGED] if changed else []

    def _rows(self, inputs: FloatArray) -> FloatArray:
        """Return Y in units of the output, rad. Shape (n, n_joints, n_parameters)."""
        return self._regressor(inputs) / self._stiffness[:, None]

    def _wanted(self, data: SampleMemory) -> FloatArray:
        """Return what Y π ought to be, in units of the output, rad. Shape (n, n_joints)."""
        n_joints = len(self.context.joints)
        spring = data.inputs[:, n_joints : 2 * n_joints] * self._damping / self._stiffness
        return np.asarray(data.targets_rad - spring, dtype=np.float64)

    def _equations_of(self, data: SampleMemory) -> NormalEquations:
        """Return the normal equations of samples, freed of what noise in the accelerations adds to them."""
        n = self._regressor.n_parameters
        root = np.sqrt(data.trust)
        rows = (self._rows(data.inputs) * root[:, :, None]).reshape(-1, n)
        gram = rows.T @ rows
        effect = np.diag(gram).copy()
        n_joints = len(self.context.joints)
        for joint in range(n_joints):
            noise = data.noise[:, 2 * n_joints + joint]
            if np.any(noise > 0.0):
                slope = self._regressor.acceleration_slope(data.inputs, joint)
                slope *= root[:, :, None] * noise[:, None, None] / self._stiffness[:, None]
                slope = slope.reshape(-1, n)
                gram -= slope.T @ slope
        return NormalEquations(gram, rows.T @ (root * self._wanted(data)).ravel(), effect)

    def _stuck_trust(self, old: NormalEquations, new: SampleMemory, sliding: BoolArray) -> FloatArray:
        """Return how far to believe samples whose joint may stick, judged by a fit that does without them."""
        certain = old + self._equations_of(replace(new, trust=sliding.astype(np.float64)))
        parameters = certain.solution(self._strength)
        residual = self._wanted(new) - self._rows(new.inputs) @ parameters
        return stuck_trust(residual, sliding, parameters[-len(self._stiffness) :] / self._stiffness)

    def _residuals(
        self, old: NormalEquations, added: NormalEquations, new: SampleMemory
    ) -> tuple[FloatArray, FloatArray]:
        """Return how well the new samples are fitted with the old ones, and alone. Shapes (n_joints,)."""
        rows, wanted = self._rows(new.inputs), self._wanted(new)

        def residual(equations: NormalEquations) -> FloatArray:
            error = counted(wanted - rows @ equations.solution(self._strength), new.trust)
            return np.sqrt(np.mean(error**2, axis=0))

        return residual(old + added), residual(added)

    def _best_strength(self, old: NormalEquations, new: SampleMemory) -> float:
        if self.trials_learned:
            equations, held_out = old, new
        elif len(new) == 1:  # cannot be held out and learned from
            return self._strength
        else:
            learned = alternate_slices(len(new))
            equations, held_out = self._equations_of(new[learned]), new[~learned]
        rows, wanted = self._rows(held_out.inputs), self._wanted(held_out)

        def error_with(strength: float) -> float:
            return rms(counted(wanted - rows @ equations.solution(strength), held_out.trust))

        return better_strength(self._strength, error_with)[0]
