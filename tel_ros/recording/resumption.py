"""Bringing the folder of an interrupted run in order, so that it goes on after its last whole trial."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, InputFileError
from tel_ros.core.practice.decisions import Ending
from tel_ros.core.trial import Outcome
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.earlier_trials import earlier_trials
from tel_ros.recording.network_file import load_network, save_network
from tel_ros.recording.retraining import require_trainable
from tel_ros.recording.run_folder import (
    CONFIG_FILE,
    LOG_FOLDER,
    NETWORK_FILE,
    SUMMARY_FILE,
    read_summary,
    trial_bag,
    trial_bags,
    written_config,
)
from tel_ros.recording.summary import RunSummary
from tel_ros.recording.trial_report import read_report

SET_ASIDE = "set_aside"
"""Folder in a run's folder: what an interrupted run has left and a resumed one does not go on from."""

_ENDED = ("completed", "stopped", "aborted")


@dataclass(frozen=True)
class Resumption:
    """What a resumed run goes on from.

    Args:
        trials: number of whole trials.
        set_aside: what was moved, and why: new place to reason.
    """

    trials: int
    set_aside: dict[Path, str]


def resumed_config(folder: Path) -> Config:
    """Return the configuration of a run that is to go on, with absolute file names.

    Raises:
        InputFileError: the folder holds no run, or its files are not readable.
        ConfigError: its configuration is wrong.
    """
    if not (folder / CONFIG_FILE).is_file():
        found = f"has no {CONFIG_FILE}" if folder.is_dir() else "there is no such folder"
        raise InputFileError(folder, found, "the folder of a practice run")
    return load_config(folder / CONFIG_FILE)


def prepare_to_resume(folder: Path, config: Config) -> Resumption:
    """Bring the folder of an interrupted run in order. No node of it may be running.

    What cannot be gone on from (a bag that was never closed, a trial that was cancelled, a last bag that is
    damaged, the logs) is moved to ``set_aside/``, never deleted. A trial that was recorded but not learned
    from to the end is learned from again.

    Args:
        folder: of the run.
        config: as returned by :func:`resumed_config`.

    Raises:
        InputFileError: the run is finished, or its files do not fit together; nothing was moved.
    """
    bags, cut_off = _whole_bags(folder)
    earlier = earlier_trials(folder, config, bags)
    if (folder / SUMMARY_FILE).exists():
        summary = read_summary(folder)
        ended = summary.get("outcome") in _ENDED
        assert earlier.forecast is not None
        if ended and isinstance(earlier.strategy.next(earlier.last, earlier.forecast), Ending):
            found = f"the run is finished: {summary['outcome']}, {len(bags)} trials"
            raise InputFileError(folder, found, "a run that was interrupted")
    moved = dict(_moved(folder, path, why) for path, why in {**cut_off, **_leftovers(folder)}.items())
    if not any((folder / UNFINISHED).glob("*")) and (folder / UNFINISHED).is_dir():
        (folder / UNFINISHED).rmdir()
    if earlier.network is not None:
        save_network(load_network(earlier.network), folder / NETWORK_FILE)
    again = RunSummary(folder, written_config(folder))
    again.rows = list(earlier.rows)
    again.write()
    return Resumption(len(bags), moved)


def _whole_bags(folder: Path) -> tuple[list[Path], dict[Path, str]]:
    """Return the bags to go on from, and the last one if it is none of them, with the reason."""
    bags, cut_off = trial_bags(folder), {}
    if bags:
        why_not = _why_not(bags[-1])
        if why_not:
            cut_off[bags.pop()] = why_not
    for index, bag in enumerate(bags, start=1):
        if bag != trial_bag(folder, index):
            raise BagError(
                trial_bag(folder, index), "there is no such folder", f"one, as {bag.name} is there"
            )
        why_not = _why_not(bag)
        if why_not:
            raise BagError(bag, why_not, "a whole trial: another one follows")
    return bags, cut_off


def _why_not(bag: Path) -> str:
    """Return why a run cannot go on from a trial; empty: it can."""
    try:
        require_trainable(bag)
        report = read_report(bag)
    except BagError as error:
        return error.found
    if report.outcome in (Outcome.CANCELLED, Outcome.REFUSED):
        return f"was {report.outcome.name.lower()}"
    return ""


def _leftovers(folder: Path) -> dict[Path, str]:
    left = dict.fromkeys(sorted((folder / UNFINISHED).glob("*")), "was never closed")
    if (folder / LOG_FOLDER).is_dir():
        left[folder / LOG_FOLDER] = "logs of before"
    return left


def _moved(folder: Path, path: Path, why: str) -> tuple[Path, str]:
    """Move something aside under a name that is free."""
    target, n = folder / SET_ASIDE / path.name, 1
    target.parent.mkdir(exist_ok=True)
    while target.exists():
        n += 1
        target = folder / SET_ASIDE / f"{path.name}.{n}"
    path.rename(target)
    return target, why
