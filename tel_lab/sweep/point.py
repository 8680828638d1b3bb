"""One point of a sweep: a practice run without ROS, and the numbers that are kept of it."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tel_ros.core.config import Config
from tel_ros.core.errors import TelError
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.core.trial import Outcome, Trial
from tel_ros.recording.network_file import new_network
from tel_ros.recording.waypoint_file import load_path

if TYPE_CHECKING:
    from tel_ros.core.practice.session import PractisedTrial

FAILED = "failed"
"""Outcome of a point that could not be practised to an end; its measures are of the trials until then."""


MEASURES = (
    "outcome",
    "message",
    "trials",
    "arm_s",
    "rms_first_rad",
    "rms_final_rad",
    "rms_best_at_goal_rad",
    "max_error_rad",
    "aborts",
    "goal_reached",
    "duration_reached_s",
    "warned_trial",
    "warning",
    "goal_effort_ratio",
    "wall_s",
)
"""Columns of the table after those that tell points apart.

- ``arm_s``: time that passed for the arm.
- ``rms_first_rad``, ``rms_final_rad``: RMS tracking error of the first and of the last trial; None if it was
  not completed.
- ``rms_best_at_goal_rad``: the smallest one of the completed trials of the goal movement.
- ``max_error_rad``: the largest deviation of a joint in all trials, aborted ones included.
- ``goal_reached``: whether a trial of the goal movement was completed.
- ``duration_reached_s``: of the fastest completed trial.
- ``warned_trial``: the first one after which practice seemed to lead nowhere, by lock-up or divergence.
- ``warning``: what there was to say of that after the last trial.
- ``goal_effort_ratio``: the effort that the goal movement needs on this arm, as a share of the effort limit;
  above 1 no command can do it.
"""


def run_point(config: Config) -> dict[str, Any]:
    """Practise; return a value for each of :data:`MEASURES`, None where there is none; errors are results."""
    started = time.monotonic()
    try:
        result = _practised(config)
    except TelError as error:
        result = failure(str(error))
    return {**result, "wall_s": round(time.monotonic() - started, 3)}


def failure(message: str) -> dict[str, Any]:
    return {**dict.fromkeys(MEASURES), "outcome": FAILED, "message": message}


def _practised(config: Config) -> dict[str, Any]:
    # Late: the physics are loaded in workers, not by the command line.
    from tel_lab.exact_model import ExactInverseDynamics
    from tel_lab.offline import OfflinePractice
    from tel_lab.trial_record import effort_share

    path, exact = load_path(config.path, config.arm), ExactInverseDynamics(config, config.sim)
    # At 100 Hz: often enough to find the peak of the effort of a smooth movement.
    effort_ratio = effort_share(config.arm, exact, path, config.practice.goal_duration_s, 100.0)
    with OfflinePractice(config, path, new_network(config)) as practice:
        try:
            practice.run()
            assert practice.ending is not None  # it has run
            outcome, message = str(practice.ending.outcome), practice.ending.message
        except TelError as error:
            if not practice.done:
                raise
            outcome, message = FAILED, str(error)
    return {
        "outcome": outcome,
        "message": message,
        **_of_trials(practice.done),
        **_warnings(practice.done, config.practice.tolerance_rad),
        "goal_effort_ratio": _number(effort_ratio),
    }


def _of_trials(done: Sequence[PractisedTrial[Trial]]) -> dict[str, Any]:
    reports = [practised.report for practised in done]
    completed = [practised for practised in done if practised.report.outcome == Outcome.COMPLETED]
    at_goal = [p.report.rms_error_rad for p in completed if p.plan.alpha >= 1.0 - 1e-9]
    first, last = reports[0], reports[-1]
    deviations_rad = [r.max_error_rad for r in reports if math.isfinite(r.max_error_rad)]
    return {
        "trials": len(reports),
        "arm_s": round(1e-9 * sum(report.end_ns - report.start_ns for report in reports), 6),
        "rms_first_rad": _number(first.rms_error_rad) if first.outcome == Outcome.COMPLETED else None,
        "rms_final_rad": _number(last.rms_error_rad) if last.outcome == Outcome.COMPLETED else None,
        "rms_best_at_goal_rad": min(map(float, at_goal), default=None),
        "max_error_rad": max(map(float, deviations_rad), default=None),
        "aborts": sum(report.outcome == Outcome.ABORTED for report in reports),
        "goal_reached": bool(at_goal),
        "duration_reached_s": min((p.plan.movement.duration_s for p in completed), default=None),
    }


def _warnings(done: Sequence[PractisedTrial[Trial]], tolerance_rad: float) -> dict[str, Any]:
    monitor, said = LockUpMonitor(tolerance_rad), []
    for practised in done:
        learned = practised.training
        errors = (math.nan, math.nan)
        if learned:
            errors = learned.training_rms_before_rad, learned.training_rms_after_rad
        said.append(monitor.after_trial(practised.plan.alpha, practised.report.rms_error_rad, *errors))
    first = next((number for number, text in enumerate(said, start=1) if text), None)
    return {"warned_trial": first, "warning": said[-1]}


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
