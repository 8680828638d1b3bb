"""What the page says in words, as HTML. Texts from outside may hold anything and are escaped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from tel_ros.app.tables import fixed
from tel_ros.core.trial import Outcome, Phase

if TYPE_CHECKING:
    from tel_interfaces.action import Practice
    from tel_interfaces.msg import TrialResult

    from tel_ros.app.view.graph import GraphView

SILENCE_S = 1.0
"""Without a joint state for this long, the page says that its picture is old."""
_TABLE_STYLE = (
    "<style>.tel{border-collapse:collapse;width:100%;font-size:12px;font-variant-numeric:tabular-nums}"
    ".tel th,.tel td{text-align:right;padding:1px 5px}.tel th{font-weight:600;border-bottom:1px solid #8886}"
    ".tel td:last-child{text-align:left;color:#777}</style>"
)


def trials_html(trials: Sequence[tuple[TrialResult, str]], effort_limit_nm: Sequence[float]) -> str:
    """Return the table of the trials that have ended, each with its reason, the newest first."""
    rows = ""
    for trial, reason in reversed(trials):
        shares = [100.0 * nm / limit for nm, limit in zip(trial.max_effort_nm, effort_limit_nm, strict=False)]
        share, joint = max(zip(shares, trial.joint_names, strict=False), default=(math.nan, ""))
        ended = "" if trial.outcome == Outcome.COMPLETED else Outcome(trial.outcome).text
        times = f"{trial.alpha:.3f}", f"{trial.duration_s:.2f}"
        cells = (
            f"{trial.index}",
            *times,
            fixed(trial.rms_error_rad, 4),
            fixed(trial.max_error_rad, 3),
            f"{fixed(share, 0)} % {escape(joint)}",
            ended,
        )
        rows += f'<tr title="{escape(reason)}">{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
    if not rows:
        return '<p data-testid="trials">No trial has ended since this page was opened.</p>'
    headings = ("trial", "α", "time s", "RMS rad", "max rad", "torque", "")
    head = f"<tr>{''.join(f'<th>{heading}</th>' for heading in headings)}</tr>"
    return f'{_TABLE_STYLE}<table class="tel" data-testid="trials">{head}{rows}</table>'


def status_html(graph: GraphView, said: Practice.Feedback) -> str:
    """Return the status of the run and of the arm: what is heard from the graph, and the run's feedback."""
    lines = []
    if graph.stopped:
        lines.append(_line("stopped", "EMERGENCY STOP: nothing moves before the reset", "#c92a2a"))
    if (age_s := graph.arm_age_s) > SILENCE_S:
        since = f"for {age_s:.0f} s" if math.isfinite(age_s) else "yet"
        lines.append(_line("silence", f"no joint states {since}: what you see is not what is", "#c92a2a"))
    if graph.paused:
        what = "paused" if said.stage == "paused" else "pauses after this trial"
        lines.append(_line("paused", what, "#e67700"))
    # A strategy that gives reasons decides as it goes: the number of trials is a guess.
    total = f"about {said.trials}" if said.reason else f"{said.trials}"
    about = f"trial {said.trial} of {total} · α {said.alpha:.3f}" if said.trial else "no trial"
    lines.append(f'<div style="font-size:18px" data-testid="trial">{about}</div>')
    phase = Phase(graph.sample.phase if graph.sample is not None else Phase.IDLE)
    lines.append(
        f'<div data-testid="phase">{escape(said.stage or "–")} · {phase.name.lower()} · '
        f"{fixed(said.duration_s, 2)} s · error up to {fixed(said.max_error_rad, 3)} rad</div>"
    )
    if graph.answer:
        lines.append(_line("answer", graph.answer, "#c92a2a" if graph.alarm else "#2b8a3e"))
    return f'<div data-testid="status" style="font-size:13px;line-height:1.5">{"".join(lines)}</div>'


def _line(name: str, text: str, colour: str) -> str:
    return f'<div data-testid="{name}" style="color:{colour};font-weight:700">{escape(text)}</div>'
