"""The summary of a practice run: one row a trial, for people and scripts."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

from tel_ros.core.config import Config
from tel_ros.core.errors import InputFileError
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.recording.config_file import to_plain
from tel_ros.recording.run_folder import SUMMARY_FILE, read_summary, write_summary


@dataclass(frozen=True, kw_only=True)
class TrialRow(TrialReport):
    """A row of ``summary.json``, keys as there: how a trial went, why it was done, what was learned from it.

    NaN where the row has no number. ``warning`` is about the course of learning, e.g. lock-up.
    """

    reason: str = ""
    path: str | None = None
    """Which; None: there is one."""
    went_back_to: int | None = None
    expected_rms_rad: float = math.nan
    effort_share: float | None = None
    """How much of the effort limits the movement might use; None: its duration was given."""
    possible_s: float = math.nan
    rms_command_change_rad: float = math.nan
    training_rms_before_rad: float = math.nan
    training_rms_after_rad: float = math.nan
    grown: tuple[str, ...] = ()
    warning: str = ""
    bag: str = ""
    wall_s: float = math.nan

    @classmethod
    def of(cls, done: PractisedTrial[Any], bag: str, wall_s: float = math.nan) -> Self:
        """Return the row of a trial; ``wall_s``: what it took by the wall clock, learning included."""
        return cls(
            **{field.name: getattr(done.report, field.name) for field in fields(TrialReport)},
            reason=done.plan.reason,
            path=done.plan.movement.path or None,
            went_back_to=done.plan.go_back_to,
            expected_rms_rad=done.plan.expected_rms_rad,
            effort_share=done.plan.movement.effort_share,
            possible_s=done.plan.possible_s,
            warning=done.warning,
            bag=bag,
            wall_s=wall_s,
            **(asdict(done.training) if done.training else {}),
        )

    @property
    def completed(self) -> bool:
        """Whether the trial ran to its end."""
        return self.outcome == Outcome.COMPLETED

    @property
    def was_learned_from(self) -> bool:
        """Whether the network was trained on it."""
        return math.isfinite(self.training_rms_after_rad)

    @property
    def reached_run(self) -> bool:
        """Whether it reached its movement: the error is known from RUN alone."""
        return math.isfinite(self.rms_error_rad)


def read_rows(folder: Path) -> tuple[tuple[TrialRow, ...], str, str]:
    """Return the trials in the summary of a run, its outcome and its message.

    Raises:
        InputFileError: there is no summary, or it is not readable.
    """
    summary = read_summary(folder)
    try:
        trials = tuple(TrialRow.from_plain(row) for row in summary["trials"])
        return trials, str(summary.get("outcome", "unknown")), str(summary.get("message") or "")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        found = "not readable: its trials do not have what a trial has"
        raise InputFileError(folder / SUMMARY_FILE, found, "the summary of a practice run") from error


class RunSummary:
    """Grows trial by trial and is written after each; ``config`` is that which the run's folder holds."""

    def __init__(self, folder: Path, config: Config) -> None:
        self._folder, self._config = folder, config
        self.rows: list[TrialRow] = []
        self.outcome, self.message = "running", ""

    def add(self, row: TrialRow) -> None:
        """Append a trial and write the summary."""
        self.rows.append(row)
        self.write()

    def end(self, outcome: str, message: str) -> None:
        """Say how the run ended and write the summary."""
        self.outcome, self.message = outcome, message
        self.write()

    def write(self) -> None:
        """Write ``summary.json``."""
        write_summary(
            self._folder,
            {
                "run": self._folder.name,
                "config": to_plain(self._config),
                "outcome": self.outcome,
                "message": self.message,
                "trials": [row.to_plain() for row in self.rows],
            },
        )
