"""Theorems 1 to 3 measured: every constant trial by trial, as estimated on an arm and as it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import click
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import Column, Table, filled, of_texts
from tel_lab.theory.constants import TheoryEstimate, TheoryMonitor
from tel_ros.app.plotting import BLUE, GREEN, GREY, INK, ORANGE, PURPLE
from tel_ros.core.learning.learner import Learner
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.core.trial import TrialReport
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

TOLERANCE_RAD = 0.005


DIRECT = ("paper.yaml", "practice.strategy=direct", "practice.on_abort=continue")
RUNS = {
    "solved trees, rising speed": ("planar_arm.yaml", "practice.strategy=trajectory_extension"),
    "LMS trees, rising speed": ("paper.yaml",),
    "narrow Gaussians, goal speed at once": (
        *DIRECT,
        "practice.trials=12",
        "learning.gaussians_per_input=40",
    ),
    "desired training, goal speed at once": (*DIRECT, "practice.trials=5", "learning.training=desired"),
}
"""File in config/, and what is changed in it."""


@dataclass(frozen=True)
class Measured:
    """One trial, judged three times, and what the lock-up monitor said.

    ``fitted``: as on an arm; ``true``: with the exact inverse dynamics; ``network``: with the network after
    training as the model.
    """

    report: TrialReport
    fitted: TheoryEstimate
    true: TheoryEstimate
    network: TheoryEstimate
    message: str


def measure(name: str, overrides: Sequence[str]) -> list[Measured]:
    """Practise and estimate; trials that nothing was learned from are left out."""
    file, *settings = RUNS[name]
    config = load_config(ROOT / "config" / file, [*settings, *overrides])
    before: Learner = new_network(config)
    with OfflinePractice(config, load_path(config.path, config.arm), before) as practice:
        done = practice.run()
    exact = ExactInverseDynamics(config, config.sim)
    units, training = before.context.input_range, config.learning.training
    fitted, true = TheoryMonitor(units, training), TheoryMonitor(units, training, exact.predict)
    lock_up = LockUpMonitor(TOLERANCE_RAD)
    measured = []
    for trial in done:
        if trial.training is None:
            continue
        signals, report, outcome = learning_record(trial.trial), trial.report, trial.training
        after = practice.after[trial.plan.index]
        samples = configured_samples(signals, config.learning)
        given = (trial.plan.alpha, trial.plan.movement.own_duration_s, signals, samples, before, after)
        network = TheoryMonitor(units, training, after.predict)
        learned_rad = outcome.training_rms_before_rad, outcome.training_rms_after_rad
        said = lock_up.after_trial(report.alpha, report.rms_error_rad, *learned_rad)
        judged = [judge.after_trial(*given) for judge in (fitted, true, network)]
        measured.append(Measured(report, judged[0], judged[1], judged[2], said))
        before = after
    return measured


def number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"


def pairs(heading: str, name: str, scale: float = 1.0) -> Column[Measured]:
    """Return a column of a figure as estimated and as it is: ``estimate / truth``."""

    def pair(trial: Measured) -> str:
        return " / ".join(number(scale * getattr(judged, name)) for judged in (trial.fitted, trial.true))

    return Column(heading, pair)


def column(heading: str, value: Callable[[Measured], float]) -> Column[Measured]:
    return Column(heading, value, number)


TRIAL: tuple[Column[Measured], ...] = (
    Column("trial", lambda trial: trial.report.index, left=True),
    Column("α", lambda trial: trial.fitted.alpha, ".3f", left=True),
)
ERRORS = [
    *TRIAL,
    column("tracking", lambda trial: 1e3 * trial.report.rms_error_rad),
    column("‖R̂û‖", lambda trial: 1e3 * trial.fitted.training_error_rad),
    pairs("‖Ru‖", "command_error_rad", 1e3),
    pairs("‖Ru‖ after", "command_error_after_rad", 1e3),
    pairs("k_R", "k_r"),
    column("γ", lambda trial: trial.fitted.rate),
    pairs("Theorem 1", "theorem_1"),
    pairs("came", "contraction"),
    pairs("Theorem 2", "theorem_2"),
]
"""Errors and contraction of each trial; all errors in mrad."""
CONSTANTS = [
    *TRIAL,
    column("k_N", lambda trial: trial.fitted.k_n),
    column("k_L", lambda trial: trial.fitted.k_l),
    pairs("k_x", "k_x"),
    pairs("k_u", "k_u"),
    pairs("k_α", "k_alpha"),
    pairs("k_p", "k_p"),
    pairs("step", "step_rad", 1e3),
    pairs("Theorem 3", "theorem_3_rad", 1e3),
    column("‖Ru‖ came", lambda trial: 1e3 * trial.true.command_error_rad),
    column("tracking", lambda trial: 1e3 * trial.report.rms_error_rad),
]
"""The constants of each trial and what Theorem 3 makes of them, in mrad."""


def quality_table(runs: dict[str, list[Measured]]) -> str:
    """Return how far estimates are from the truth: median and largest deviation."""

    def cell(trials: Sequence[Measured], judge: str, name: str) -> str:
        ratios = [getattr(getattr(t, judge), name) / getattr(t.true, name) for t in trials]
        finite = [abs(ratio - 1.0) for ratio in ratios if np.isfinite(ratio)]
        return f"{np.median(finite):.0%} / {max(finite):.0%}" if finite else "–"

    names = {"‖Ru‖": "command_error_rad", "‖Ru‖ after": "command_error_after_rad", "k_R": "k_r"}
    plant = {"k_x": "k_x", "k_u": "k_u", "k_α": "k_alpha", "k_p": "k_p"}
    rows = [
        [symbol, judge, *(cell(trials, attribute, name) for trials in runs.values())]
        for judge, attribute, wanted in (("fitted", "fitted", names | plant), ("network", "network", names))
        for symbol, name in wanted.items()
    ]
    return of_texts(["", "model", *runs], rows, 2).markdown()


def bounds_table(runs: dict[str, list[Measured]]) -> str:
    """Return how often each theorem's right-hand side was above what came, and how far above."""

    def cell(trials: Sequence[Measured], ratio: Callable[[Measured], float]) -> str:
        ratios = [value for value in map(ratio, trials) if np.isfinite(value) and value > 0.0]
        if not ratios:
            return "–"
        return f"{sum(r >= 1.0 for r in ratios)} of {len(ratios)}, × {np.median(ratios):.3g}"

    def share(trials: Sequence[Measured]) -> str:
        stepped = [trial.true for trial in trials if trial.true.command_step_rad > 0.0]
        shares = [true.command_error_rad / true.command_step_rad for true in stepped]
        return f"{np.median(shares):.1%} ({min(shares):.1%} to {max(shares):.0%})" if shares else "–"

    ratios: dict[str, Callable[[Measured], float]] = {
        "Theorem 1": lambda m: m.true.theorem_1 / m.true.contraction,
        "Theorem 2": lambda m: m.true.theorem_2 / m.true.contraction,
        "Theorem 3": lambda m: _after_step(m, m.true.theorem_3_rad / m.true.command_error_rad),
        "its step alone": lambda m: _after_step(m, m.true.step_rad / m.true.command_error_rad),
    }
    rows = [[name, *(cell(trials, ratio) for trials in runs.values())] for name, ratio in ratios.items()]
    rows.append(["command not foreseen", *map(share, runs.values())])
    return of_texts(["", *runs], rows).markdown()


def _after_step(trial: Measured, ratio: float) -> float:
    return ratio if trial.true.command_step_rad > 0.0 else np.nan


Line = tuple[str, Callable[[Measured], float], dict[str, Any]]
_DOTS = {"ls": "", "marker": "o"}
_ERRORS: tuple[Line, ...] = (
    ("tracking error", lambda m: 1e3 * m.report.rms_error_rad, {"color": INK}),
    ("training error ‖R̂û‖", lambda m: 1e3 * m.fitted.training_error_rad, {"color": GREY, "ls": ":"}),
    ("‖Ru‖ estimated", lambda m: 1e3 * m.fitted.command_error_rad, {"color": ORANGE, **_DOTS}),
    ("‖Ru‖ true", lambda m: 1e3 * m.true.command_error_rad, {"color": ORANGE}),
    ("(2 k_α + k_N k_p) |Δα|", lambda m: 1e3 * (m.true.step_rad or np.nan), {"color": PURPLE, "ls": "--"}),
)
_CONTRACTION: tuple[Line, ...] = (
    ("k_R estimated", lambda m: m.fitted.k_r, {"color": BLUE, **_DOTS}),
    ("k_R true", lambda m: m.true.k_r, {"color": BLUE}),
    ("1 - γ + γ k_R", lambda m: m.true.theorem_1, {"color": GREEN, "ls": "--"}),
    ("contraction that came", lambda m: m.true.contraction, {"color": INK}),
)


def figure(runs: Mapping[str, Sequence[Measured]]) -> Figure:
    drawing = Figure(figsize=(2.9 * len(runs), 5.6), layout="constrained")
    axes = drawing.subplots(2, len(runs), squeeze=False)
    for (name, trials), above, below in zip(runs.items(), axes[0], axes[1], strict=True):
        _draw(above, trials, _ERRORS)
        above.set_yscale("log")
        above.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=10))
        above.yaxis.set_major_formatter(FuncFormatter(lambda mrad, _: f"{mrad:g}"))
        above.yaxis.set_minor_formatter(NullFormatter())
        above.set_title(name)
        _draw(below, trials, _CONTRACTION)
        below.axhline(1.0, color=GREY, lw=0.6)
        below.set_ylim(bottom=0.0)
        below.set_xlabel("trial")
        for axis in (above.xaxis, below.xaxis):
            axis.set_major_locator(MaxNLocator(integer=True))
    axes[0, 0].set_ylabel("mrad")
    axes[1, 0].set_ylabel("factor")
    handles = [handle for row in axes for handle in row[0].get_legend_handles_labels()[0]]
    drawing.legend(handles=handles, loc="outside lower center", ncols=5)
    return drawing


def _draw(axes: Axes, trials: Sequence[Measured], lines: Sequence[Line]) -> None:
    for label, value, style in lines:
        axes.plot([t.report.index for t in trials], [value(t) for t in trials], ms=3.5, label=label, **style)


@study()
def theory_measured(options: StudyOptions) -> None:
    """Measure the constants of the theorems in some practice runs.

    --only takes the names of the runs; --set changes all of them.
    """
    names = options.selected(list(RUNS))
    if options.quick:
        names = names[1:2] or names
    found = options.results(measure, {name: (name, options.overrides) for name in names})
    runs = dict(zip(names, found, strict=True))
    page = {
        "runs": runs,
        "settings": RUNS,
        "quality": quality_table(runs),
        "bounds": bounds_table(runs),
        "errors": lambda trials: Table(ERRORS, trials).markdown(),
        "constants": lambda trials: Table(CONSTANTS, trials).markdown(),
        "tolerance_rad": TOLERANCE_RAD,
    }
    click.echo(filled("theory_measured.md", command=options.command, **page))
    options.write("theory_measured.md", {"theory": partial(figure, runs)}, ["png"], **page)
