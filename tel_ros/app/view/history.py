"""The trials that have ended: their paths, and the table of them."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from html import escape

from tel_ros.app.view.live_trial import LiveTrial
from tel_ros.core.types import FloatArray

KEPT_PATHS = 8
"""How many earlier paths are drawn; more hide each other."""


@dataclass(frozen=True)
class EndedTrial:
    """One row of the table. ``outcome`` and ``reason`` come from outside and may hold anything."""

    index: int
    alpha: float
    duration_s: float
    rms_error_rad: float
    max_error_rad: float
    outcome: str
    reason: str = ""


class History:
    """The trials of the present run that have been seen to end."""

    def __init__(self) -> None:
        self.trials: list[EndedTrial] = []
        self.paths: deque[tuple[int, FloatArray]] = deque(maxlen=KEPT_PATHS)
        """Number of the trial and positions of the hand [m], shape (n, 3), NaN in gaps; oldest first."""

    def end(self, ended: EndedTrial, live: LiveTrial | None) -> None:
        """Take in a trial that has ended.

        A number that has been there begins a new run; a row that is the last one already was told twice.

        Args:
            ended: its row.
            live: what was seen of it, if it was.
        """
        if self.trials and ended == self.trials[-1]:
            return
        if self.trials and ended.index <= self.trials[-1].index:
            self.trials.clear()
            self.paths.clear()
        self.trials.append(ended)
        if live is not None and live.index == ended.index and len(live.hand_m) > 1:
            self.paths.append((ended.index, live.hand_m))

    def table(self) -> str:
        """Return the table as HTML, the newest trial first."""
        rows = "".join(_row(trial) for trial in reversed(self.trials))
        if not rows:
            return '<p data-testid="trials">No trial has ended since this page was opened.</p>'
        head = "<tr><th>trial</th><th>α</th><th>time s</th><th>RMS rad</th><th>max rad</th><th></th></tr>"
        style = (
            "<style>.tel{border-collapse:collapse;width:100%;font-size:12px;"
            "font-variant-numeric:tabular-nums}.tel th,.tel td{text-align:right;padding:1px 5px}"
            ".tel th{font-weight:600;border-bottom:1px solid #8886}"
            ".tel td:last-child{text-align:left;color:#777}</style>"
        )
        return f'{style}<table class="tel" data-testid="trials">{head}{rows}</table>'


def _row(trial: EndedTrial) -> str:
    note = trial.outcome if trial.outcome != "completed" else ""
    cells = (
        str(trial.index),
        f"{trial.alpha:.3f}",
        f"{trial.duration_s:.2f}",
        number(trial.rms_error_rad, 4),
        number(trial.max_error_rad, 3),
        escape(note),
    )
    return f'<tr title="{escape(trial.reason)}">{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'


def number(value: float, decimals: int) -> str:
    """Return a number, or a dash for one that is not known."""
    return f"{value:.{decimals}f}" if math.isfinite(value) else "–"
