"""What the page says in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

from tel_ros.app.view.history import number
from tel_ros.core.trial import Phase

SILENCE_S = 1.0
"""Without a joint state for this long, the picture is said to be old."""


@dataclass(frozen=True)
class Status:
    """What is known at a moment. Texts may come from outside and hold anything."""

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
    """Whether the strategy decides as it goes: how many trials it will be is a guess."""
    alarm: bool = False
    """Whether that answer is bad news."""


def status_html(status: Status) -> str:
    """Return the status as HTML; what comes from outside is escaped."""
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
