"""The loop's figures in the result of a trial, as a message or as read from a bag."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from tel_ros.core.trial import LoopTiming

TIMING_FIELDS = (
    "state_rate_hz",
    "stamp_rate_hz",
    "jitter_p50_s",
    "jitter_p99_s",
    "jitter_max_s",
    "response_p99_s",
    "response_max_s",
)
"""Fields of ``TrialResult`` that are NaN where the loop was not measured."""


def timing_fields(timing: LoopTiming | None) -> dict[str, Any]:
    """Return the fields of a ``TrialResult`` that tell how regular the loop was; None: not measured."""
    if timing is None:
        return {**dict.fromkeys(TIMING_FIELDS, math.nan), "missed_ticks": 0, "timing_warning": ""}
    values = asdict(timing)
    warning = values.pop("warning")
    return {**values, "timing_warning": warning}


def recorded_timing(result: Any) -> LoopTiming | None:
    """Return how regular the loop was.

    Args:
        result: a ``TrialResult``, of an earlier version as well.

    Returns:
        None if it was not measured.
    """
    # Bags from before results had them have no such fields.
    values = {name: float(getattr(result, name, math.nan)) for name in TIMING_FIELDS}
    if math.isnan(values["jitter_max_s"]):
        return None
    return LoopTiming(**values, missed_ticks=int(result.missed_ticks), warning=str(result.timing_warning))
