"""Where a practice run stands between two trials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from tel_ros.core.config import Config
from tel_ros.core.practice.decisions import Forecaster, Strategy
from tel_ros.core.practice.lock_up import LockUpMonitor
from tel_ros.core.practice.strategy import make_strategy
from tel_ros.core.trial import TrialReport
from tel_ros.recording.summary import TrialRow


@dataclass(frozen=True)
class RunState:
    """What decides how a run goes on.

    Args:
        strategy: as it is before it decides what comes next.
        lock_up: has seen all trials.
        rows: of the summary.
        last: report of the last trial; None: there was none.
        network: file of the network as it is now; None: the one that a run begins with.
        forecast: asks that file what to expect of a movement; None: ask the network itself.
    """

    strategy: Strategy
    lock_up: LockUpMonitor
    rows: tuple[TrialRow, ...] = ()
    last: TrialReport | None = None
    network: Path | None = None
    forecast: Forecaster | None = None

    @classmethod
    def new(cls, config: Config) -> Self:
        """Return the state in which a run begins."""
        return cls(make_strategy(config), LockUpMonitor(config.practice.tolerance_rad))
