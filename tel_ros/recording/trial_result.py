"""From ``TrialResult``, a message or as read from a bag, to a trial's report and back, by field names."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Container
from dataclasses import fields
from typing import Any

import numpy as np

from tel_ros.core.trial import LoopTiming, Outcome, TrialReport
from tel_ros.recording.cdr import time_ns

_MESSAGE_NAME = {"warning": "timing_warning"}
"""Fields of the timing that the message names differently. Stamps ``x_ns`` are ``x_stamp`` there."""
_NOT_MEASURED = {"int": 0, "float": math.nan, "str": ""}
"""What the timing's fields of the message hold in lockstep, by type."""


def result_fields(report: TrialReport, to_time: Callable[[int], Any]) -> dict[str, Any]:
    """Return the fields of a ``TrialResult``, all but ``joint_names``; ``to_time`` makes a stamp of ns."""
    values: dict[str, Any] = {}
    for field in fields(report):
        value = getattr(report, field.name)
        if field.name == "timing":
            values |= timing_fields(value)
        elif field.name.endswith("_ns"):
            values[field.name.removesuffix("_ns") + "_stamp"] = to_time(value)
        elif isinstance(value, np.ndarray):
            values[field.name] = array("d", value.tobytes())
        else:
            values[field.name] = int(value) if isinstance(value, Outcome) else value
    return values


def timing_fields(timing: LoopTiming | None) -> dict[str, Any]:
    """Return the fields of a ``TrialResult`` that say how regular the loop was; None: not measured."""
    return {
        _MESSAGE_NAME.get(field.name, field.name): (
            _NOT_MEASURED[str(field.type)] if timing is None else getattr(timing, field.name)
        )
        for field in fields(LoopTiming)
    }


def report_of(result: Any) -> TrialReport:
    """Return the report in a ``TrialResult``, of an earlier version as well."""
    # Bags from before results had a timing have no such fields; NaN says that it was not measured.
    measured = not math.isnan(getattr(result, "jitter_max_s", math.nan))
    values: dict[str, Any] = {"timing": LoopTiming(**_read(LoopTiming, result)) if measured else None}
    for name in (field.name for field in fields(TrialReport) if field.name.endswith("_ns")):
        values[name] = time_ns(getattr(result, name.removesuffix("_ns") + "_stamp"))
    return TrialReport(**values, **_read(TrialReport, result, left_out=values))


_READERS: dict[str, Callable[[Any], Any]] = {
    "int": int,
    "float": float,
    "str": str,
    "Outcome": Outcome,
    "FloatArray": np.array,
}


def _read(record: type, result: Any, left_out: Container[str] = ()) -> dict[str, Any]:
    """Return the fields of a record that the message has under the same names."""
    return {
        field.name: _READERS[str(field.type)](getattr(result, _MESSAGE_NAME.get(field.name, field.name)))
        for field in fields(record)
        if field.name not in left_out
    }
