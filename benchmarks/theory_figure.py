"""The figure of the theorems: errors and contraction, trial by trial."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from theory_runs import Measured

from tel_ros.app.plotting import BLUE, GREEN, GREY, INK, ORANGE, PURPLE

Line = tuple[str, Callable[[Measured], float], dict[str, object]]


def _step_mrad(trial: Measured) -> float:
    return 1e3 * trial.true.step_rad if trial.true.step_rad > 0.0 else np.nan


_ERRORS: tuple[Line, ...] = (
    ("tracking error", lambda m: 1e3 * m.rms_error_rad, {"color": INK}),
    ("training error ‖R̂û‖", lambda m: 1e3 * m.fitted.training_error_rad, {"color": GREY, "ls": ":"}),
    (
        "‖Ru‖ estimated",
        lambda m: 1e3 * m.fitted.command_error_rad,
        {"color": ORANGE, "ls": "", "marker": "o"},
    ),
    ("‖Ru‖ true", lambda m: 1e3 * m.true.command_error_rad, {"color": ORANGE}),
    ("(2 k_α + k_N k_p) |Δα|", _step_mrad, {"color": PURPLE, "ls": "--"}),
)
_CONTRACTION: tuple[Line, ...] = (
    ("k_R estimated", lambda m: m.fitted.k_r, {"color": BLUE, "ls": "", "marker": "o"}),
    ("k_R true", lambda m: m.true.k_r, {"color": BLUE}),
    ("1 - γ + γ k_R", lambda m: m.true.theorem_1, {"color": GREEN, "ls": "--"}),
    ("contraction that came", lambda m: m.true.contraction, {"color": INK}),
)


def figure(runs: Mapping[str, Sequence[Measured]]) -> Figure:
    """Draw errors above, contraction below, one column a run."""
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
        axes.plot([t.index for t in trials], [value(t) for t in trials], ms=3.5, label=label, **style)
