"""How well and how fast inverse dynamics are learned: this project's learners beside scikit-learn's.

CPU time is measured on one core, so that the figures hardly depend on what else the machine does.
"""

from __future__ import annotations

import math
import platform
import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version

import click
import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from tel_lab.inverse_dynamics.data_sets import DATA_SETS, DataSet, Trial, stacked
from tel_lab.inverse_dynamics.models import GP, MLP, Effort, Model, all_models
from tel_lab.study import StudyOptions, study
from tel_lab.tables import Column, Table
from tel_ros.core.errors import TelError
from tel_ros.core.types import FloatArray, evenly_spaced

BATCH = 2250
"""Samples of a movement of 4.5 s at 500 Hz: what a trial asks a learner for."""
PARTS = (0.25, 0.5, 1.0)
TIMED_S = 0.05
QUICK = Effort(gp_samples=300, gp_tuning_samples=150, gp_iterations=15, mlp_steps=1000)


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

    ``nmse`` (of the held-out trials, shape (n_parts, n_joints)) and ``training_s`` are for each part of the
    training trials; prediction times are of a sample among ``BATCH``, and alone.
    """

    data: str
    learner: str
    is_ours: bool
    nmse: FloatArray
    training_s: tuple[float, ...]
    batch_us: float
    single_us: float
    size_mb: float


def measured(model: Model, name: str, is_ours: bool, data: DataSet, parts: Sequence[float]) -> Result:
    errors, times = [], []
    for part in parts:
        trials = [
            data.training[i] for i in evenly_spaced(len(data.training), round(part * len(data.training)))
        ]
        start = time.process_time()
        model.fit(trials)
        times.append(time.process_time() - start)
        errors.append(nmse(model, data.held_out))
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


@dataclass(frozen=True)
class Chapter:
    """All learners on one data set: what it is about, results, and notes on learners that cannot be had."""

    about: str
    results: list[Result]
    notes: list[str]


def chapter(name: str, effort: Effort, parts: Sequence[float]) -> Chapter:
    import sklearn.gaussian_process  # noqa: F401 - its libraries have to be loaded to be limited

    results: list[Result] = []
    notes: list[str] = []
    with threadpool_limits(1):
        data = DATA_SETS[name]()
        for learner, is_ours, model in all_models(data, effort, notes.append):
            try:
                results.append(measured(model, learner, is_ours, data, parts))
            except TelError as error:
                notes.append(f"{learner} on {name} failed: {error}")
    return Chapter(f"- *{name}*: {data.about} ({_counts(data)}).", results, notes)


def _short(value: float) -> str:
    """Return two digits, with an exponent only where it is needed."""
    if value != 0.0 and not 1e-3 <= value < 1e5:
        return f"{value:.1e}"
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


NAMES: tuple[Column[Result], ...] = (
    Column("data", lambda r: r.data, left=True),
    Column("learner", lambda r: r.learner, left=True),
)


def number(heading: str, value: Callable[[Result], float]) -> Column[Result]:
    return Column(heading, value, _short)


FIGURES = (
    *NAMES,
    number("nMSE", lambda r: float(r.nmse[-1].mean())),
    number("worst joint", lambda r: float(r.nmse[-1].max())),
    number("training [s]", lambda r: r.training_s[-1]),
    number("batch [µs]", lambda r: r.batch_us),
    number("single [µs]", lambda r: r.single_us),
    number("size [MB]", lambda r: r.size_mb),
)
COMPARED: dict[str, Callable[[Result], float]] = {
    "training": lambda r: r.training_s[-1],
    "batch": lambda r: r.batch_us,
    "nMSE": lambda r: float(r.nmse[-1].mean()),
}


def tables(results: Sequence[Result], parts: Sequence[float]) -> list[Table[Result]]:
    """Return figures, ratios to the two strongest baselines, and growth with the number of trials."""
    found = {(r.data, r.learner): r for r in results}

    def ratio(what: str, baseline: str) -> Column[Result]:
        value = COMPARED[what]
        return number(f"{what} / {baseline}", lambda r: value(r) / value(found[r.data, baseline]))

    def growth(what: str, value: Callable[[int, Result], float]) -> list[Column[Result]]:
        return [number(f"{part:.0%}: {what}", partial(value, i)) for i, part in enumerate(parts)]

    ratios = [*NAMES, *(ratio(what, baseline) for baseline in (GP, MLP) for what in COMPARED)]
    made = [
        Table(FIGURES, results, "Held-out torque error, times and size"),
        Table(ratios, [r for r in results if r.is_ours], "Ours divided by theirs: below 1, ours is better"),
    ]
    if len(parts) > 1:
        grown = growth("nMSE", lambda i, r: float(r.nmse[i].mean()))
        grown += growth("time [s]", lambda i, r: r.training_s[i])
        made.append(Table([*NAMES, *grown], results, "Trained on a part of the trials"))
    return made


def _counts(data: DataSet) -> str:
    training, held_out = (sum(len(t.inputs) for t in trials) for trials in (data.training, data.held_out))
    return (
        f"{len(data.joints)} joints; {len(data.training)} trials of {training:,} samples for training, "
        f"{len(data.held_out)} of {held_out:,} held out"
    )


@study(sets=False)
def learners_benchmark(options: StudyOptions) -> None:
    """Compare how well and how fast learners learn inverse dynamics, in CPU time on one core.

    --only takes data sets. Times are comparable between learners with one job alone.
    """
    effort, parts = (QUICK, PARTS[-1:]) if options.quick else (Effort(), PARTS)
    tasks = {name: (name, effort, parts) for name in options.selected(list(DATA_SETS))}
    chapters = list(options.results(chapter, tasks))
    sheets = tables([result for each in chapters for result in each.results], parts)
    console = Console(width=max(Console().width, 132))
    for sheet in sheets:
        console.print(sheet.terminal())
    notes = [note for each in chapters for note in each.notes]
    for note in notes:
        click.echo(f"Note: {note}")
    options.write(
        "learners_benchmark.md",
        sheets=sheets,
        chapters=chapters,
        notes=notes,
        effort=effort,
        batch=BATCH,
        python=platform.python_version(),
        numpy=np.__version__,
        sklearn=version("scikit-learn"),
    )
