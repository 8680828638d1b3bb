"""What the page says in words, as HTML. Texts from outside may hold anything and are escaped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from tel_ros.app.view.live_trial import EndedTrial
from tel_ros.core.trial import Phase

SILENCE_S = 1.0
"""Without a joint state for this long, the page says that its picture is old."""
_TABLE_STYLE = (
    "<style>.tel{border-collapse:collapse;width:100%;font-size:12px;font-variant-numeric:tabular-nums}"
    ".tel th,.tel td{text-align:right;padding:1px 5px}.tel th{font-weight:600;border-bottom:1px solid #8886}"
    ".tel td:last-child{text-align:left;color:#777}</style>"
)


def trials_html(trials: Sequence[EndedTrial]) -> str:
    """Return the table of the trials that have ended, the newest first."""
    rows = "".join(map(_row, reversed(trials)))
    if not rows:
        return '<p data-testid="trials">No trial has ended since this page was opened.</p>'
    head = "<tr><th>trial</th><th>α</th><th>time s</th><th>RMS rad</th><th>max rad</th><th></th></tr>"
    return f'{_TABLE_STYLE}<table class="tel" data-testid="trials">{head}{rows}</table>'


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
    """Return a number, or a dash if it is not known."""
    return f"{value:.{decimals}f}" if math.isfinite(value) else "–"


@dataclass(frozen=True)
class Status:
    """What is known at a moment."""

    arm_age_s: float
    """Since the last joint state came; inf: none has."""
    phase: Phase
    trial: int
    trials: int
    stage: str
    alpha: float
    duration_s: float
    max_error_rad: float
    progress: float
    stopped: bool
    paused: bool
    answer: str
    """The last answer to a button."""
    is_open_ended: bool = False
    """Whether the strategy decides as it goes, so that the number of trials is a guess."""
    alarm: bool = False
    """Whether that answer is bad news."""


def status_html(status: Status) -> str:
    """Return the status of the run and of the arm."""
    lines = []
    if status.stopped:
        lines.append(_line("stopped", "EMERGENCY STOP: nothing moves before the reset", "#c92a2a"))
    if status.arm_age_s > SILENCE_S:
        since = f"for {status.arm_age_s:.0f} s" if math.isfinite(status.arm_age_s) else "yet"
        lines.append(_line("silence", f"no joint states {since}: what you see is not what is", "#c92a2a"))
    if status.paused:
        what = "paused" if status.stage == "paused" else "pauses after this trial"
        lines.append(_line("paused", what, "#e67700"))
    total = f"about {status.trials}" if status.is_open_ended else f"{status.trials}"
    about = f"trial {status.trial} of {total}" if status.trial else "no trial"
    lines.append(
        f'<div style="font-size:18px" data-testid="trial">{about}'
        f"{f' · α {status.alpha:.3f}' if status.trial else ''}</div>"
    )
    lines.append(
        f'<div data-testid="phase">{escape(status.stage or "–")} · {status.phase.name.lower()} · '
        f"{number(status.duration_s, 2)} s · error up to {number(status.max_error_rad, 3)} rad</div>"
    )
    if status.answer:
        lines.append(_line("answer", status.answer, "#c92a2a" if status.alarm else "#2b8a3e"))
    return f'<div data-testid="status" style="font-size:13px;line-height:1.5">{"".join(lines)}</div>'


def _line(name: str, text: str, colour: str) -> str:
    return f'<div data-testid="{name}" style="color:{colour};font-weight:700">{escape(text)}</div>'
