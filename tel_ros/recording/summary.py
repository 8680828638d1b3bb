"""The summary of a practice run: one row a trial, for people and scripts."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tel_ros.core.config import Config
from tel_ros.core.practice.decisions import PlannedTrial
from tel_ros.core.trial import TrialReport
from tel_ros.recording.config_file import to_plain
from tel_ros.recording.run_folder import write_summary


@dataclass
class TrialRow:
    """One trial, with what was learned from it (NaN where nothing was)."""

    plan: PlannedTrial
    report: TrialReport
    bag: str
    wall_s: float
    training_rms_before_rad: float = float("nan")
    training_rms_after_rad: float = float("nan")
    rms_command_change_rad: float = float("nan")
    grown: list[str] = field(default_factory=list)
    warning: str = ""
    """What there is to say about the course of learning, e.g. that it has locked up."""

    def as_dict(self) -> dict[str, Any]:
        """Return the row with the keys of ``summary.json``."""
        report = self.report
        return {
            "index": report.index,
            "alpha": report.alpha,
            "duration_s": report.duration_s,
            "reason": self.plan.reason,
            "went_back_to": self.plan.go_back_to,
            "expected_rms_rad": self.plan.expected_rms_rad,
            "rms_error_rad": report.rms_error_rad,
            "rms_error_per_joint_rad": report.rms_error_per_joint_rad.tolist(),
            "max_error_rad": report.max_error_rad,
            "max_effort_nm": report.max_effort_nm.tolist(),
            "saturated_ratio": report.saturated_ratio,
            "rms_command_change_rad": self.rms_command_change_rad,
            "training_rms_before_rad": self.training_rms_before_rad,
            "training_rms_after_rad": self.training_rms_after_rad,
            "grown": self.grown,
            "warning": self.warning,
            # None in lockstep: equal runs have equal summaries.
            "timing": None if report.timing is None else asdict(report.timing),
            "outcome": report.outcome.name.lower(),
            "message": report.message,
            "bag": self.bag,
            "ticks": report.ticks,
            "wall_s": self.wall_s,
        }


class RunSummary:
    """Grows trial by trial and is written after each of them.

    Args:
        folder: of the run.
        config: of the run, as written into its folder.
    """

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
                "trials": [row.as_dict() for row in self.rows],
            },
        )
