"""Rebuilding a network from bags alone."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tel_ros.core.errors import InputFileError
from tel_ros.recording.config_file import with_overrides
from tel_ros.recording.network_file import revision, save_network
from tel_ros.recording.new_network import new_network
from tel_ros.recording.provenance import unpacked_config
from tel_ros.recording.retraining import Lesson, bags_of, relearned, require_trainable

_CHANGEABLE = ("learning", "seed")


@dataclass(frozen=True)
class Retraining:
    """What came out of learning from bags.

    Args:
        network: the file.
        revision: of the network in it.
        lessons: one row a bag, values that JSON can hold.
        differs_at: the first bag that was commanded by another network than there was here; empty: none. If
            the settings were the recorded ones, the network is then not that of the run.
        unknown: whether some bag does not tell which network commanded it.
    """

    network: Path
    revision: str
    lessons: tuple[dict[str, Any], ...]
    differs_at: str
    unknown: bool

    @property
    def as_recorded(self) -> bool:
        """Whether each trial was commanded by the network that there was here before it."""
        return not self.differs_at and not self.unknown

    def as_dict(self) -> dict[str, Any]:
        """Return what ``tel train --json`` prints."""
        return {
            "network": str(self.network),
            "revision": self.revision,
            "as_recorded": self.as_recorded,
            "differs_at": self.differs_at,
            "bags": list(self.lessons),
        }


def train(
    paths: Sequence[Path],
    out: Path,
    overrides: Sequence[str] = (),
    *,
    force: bool = False,
    on_lesson: Callable[[Path], None] = lambda bag: None,
) -> Retraining:
    """Learn from bags, in their order, and write the network.

    Configuration, URDF, waypoints and the network that the run began with are taken from the first bag.

    Args:
        paths: bags, or folders of runs.
        out: file of the network.
        overrides: other settings of the learner, as for ``--set``.
        force: whether an existing file may be replaced.
        on_lesson: called after each bag.

    Raises:
        InputFileError: ``out`` exists or cannot be written; a bag cannot be used (BagError), or is of another
            arm than the first.
        ConfigError: a setting is wrong.
        TrainingError: a trial cannot be learned from.
    """
    if out.exists() and not force:
        raise InputFileError(out, "exists already", "a file that is new (option --out), or --force")
    bags = bags_of(paths)
    lessons: list[Lesson] = []
    with tempfile.TemporaryDirectory(prefix="tel_train_") as folder:
        config = unpacked_config(bags[0], require_trainable(bags[0]), Path(folder))
        config = with_overrides(config, overrides, _CHANGEABLE, str(bags[0]))
        learner = new_network(config)
        rows = []
        for lesson in relearned(bags, config, learner):
            learner = lesson.learner
            lessons.append(lesson)
            rows.append(_row(lesson))
            on_lesson(lesson.trial.bag)
    save_network(learner, out)
    return Retraining(
        network=out,
        revision=revision(learner),
        lessons=tuple(rows),
        differs_at=next(
            (row["bag"] for row in rows if row["network_before"] != row["commanded_by"] != ""), ""
        ),
        unknown=any(not row["commanded_by"] for row in rows),
    )


def _row(lesson: Lesson) -> dict[str, Any]:
    """Return a lesson with the keys of a row of ``summary.json``, as far as both have them."""
    trial, training = lesson.trial, lesson.training
    error_rad = trial.position_rad[trial.run] - trial.desired[trial.run, : len(trial.joints)]
    return {
        "bag": str(trial.bag),
        "index": trial.report.index,
        "duration_s": trial.report.duration_s,
        "outcome": trial.report.outcome.text,
        "rms_error_rad": math.sqrt((error_rad**2).mean()) if error_rad.size else None,
        "training_rms_before_rad": training.rms_before_rad if training else None,
        "training_rms_after_rad": training.rms_after_rad if training else None,
        "rms_command_change_rad": training.rms_command_change_rad if training else None,
        "grown": list(training.grown) if training else [],
        "commanded_by": lesson.recorded_revision,
        "network_before": lesson.revision,
        "note": lesson.note,
    }
