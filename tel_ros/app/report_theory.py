"""A practice run in the terms of the paper's theorems, from its bags and networks."""

from __future__ import annotations

from dataclasses import dataclass

from tel_ros.app.report_data import RunData, TrialSummary
from tel_ros.core.errors import TelError
from tel_ros.core.learning.signals import configured_samples
from tel_ros.core.practice.theory import TheoryEstimate, TheoryMonitor
from tel_ros.recording.network_file import load_network
from tel_ros.recording.run_folder import network_after
from tel_ros.recording.trial_bag import read_trial


@dataclass(frozen=True)
class RunTheory:
    """What can be told of a run.

    Args:
        trials: those that were learned from, as far as bags and networks are there.
        estimates: one for each of them.
        missing: why there is nothing, or not everything; empty if nothing is missing.
    """

    trials: tuple[TrialSummary, ...]
    estimates: tuple[TheoryEstimate, ...]
    missing: str


def run_theory(run: RunData) -> RunTheory:
    """Return what the theorems speak of for all trials of a run that were learned from.

    Bags and networks that cannot be read are said, not fatal: the estimates end before them.
    """
    if not run.varies_speed_alone:
        return RunTheory((), (), "The theorems are measured on runs in which only the speed varies.")
    learned = [trial for trial in run.trials if trial.bag is not None and trial.was_learned_from]
    done: list[TrialSummary] = []
    estimates: list[TheoryEstimate] = []
    monitor: TheoryMonitor | None = None
    latest = 0
    for trial in learned:
        before_index = latest if trial.went_back_to is None else trial.went_back_to
        try:
            before = load_network(network_after(run.folder, before_index))
            after = load_network(network_after(run.folder, trial.index))
            signals = read_trial(run.folder / str(trial.bag)).signals()
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
