"""Numbers and sentences of a report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tel_ros.app.report.data import DrawnTrial, RunData
from tel_ros.app.tables import NOTHING
from tel_ros.core.errors import counted
from tel_ros.recording.summary import TrialRow


def significant(value: float, digits: int = 3) -> str:
    """Return a number for running text, without exponents: 0.00192, 0.0500, 11.5; a dash for NaN."""
    if not math.isfinite(value):
        return NOTHING
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def seconds(value: float) -> str:
    """Return a duration with its unit, with one decimal, or two if the second is not zero."""
    return f"{value:.2f}".removesuffix("0") + "\N{NO-BREAK SPACE}s" if math.isfinite(value) else NOTHING


def enumeration(words: Sequence[str]) -> str:
    """Return words in one phrase: ``a``, ``a and b``, ``a, b and c``."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last


def run_line(run: RunData) -> str:
    """Return what kind of run it was."""
    config = run.config
    arm = f"{config.arm.name} ({'simulated' if config.run.arm == 'sim' else 'external'} arm)"
    path = ", ".join(config.path.names) or config.path.name or config.path.file.rpartition("/")[2]
    path = f"path{'s' if config.path.files else ''} {path}"
    strategy = config.practice.strategy.replace("_", " ")
    if config.practice.strategy == "trajectory_extension" and not config.practice.durations_s:
        strategy += f", even steps in {config.practice.spacing}"
    learner = f"{config.learning.name} ({config.learning.weights})"
    training = f"{config.learning.training} trajectory training"
    return f"{arm} · {path} · {strategy} · {learner} · {training} · seed {config.seed}"


_ENDED = {
    "stopped": "stopped before its goal",
    "aborted": "was aborted",
    "cancelled": "was cancelled",
    "failed": "failed",
}


def ending(run: RunData) -> str:
    """Return how the run ended."""
    done, practice = sum(trial.completed for trial in run.trials), run.config.practice
    message = run.message.rstrip(".")
    # A strategy that has come to its end needed no more trials than it made.
    over = run.outcome in ("completed", "stopped")
    of_each = len(practice.durations_s) or practice.trials
    planned = len(run.trials) if over else of_each * max(1, len(run.config.path.names))
    trials = f"{done} of {counted(planned, 'trial')} completed"
    if run.outcome == "running":
        return f"The run did not come to its end (its summary still says that it is running); {trials}."
    parts = [message, trials]
    if run.outcome != "completed":
        ended = f"The run {_ENDED.get(run.outcome, f'ended as “{run.outcome}”')}"
        parts[0] = f"{ended}: {message}" if message and message.lower() != ended.lower() else ended
    return " ".join(f"{part}." for part in parts if part)


def result(run: RunData) -> str:
    """Return the first, best and final error, and the gain in speed; of several paths, of each."""
    if run.config.path.files and any(trial.path for trial in run.trials):
        of_paths = {name: run.of_path(name) for name in run.config.path.names}
        return " ".join(f"{name}: {_result(of)}" for name, of in of_paths.items() if of.trials)
    return _result(run)


def _result(run: RunData) -> str:
    moved = [trial for trial in run.trials if trial.reached_run]
    if not moved:
        return "The movement did not begin in any trial, so there is no error to report."
    if len(moved) == 1:
        return f"RMS tracking error: {_error(moved[0])}."
    completed = [trial for trial in moved if trial.completed]
    # Half a movement is neither the best nor the fastest.
    best = min(completed or moved, key=lambda trial: trial.rms_error_rad)
    found = f"RMS tracking error: {_error(moved[0])} at first, {_error(best)} at best, "
    found += f"{_error(moved[-1])} in the end."
    if len(completed) < 2:
        return found
    first_s, shortest_s = moved[0].duration_s, min(trial.duration_s for trial in completed)
    faster = first_s / shortest_s
    if abs(faster - 1.0) < 1e-6:
        return f"{found} The speed stayed the same: {seconds(shortest_s)} a trial."
    times = f"{significant(faster, 2)} times as fast"
    return f"{found} From {seconds(first_s)} to {seconds(shortest_s)}, the movement became {times}."


def _error(trial: TrialRow) -> str:
    error = f"{significant(trial.rms_error_rad)}\N{NO-BREAK SPACE}rad"
    how = "" if trial.completed else f", {trial.outcome.text}"
    return f"{error} (trial {trial.index}, {seconds(trial.duration_s)}{how})"


def trial_label(trial: TrialRow) -> str:
    """Return a trial's name for a legend or a title."""
    return f"Trial {trial.index}" + ("" if trial.completed else f", {trial.outcome.text}")


def path_caption(plane: str) -> str:
    """Return the caption of the hand's path; ``plane`` is a sentence about the plane it is drawn in."""
    return (
        "Path of the hand: desired (dotted), actual (solid), and where the equilibrium-point command "
        f"pulls it (grey). {plane} Same scale in all panels."
    )


def tracking_caption(drawn: Sequence[DrawnTrial]) -> str:
    """Return the caption of the tracking error, with an explanation of the bands if there are any."""
    caption = "Tracking error of each joint over the movement, for the same trials."
    banded = [trial for trial in drawn if trial.is_std_known]
    if not banded:
        return caption
    shares = [
        f"{100.0 * trial.share_within_two_std:.0f}\N{NO-BREAK SPACE}% in trial {trial.summary.index}"
        for trial in banded
    ]
    return (
        f"{caption} Each panel has a scale of its own. The band is the error of the command that the network "
        "expected before the trial; through the spring, an error of the command leads to the same error of "
        f"the position at low frequency, so about 95\N{NO-BREAK SPACE}% of the error should lie within the "
        f"band. Found within: {enumeration(shares)}."
    )


def decision(trial: TrialRow) -> str:
    """Return why a trial was chosen, and with which network."""
    if trial.went_back_to is None:
        return trial.reason
    network = f"the network after trial {trial.went_back_to}" if trial.went_back_to else "the first network"
    return f"{trial.reason}, with {network}"


def growth(trial: TrialRow, joints: tuple[str, ...]) -> list[list[str]]:
    """Return what grew in one trial: a list for each joint's network, and one for everything else."""
    columns: list[list[str]] = [[] for _ in range(len(joints) + 1)]
    for item in trial.grown:
        joint, _, what = item.partition(": ")
        if joint in joints and what:
            columns[joints.index(joint)].append(what)
        else:
            columns[-1].append(item)
    return columns
