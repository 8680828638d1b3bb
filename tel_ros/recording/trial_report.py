"""The report of a trial from its result, as a message or as read from a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tel_ros.core.errors import BagError
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.trial_bag import read_topic
from tel_ros.recording.trial_timing import recorded_timing


def to_report(result: Any) -> TrialReport:
    """Return the report in a ``TrialResult``."""
    return TrialReport(
        index=int(result.index),
        alpha=float(result.alpha),
        duration_s=float(result.duration_s),
        outcome=Outcome(result.outcome),
        message=str(result.message),
        start_ns=_time_ns(result.start_stamp),
        run_ns=_time_ns(result.run_stamp),
        end_ns=_time_ns(result.end_stamp),
        ticks=int(result.ticks),
        rms_error_rad=float(result.rms_error_rad),
        rms_error_per_joint_rad=np.array(result.rms_error_per_joint_rad),
        max_error_rad=float(result.max_error_rad),
        max_effort_nm=np.array(result.max_effort_nm),
        saturated_ratio=float(result.saturated_ratio),
        timing=recorded_timing(result),
    )


def read_report(bag: Path) -> TrialReport:
    """Return the report of a recorded trial.

    Raises:
        BagError: there is no closed bag, its data have changed since they were recorded, or it does not hold
            exactly one result.
    """
    results = read_topic(bag, topics.TRIAL_RESULT)
    if len(results) != 1:
        raise BagError(bag, f"holds {len(results)} trial results", "exactly one")
    return to_report(results[0][1])


def _time_ns(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
