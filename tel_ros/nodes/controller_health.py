"""What the controller tells about itself on ``/diagnostics``."""

from __future__ import annotations

from dataclasses import dataclass

from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.nodes.diagnostics import Health, Level


@dataclass(frozen=True, kw_only=True)
class ControllerStatus:
    """What is known when somebody asks how the controller is."""

    lifecycle: str
    refusal: str
    """Why the last transition that was asked for was refused."""
    phase: str
    trial: int
    """Number of the trial that is under way; 0: none."""
    stopped: str
    """Why an emergency stop is latched; empty: none is."""
    reset_name: str
    """The service that ends it."""
    states_topic: str
    commands_topic: str
    states_rate_hz: float
    states_age_s: float
    """Of the newest joint state, since it arrived (wall clock)."""
    states_are_fresh: bool
    listeners: int
    """Subscriptions of the commands."""
    last: TrialReport | None


def controller_health(status: ControllerStatus) -> Health:
    """Return the worst that is to be said, and all that is known."""
    values: dict[str, object] = {
        "lifecycle": status.lifecycle,
        "phase": status.phase,
        "trial": status.trial or "none",
        "emergency_stop": status.stopped or "not latched",
        "states_rate_hz": f"{status.states_rate_hz:.1f}",
        "states_age_s": f"{status.states_age_s:.3f}",
        "listeners_to_commands": status.listeners,
        "last_refusal": status.refusal or "none",
        "last_trial": _told(status.last),
    }
    level, message = _worst(status)
    return Health(level, message, values)


def _worst(status: ControllerStatus) -> tuple[Level, str]:
    if status.stopped:
        return Level.ERROR, f"{status.stopped}; {status.reset_name} ends it"
    if status.lifecycle != "active":
        return Level.WARN, f"{status.lifecycle}: it commands nothing"
    if not status.states_are_fresh:
        return Level.ERROR, f"no joint states on {status.states_topic}"
    if status.listeners == 0:
        return Level.ERROR, f"nobody listens to {status.commands_topic}"
    if status.trial:
        return Level.OK, f"trial {status.trial}: {status.phase}"
    if status.last is not None and status.last.outcome == Outcome.ABORTED:
        return Level.WARN, f"{_told(status.last)}; {status.phase}"
    return Level.OK, status.phase


def _told(report: TrialReport | None) -> str:
    if report is None:
        return "none"
    return f"trial {report.index}: {report.outcome.name}" + (f": {report.message}" if report.message else "")
