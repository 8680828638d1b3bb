"""Theorems 1 to 3 measured: every constant trial by trial, estimated as on an arm and from the exact model.

    .venv/bin/python benchmarks/theory.py

Prints tables and writes them to docs/theory_measured.md, with docs/figures/theory.png. Takes two minutes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from practice import markdown
from theory_figure import figure
from theory_runs import ROOT, RUNS, TOLERANCE_RAD, Measured, Run, measure

from tel_ros.app.plotting import figure_style, save_figure


def number(value: float) -> str:
    """Return three digits, or a dash for what is not known."""
    return f"{value:.3g}" if np.isfinite(value) else "–"


def pair(trial: Measured, name: str, scale: float = 1.0) -> str:
    """Return an estimate and the truth: ``estimate / truth``."""
    return " / ".join(number(scale * getattr(judged, name)) for judged in (trial.fitted, trial.true))


def errors_table(trials: Sequence[Measured]) -> str:
    """Return errors and contraction of each trial; all errors in mrad."""
    columns = (
        "trial",
        "α",
        "tracking",
        "‖R̂û‖",
        "‖Ru‖",
        "‖Ru‖ after",
        "k_R",
        "γ",
        "Theorem 1",
        "came",
        "Theorem 2",
    )
    rows = [
        [
            str(trial.index),
            f"{trial.fitted.alpha:.3f}",
            number(1e3 * trial.rms_error_rad),
            number(1e3 * trial.fitted.training_error_rad),
            pair(trial, "command_error_rad", 1e3),
            pair(trial, "command_error_after_rad", 1e3),
            pair(trial, "k_r"),
            number(trial.fitted.rate),
            pair(trial, "theorem_1"),
            pair(trial, "contraction"),
            pair(trial, "theorem_2"),
        ]
        for trial in trials
    ]
    return markdown(rows, columns)


def constants_table(trials: Sequence[Measured]) -> str:
    """Return the constants of each trial and what Theorem 3 makes of them, in mrad."""
    columns = (
        "trial",
        "α",
        "k_N",
        "k_L",
        "k_x",
        "k_u",
        "k_α",
        "k_p",
        "step",
        "Theorem 3",
        "‖Ru‖ came",
        "tracking",
    )
    rows = [
        [
            str(trial.index),
            f"{trial.fitted.alpha:.3f}",
            number(trial.fitted.k_n),
            number(trial.fitted.k_l),
            *(pair(trial, name) for name in ("k_x", "k_u", "k_alpha", "k_p")),
            pair(trial, "step_rad", 1e3),
            pair(trial, "theorem_3_rad", 1e3),
            number(1e3 * trial.true.command_error_rad),
            number(1e3 * trial.rms_error_rad),
        ]
        for trial in trials
    ]
    return markdown(rows, columns)


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
    return markdown(rows, ["", "model", *runs])


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
    return markdown(rows, ["", *runs])


def _after_step(trial: Measured, ratio: float) -> float:
    return ratio if trial.true.command_step_rad > 0.0 else np.nan


def document(runs: dict[str, list[Measured]]) -> str:
    """Return the page with all tables."""
    head = f"""# The theorems, measured

Made by `benchmarks/theory.py`; [theory.md](theory.md) explains symbols, units and what to make of it.
`a / b`: estimated as on an arm / from the simulated arm's exact inverse dynamics. Errors in mrad.

![errors and contraction](figures/theory.png)

## How good the estimates are

Deviation from the truth, median / largest. *fitted*: u from the fitted straight-line model; *network*: from
the network after training.

{quality_table(runs)}

## How tight the bounds are

With the true constants: in how many trials the right-hand side was at least what came, and the median of
their ratio. Theorems 1 and 2: the factor of ‖Ru‖ in a trial's training. Theorem 3: against ‖Ru‖ of the trial
after a step. *Command not foreseen*: that ‖Ru‖ as a share of the change of command that the step needed,
k_α |Δα|; median and range.

{bounds_table(runs)}
"""
    return "\n".join([head, *(chapter(run, runs[run.name]) for run in RUNS if run.name in runs)])


def chapter(run: Run, trials: Sequence[Measured]) -> str:
    """Return the tables of one run."""
    said = [f"- after trial {trial.index}: {trial.message}" for trial in trials if trial.message]
    return f"""## {run.name[0].upper()}{run.name[1:]}

{", ".join(f"`{text}`" for text in (f"config/{run.config}", *run.overrides))}

{errors_table(trials)}

{constants_table(trials)}

Lock-up monitor, tolerance {1e3 * TOLERANCE_RAD:.0f} mrad:

{chr(10).join(said or ["- silent"])}
"""


def main() -> None:
    """Measure all runs, print the page and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [run.name for run in RUNS]
    parser.add_argument("--runs", nargs="+", default=names, choices=names)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "theory_measured.md")
    options = parser.parse_args()
    runs = {}
    for run in (run for run in RUNS if run.name in options.runs):
        print(run.name, file=sys.stderr)
        runs[run.name] = measure(run)
    page = document(runs)
    print(page)
    options.out.write_text(page, encoding="utf-8")
    drawing = options.out.parent / "figures" / "theory.png"
    drawing.parent.mkdir(exist_ok=True)
    with figure_style("theory"):
        save_figure(figure(runs), drawing)


if __name__ == "__main__":
    main()
