"""How well and how fast inverse dynamics are learned: this project's learners beside scikit-learn's.

    .venv/bin/python benchmarks/learners.py [--quick]

Prints tables and writes them to docs/learners_benchmark.md. What the data are is told in
``inverse_dynamics_data.py``. Every learner gets one core, and CPU time is measured, so that the figures
hardly depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import json
import math
import pickle
import platform
import time
import timeit
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import sklearn
from inverse_dynamics_data import DataSet, Trial, all_data_sets, stacked
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table
from scipy.optimize import minimize
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import Ridge
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TelError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.core.types import FloatArray, IntArray

ROOT = Path(__file__).parents[1]
BATCH = 2250
"""Samples of a movement of 4.5 s at 500 Hz: what a trial asks a learner for."""
PARTS = (0.25, 0.5, 1.0)
TIMED_S = 0.05
WIDTH = 132
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

    Args:
        gp_samples: of a Gaussian process, at most; taken evenly from all trials.
        gp_tuning_samples: those of them with which its hyperparameters are found.
        gp_iterations: of that search, at most.
        mlp_steps: of Adam, with 200 samples each, however many samples there are.
    """

    gp_samples: int = 1000
    gp_tuning_samples: int = 300
    gp_iterations: int = 50
    mlp_steps: int = 6000


QUICK = Effort(gp_samples=300, gp_tuning_samples=150, gp_iterations=15, mlp_steps=1000)


class Model(Protocol):
    """Anything that learns torque from trials."""

    def fit(self, trials: Sequence[Trial]) -> None:
        """Learn from scratch."""
        ...

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return torque [N·m] of shape (n, n_joints) for inputs of shape (n, 3 * n_joints)."""
        ...

    def size_mb(self) -> float:
        """Return what has to be stored, in MB."""
        ...


class OurModel:
    """A learner of this project: it learns the offset of the EP, one trial after the other.

    Torque and offset are two names of the same thing: τ = K N(q, q̇, q̈) - B q̇.
    """

    def __init__(self, learning: LearningConfig, data: DataSet) -> None:
        self._learning, self._data = learning, data
        self._stiffness, self._damping = (
            np.array(data.stiffness_nm_per_rad),
            np.array(data.damping_nms_per_rad),
        )
        self._fit(data.training[:1])  # compiles what has to be compiled, outside of the timing

    def fit(self, trials: Sequence[Trial]) -> None:
        """Begin anew and go through the trials."""
        self._fit(trials)

    def _fit(self, trials: Sequence[Trial]) -> None:
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
        """Return torque [N·m]."""
        return self._stiffness * self._learner.predict(inputs) - self._damping * self._velocity(inputs)

    def size_mb(self) -> float:
        """Return the size of what goes into the file of a network."""
        stored = self._learner.stored()
        return (sum(a.nbytes for a in stored.arrays.values()) + len(json.dumps(dict(stored.header)))) / 1e6

    def _velocity(self, inputs: FloatArray) -> FloatArray:
        n = len(self._data.joints)
        return inputs[:, n : 2 * n]


class SklearnModel:
    """Estimators of scikit-learn on standardised inputs and torques.

    Args:
        fit: from standardised inputs and torques to estimators: one for all joints, or one a joint.
    """

    def __init__(self, fit: Callable[[FloatArray, FloatArray], list[Any]]) -> None:
        self._fit_estimators = fit

    def fit(self, trials: Sequence[Trial]) -> None:
        """Standardise and fit."""
        inputs, torque_nm = stacked(trials)
        self._input_mean, self._input_std = inputs.mean(axis=0), inputs.std(axis=0)
        self._torque_mean, self._torque_std = torque_nm.mean(axis=0), torque_nm.std(axis=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the limits are set on purpose
            self._estimators = self._fit_estimators(
                (inputs - self._input_mean) / self._input_std,
                (torque_nm - self._torque_mean) / self._torque_std,
            )

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Return torque [N·m]."""
        scaled = (inputs - self._input_mean) / self._input_std
        columns = [estimator.predict(scaled) for estimator in self._estimators]
        outputs = columns[0] if len(columns) == 1 else np.column_stack(columns)
        return outputs * self._torque_std + self._torque_mean

    def size_mb(self) -> float:
        """Return the size of the pickled estimators."""
        return len(pickle.dumps(self._estimators)) / 1e6


def fit_ridge(inputs: FloatArray, outputs: FloatArray) -> list[Any]:
    """Return one linear model of all joints."""
    return [Ridge(1e-3).fit(inputs, outputs)]


def fit_mlp(inputs: FloatArray, outputs: FloatArray, n_steps: int) -> list[Any]:
    """Return one network of all joints with two hidden layers of 64 tanh units."""
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
    rows = evenly(len(inputs), effort.gp_samples)
    few = rows[evenly(len(rows), effort.gp_tuning_samples)]

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


def evenly(n: int, at_most: int) -> IntArray:
    """Return at most so many of the rows 0 … n - 1, evenly spaced, the first and the last among them."""
    return np.linspace(0, n - 1, min(n, at_most)).round().astype(np.int64)


def input_range(trials: Sequence[Trial], margin: float) -> InputRange:
    """Return ranges as :meth:`InputRange.covering` makes them, of some trials instead of a goal."""
    inputs, _ = stacked(trials)
    n = inputs.shape[1] // 3
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    middle[n:], half[n:] = 0.0, np.abs(inputs[:, n:]).max(axis=0)
    return InputRange(middle - margin * half, middle + margin * half)


def nmse(model: Model, trials: Sequence[Trial]) -> FloatArray:
    """Return MSE / variance of the torque of each joint. Shape (n_joints,)."""
    inputs, torque_nm = stacked(trials)
    return np.mean((model.predict(inputs) - torque_nm) ** 2, axis=0) / np.var(torque_nm, axis=0)


def seconds_per_call(call: Callable[[], object]) -> float:
    """Return the CPU time of a call: the best of three rounds."""
    timer = timeit.Timer(call, timer=time.process_time)
    number = max(1, math.ceil(TIMED_S / max(timer.timeit(1), 1e-9)))
    return min(timer.repeat(3, number)) / number


@dataclass(frozen=True)
class Result:
    """One learner on one data set.

    Args:
        data: name of the data set.
        learner: name of the learner.
        is_ours: whether it belongs to this project.
        nmse: of the held-out trials, for each part of the training trials. Shape (n_parts, n_joints).
        training_s: for each part.
        batch_us: prediction time of a sample among ``BATCH``.
        single_us: prediction time of a sample alone.
        size_mb: what has to be stored.
    """

    data: str
    learner: str
    is_ours: bool
    nmse: FloatArray
    training_s: tuple[float, ...]
    batch_us: float
    single_us: float
    size_mb: float


def measured(
    model: Model, name: str, is_ours: bool, data: DataSet, parts: Sequence[float], step: Callable[[], None]
) -> Result:
    """Train on parts of the trials, the last one all of them, and measure."""
    errors, times = [], []
    for part in parts:
        trials = [data.training[i] for i in evenly(len(data.training), round(part * len(data.training)))]
        start = time.process_time()
        model.fit(trials)
        times.append(time.process_time() - start)
        errors.append(nmse(model, data.held_out))
        step()
    inputs, _ = stacked(data.held_out)
    batch = inputs[np.arange(BATCH) % len(inputs)]
    return Result(
        data=data.name,
        learner=name,
        is_ours=is_ours,
        nmse=np.array(errors),
        training_s=tuple(times),
        batch_us=1e6 * seconds_per_call(lambda: model.predict(batch)) / BATCH,
        single_us=1e6 * seconds_per_call(lambda: model.predict(batch[:1])),
        size_mb=model.size_mb(),
    )


def models(data: DataSet, effort: Effort, note: Callable[[str], None]) -> Iterator[tuple[str, bool, Model]]:
    """Yield name, whether it is ours, and model. Learners that cannot be had are noted and left out."""
    for name, settings in OURS.items():
        try:
            model = OurModel(LearningConfig(**settings), data)
        except TelError as error:
            note(f"{name} on {data.name} left out: {error}")
            continue
        yield name, True, model
    yield GP, False, SklearnModel(lambda x, y: fit_gp(x, y, effort))
    yield MLP, False, SklearnModel(lambda x, y: fit_mlp(x, y, effort.mlp_steps))
    yield "ridge", False, SklearnModel(fit_ridge)


@dataclass(frozen=True)
class Sheet:
    """A table for terminal and Markdown; the first two columns are names."""

    title: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]

    def shown(self) -> Table:
        """Return it for the terminal."""
        table = Table(title=self.title, title_justify="left")
        for i, name in enumerate(self.header):
            table.add_column(escape(name), justify="left" if i < 2 else "right", no_wrap=True)
        for row, after in zip(self.rows, [*self.rows[1:], None], strict=True):
            table.add_row(*row, end_section=after is not None and row[0] != after[0])
        return table

    def markdown(self) -> str:
        """Return it as Markdown."""
        lines = [self.header, ("---", "---", *("---:",) * (len(self.header) - 2)), *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def figures_sheet(results: Sequence[Result]) -> Sheet:
    """Return the figures of all learners that have seen all trials."""
    header = (
        "data",
        "learner",
        "nMSE",
        "worst joint",
        "training [s]",
        "batch [µs]",
        "single [µs]",
        "size [MB]",
    )
    rows = [
        (
            r.data,
            r.learner,
            _short(r.nmse[-1].mean()),
            _short(r.nmse[-1].max()),
            *map(_short, (r.training_s[-1], r.batch_us, r.single_us, r.size_mb)),
        )
        for r in results
    ]
    return Sheet("Held-out torque error, times and size", header, rows)


def growth_sheet(results: Sequence[Result], parts: Sequence[float]) -> Sheet:
    """Return how error and training time change with the number of trials."""
    header = tuple(f"{part:.0%}: {what}" for what in ("nMSE", "time [s]") for part in parts)
    rows = [(r.data, r.learner, *map(_short, (*r.nmse.mean(axis=1), *r.training_s))) for r in results]
    return Sheet("Trained on a part of the trials", ("data", "learner", *header), rows)


def ratios_sheet(results: Sequence[Result]) -> Sheet:
    """Return our learners' figures divided by those of the two strongest baselines."""
    header = tuple(f"{what} / {b}" for b in (GP, MLP) for what in ("training", "batch", "nMSE"))
    figures = {(r.data, r.learner): (r.training_s[-1], r.batch_us, float(r.nmse[-1].mean())) for r in results}
    rows = [
        (
            r.data,
            r.learner,
            *(
                _short(ours / theirs)
                for baseline in (GP, MLP)
                for ours, theirs in zip(figures[r.data, r.learner], figures[r.data, baseline], strict=True)
            ),
        )
        for r in results
        if r.is_ours
    ]
    return Sheet("Ours divided by theirs: below 1, ours is better", ("data", "learner", *header), rows)


def _short(value: float) -> str:
    """Return two digits, with an exponent only where it is needed."""
    if value != 0.0 and not 1e-3 <= value < 1e5:
        return f"{value:.1e}"
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


def page(sheets: Sequence[Sheet], sets: Sequence[DataSet], effort: Effort, notes: Sequence[str]) -> str:
    """Return the Markdown page."""
    about = "\n".join(f"- *{data.name}*: {data.about} ({_counts(data)})." for data in sets)
    intro = f"""# Learners of inverse dynamics

Made by `benchmarks/learners.py` with one core for each learner, Python {platform.python_version()}, numpy
{np.__version__}, scikit-learn {sklearn.__version__}. Times are CPU times; they depend on the machine.

{about}

nMSE: mean over the joints of MSE / variance of the torque of the held-out trials. *batch*: prediction time of
a sample among {BATCH}; *single*: of a sample alone.

- Our learners learn one trial after the other, with the default configuration of learning and a URDF whose
  inertias are wrong. Their size is that of the arrays in a network's file. All three arms are rigid with
  viscous friction, which is just what the rigid body assumes; without noise only rounding limits it.
- The baselines get all samples at once, inputs and outputs standardised. Their size is that of the pickle.
- {GP}: a Gaussian process for each joint, RBF with a length for each input and white noise; at most
  {effort.gp_samples} samples taken evenly from all, hyperparameters from {effort.gp_tuning_samples} of them
  in at most {effort.gp_iterations} iterations.
- {MLP}: 2 × 64 tanh, {effort.mlp_steps} steps of Adam with at most 200 samples each, no early stopping.
"""
    tables = "".join(f"\n## {sheet.title}\n\n{sheet.markdown()}\n" for sheet in sheets)
    remarks = "".join(f"- {note}\n" for note in notes)
    return intro + tables + (f"\nNotes:\n\n{remarks}" if remarks else "")


def _counts(data: DataSet) -> str:
    training, held_out = (sum(len(t.inputs) for t in trials) for trials in (data.training, data.held_out))
    return (
        f"{len(data.joints)} joints; {len(data.training)} trials of {training:,} samples for training, "
        f"{len(data.held_out)} of {held_out:,} held out"
    )


def main() -> None:
    """Run everything, print the tables and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="all trials only, with weaker baselines")
    parser.add_argument("--out", type=Path, help="Markdown; without --quick docs/learners_benchmark.md")
    options = parser.parse_args()
    effort, parts = (QUICK, PARTS[-1:]) if options.quick else (Effort(), PARTS)
    out = options.out or (None if options.quick else ROOT / "docs" / "learners_benchmark.md")
    notes: list[str] = []
    results: list[Result] = []
    with threadpool_limits(1), Progress(transient=True) as progress:
        making = progress.add_task("making data", total=None)
        sets = all_data_sets()
        progress.remove_task(making)
        total = progress.add_task("", total=len(sets) * (len(OURS) + 3) * len(parts))
        for data in sets:
            for name, is_ours, model in models(data, effort, notes.append):
                progress.update(total, description=f"{data.name}: {name}")
                try:
                    results.append(
                        measured(model, name, is_ours, data, parts, lambda: progress.advance(total))
                    )
                except TelError as error:
                    notes.append(f"{name} on {data.name} failed: {error}")
    sheets = [figures_sheet(results), ratios_sheet(results)]
    if len(parts) > 1:
        sheets.append(growth_sheet(results, parts))
    console = Console(width=max(Console().width, WIDTH))
    for sheet in sheets:
        console.print(sheet.shown())
    for note in notes:
        console.print(f"Note: {note}", highlight=False, markup=False)
    if out is not None:
        out.write_text(page(sheets, sets, effort, notes), encoding="utf-8")
        console.print(f"Written to {out}", highlight=False, markup=False)


if __name__ == "__main__":
    main()
