"""A practice run in the terms of the paper's theorems, from its bags and networks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from tel_lab.theory.constants import TheoryEstimate, TheoryMonitor
from tel_ros.app.plotting import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, WIDTH_IN
from tel_ros.app.report.data import RunData
from tel_ros.app.report.figures import over_trials
from tel_ros.app.report.page import Content, Section, block
from tel_ros.core.errors import TelError
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.recording.network_file import load_network
from tel_ros.recording.run_folder import network_after
from tel_ros.recording.summary import TrialRow
from tel_ros.recording.trial_bag import read_trial


@dataclass(frozen=True)
class RunTheory:
    """What can be told of a run: an estimate a trial that was learned from, and why some are missing."""

    trials: tuple[TrialRow, ...]
    estimates: tuple[TheoryEstimate, ...]
    missing: str


def run_theory(run: RunData) -> RunTheory:
    """Return what the theorems speak of for all trials of a run that were learned from.

    Bags and networks that cannot be read are said, not fatal: the estimates end before them.
    """
    if not run.varies_speed_alone:
        return RunTheory((), (), "The theorems are measured on runs in which only the speed varies.")
    learned = [trial for trial in run.trials if trial.bag and trial.was_learned_from]
    done: list[TrialRow] = []
    estimates: list[TheoryEstimate] = []
    monitor: TheoryMonitor | None = None
    latest = 0
    for trial in learned:
        before_index = latest if trial.went_back_to is None else trial.went_back_to
        try:
            before = load_network(network_after(run.folder, before_index))
            after = load_network(network_after(run.folder, trial.index))
            signals = learning_record(read_trial(run.folder / trial.bag))
            monitor = monitor or TheoryMonitor(before.context.input_range, run.config.learning.training)
            samples = configured_samples(signals, run.config.learning)
            estimate = monitor.after_trial(trial.alpha, trial.duration_s, signals, samples, before, after)
        except TelError as error:
            why = str(error).replace(f"{run.folder}/", "")
            return RunTheory(tuple(done), tuple(estimates), f"Nothing from trial {trial.index} on: {why}.")
        done.append(trial)
        estimates.append(estimate)
        latest = trial.index
    missing = "" if done else "No trial of this run was learned from."
    return RunTheory(tuple(done), tuple(estimates), missing)


def theory(run: RunData) -> Content:
    found = run_theory(run)
    if not found.estimates:
        return Content(caption=found.missing)
    rows = list(zip(found.trials, found.estimates, strict=True))
    return Content(
        theory_figure(found.trials, found.estimates),
        "What the paper's theorems are about. Left: the error of the command, which causes the tracking "
        "error and on an arm can only be estimated, and what Theorem 3 allows a step in speed to add to it. "
        "Right: training is sure to help only where k_R is below 1. Near 1 the network learns where the arm "
        "goes instead of where it should go. " + found.missing,
        block("theory.html.j2", "theory", Path(__file__).parent, rows=rows),
    )


SECTION = Section("theory", "What the theorems say", theory, "theory")


def theory_figure(trials: Sequence[TrialRow], estimates: Sequence[TheoryEstimate]) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 2.9), layout="constrained")
    errors, factors = figure.subplots(1, 2)
    steps = [e.step_rad if e.step_rad > 0.0 else math.nan for e in estimates]
    over_trials(
        errors,
        trials,
        [
            (steps, "allowed for the step", PURPLE, "v"),
            ([e.tracking_error_rad for e in estimates], "tracking", BLUE, "o"),
            ([e.training_error_rad for e in estimates], "training", GREEN, "s"),
            ([e.command_error_rad for e in estimates], "command, estimated", ORANGE, "^"),
        ],
        log=True,
    )
    errors.set(title="Errors and the bound of Theorem 3", ylabel="RMS [rad]")
    over_trials(
        factors,
        trials,
        [
            ([e.k_r for e in estimates], "k_R", BLUE, "o"),
            ([e.theorem_1 for e in estimates], "1 − γ + γ k_R", GREEN, "s"),
            ([e.contraction for e in estimates], "what training made of it", INK, "^"),
        ],
        log=False,
    )
    factors.axhline(1.0, color=GREY, linewidth=0.8)
    factors.set(title="Contraction of the command error", ylabel="factor")
    factors.set_ylim(bottom=0.0)
    return figure
