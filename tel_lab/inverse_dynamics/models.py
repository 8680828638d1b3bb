"""Learners of inverse dynamics side by side: this project's, and some of scikit-learn (extra ``lab``)."""

from __future__ import annotations

import json
import pickle
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tel_lab.inverse_dynamics.data_sets import DataSet, Trial, stacked
from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TelError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray, evenly_spaced

GP, MLP = "GP", "MLP"

OURS: dict[str, dict[str, Any]] = {
    "LMS tree": {"name": "lms_tree", "weights": "lms"},
    "least-squares tree": {"name": "lms_tree", "weights": "least_squares"},
    "rigid body": {"name": "rigid_body"},
    "rigid body + tree": {"name": "rigid_body+lms_tree", "weights": "least_squares"},
}
"""What is set in the configuration of learning for each of our learners."""


@dataclass(frozen=True)
class Effort:
    """How much the baselines may work.

    At most so many samples of a Gaussian process, taken evenly from all trials; those of them with which its
    hyperparameters are found, in so many iterations; and steps of Adam with 200 samples each.
    """

    gp_samples: int = 1000
    gp_tuning_samples: int = 300
    gp_iterations: int = 50
    mlp_steps: int = 6000


class OurModel:
    """A learner of this project: it learns the offset of the EP, one trial after the other.

    Torque and offset are two names of the same thing: τ = K N(q, q̇, q̈) - B q̇.
    """

    def __init__(self, learning: LearningConfig, data: DataSet) -> None:
        self._learning, self._data = learning, data
        self._stiffness = np.array(data.stiffness_nm_per_rad)
        self._damping = np.array(data.damping_nms_per_rad)
        self.fit(data.training[:1])  # compiles what has to be compiled, outside of the timing

    def fit(self, trials: Sequence[Trial]) -> None:
        data = self._data
        self._learner = learner_kind(self._learning.name).new(
            LearnerContext(
                joints=data.joints,
                stiffness_nm_per_rad=data.stiffness_nm_per_rad,
                damping_nms_per_rad=data.damping_nms_per_rad,
                input_range=input_range(data.training, self._learning.input_margin),
                learning=self._learning,
                seed=1,
                urdf=data.urdf,
            )
        )
        for trial in trials:
            samples = TrainingSamples(
                actual=trial.inputs,
                desired=trial.inputs,
                offset_rad=(trial.torque_nm + self._damping * self._velocity(trial.inputs)) / self._stiffness,
                input_noise=trial.input_noise,
                period_s=1.0 / trial.rate_hz,
                bandwidth_hz=trial.bandwidth_hz,
            )
            self._learner, _ = self._learner.trained_on(samples, "actual")

    def predict(self, inputs: FloatArray) -> FloatArray:
        return self._stiffness * self._learner.predict(inputs) - self._damping * self._velocity(inputs)

    def size_mb(self) -> float:
        stored = self._learner.stored()
        return (sum(a.nbytes for a in stored.arrays.values()) + len(json.dumps(dict(stored.header)))) / 1e6

    def _velocity(self, inputs: FloatArray) -> FloatArray:
        n = len(self._data.joints)
        return inputs[:, n : 2 * n]


class SklearnModel:
    """Estimators of scikit-learn on standardised inputs and torques: one for all joints, or one a joint."""

    def __init__(self, fit: Callable[[FloatArray, FloatArray], list[Any]]) -> None:
        self._fit_estimators = fit

    def fit(self, trials: Sequence[Trial]) -> None:
        inputs, torque_nm = stacked(trials)
        # By hand: for a single sample a StandardScaler takes twice as long as the estimators.
        self._inputs, self._torques = ((x.mean(axis=0), x.std(axis=0)) for x in (inputs, torque_nm))
        standard = ((x - m) / s for x, (m, s) in ((inputs, self._inputs), (torque_nm, self._torques)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of convergence: the limits are set on purpose
            self._estimators = self._fit_estimators(*standard)

    def predict(self, inputs: FloatArray) -> FloatArray:
        scaled = (inputs - self._inputs[0]) / self._inputs[1]
        columns = [estimator.predict(scaled) for estimator in self._estimators]
        outputs = columns[0] if len(columns) == 1 else np.column_stack(columns)
        return outputs * self._torques[1] + self._torques[0]

    def size_mb(self) -> float:
        return len(pickle.dumps(self._estimators)) / 1e6


def fit_mlp(inputs: FloatArray, outputs: FloatArray, n_steps: int) -> list[Any]:
    """Return one network of all joints with two hidden layers of 64 tanh units."""
    from sklearn.neural_network import MLPRegressor

    epochs = max(1, round(n_steps * min(200, len(inputs)) / len(inputs)))
    estimator = MLPRegressor(
        hidden_layer_sizes=(64, 64),
        activation="tanh",
        alpha=0.01,  # a compromise: less suits the letters better, more the seven joints
        max_iter=epochs,
        n_iter_no_change=epochs,  # no early end
        random_state=1,
    )
    return [estimator.fit(inputs, outputs)]


def fit_gp(inputs: FloatArray, outputs: FloatArray, effort: Effort) -> list[Any]:
    """Return a Gaussian process a joint: RBF with a length for each input, and white noise.

    Hyperparameters are found with fewer samples than are then used: much faster, and as good.
    """
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    rows = evenly_spaced(len(inputs), effort.gp_samples)
    few = rows[evenly_spaced(len(rows), effort.gp_tuning_samples)]

    def search(objective: Any, start: FloatArray, bounds: FloatArray) -> tuple[FloatArray, float]:
        # Unless the gradient is about 1, the first step of L-BFGS-B ends in a far corner, and the search too.
        scale = 1.0 + abs(objective(start, eval_gradient=False))
        found = minimize(
            lambda theta: tuple(part / scale for part in objective(theta)),
            start,
            jac=True,
            bounds=bounds,
            method="L-BFGS-B",
            options={"maxiter": effort.gp_iterations},
        )
        return found.x, found.fun * scale

    kernel = ConstantKernel(10.0, (1e-2, 1e4)) * RBF(np.full(inputs.shape[1], 5.0), (1e-1, 1e3))
    kernel += WhiteKernel(1e-1, (1e-7, 1.0))
    estimators = []
    for column in outputs.T:
        tuned = GaussianProcessRegressor(kernel, optimizer=search).fit(inputs[few], column[few])
        final = GaussianProcessRegressor(tuned.kernel_, optimizer=None)
        estimators.append(final.fit(inputs[rows], column[rows]))
    return estimators


def input_range(trials: Sequence[Trial], margin: float) -> InputRange:
    """Return ranges as :meth:`InputRange.covering` makes them, of some trials instead of a goal."""
    inputs, _ = stacked(trials)
    n = inputs.shape[1] // 3
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    middle[n:], half[n:] = 0.0, np.abs(inputs[:, n:]).max(axis=0)
    return InputRange(middle - margin * half, middle + margin * half)


Model = OurModel | SklearnModel
"""What learns torque from trials."""


def all_models(
    data: DataSet, effort: Effort, note: Callable[[str], None]
) -> Iterator[tuple[str, bool, Model]]:
    """Yield name, whether it is ours, and model. Learners that cannot be had are noted and left out."""
    from sklearn.linear_model import Ridge

    for name, settings in OURS.items():
        try:
            model = OurModel(LearningConfig(**settings), data)
        except TelError as error:
            note(f"{name} on {data.name} left out: {error}")
            continue
        yield name, True, model
    yield GP, False, SklearnModel(lambda x, y: fit_gp(x, y, effort))
    yield MLP, False, SklearnModel(lambda x, y: fit_mlp(x, y, effort.mlp_steps))
    yield "ridge", False, SklearnModel(lambda x, y: [Ridge(1e-3).fit(x, y)])
