"""What ``tel bag info`` says, for people and for scripts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from rich.table import Table

from tel_ros.app.report.text import seconds, significant
from tel_ros.app.tables import table
from tel_ros.core.errors import counted
from tel_ros.core.trial import TrialReport
from tel_ros.core.types import NS_PER_S
from tel_ros.recording.bag_inspection import InspectedBag
from tel_ros.recording.run_folder import json_ready


def plain(bag: InspectedBag) -> dict[str, Any]:
    """Return everything that is known of a bag, ready for JSON."""
    values = asdict(bag) | {
        "path": str(bag.path),
        "wholeness": bag.wholeness.name.lower(),
        "is_good": bag.wholeness.is_good,
        "n_messages": bag.n_messages,
        "trial": bag.trial and {**bag.trial.to_plain(), "joints": bag.joints},
    }
    del values["joints"]
    ready: dict[str, Any] = json_ready(values)
    return ready


def head_lines(bag: InspectedBag) -> Iterator[tuple[str, str]]:
    """Yield heading and text of each line above the table of topics."""
    yield "bag", str(bag.path)
    yield "state", bag.wholeness.value + (f" ({bag.problem})" if bag.problem else "")
    version = "" if bag.version is None else f", rosbag2 version {bag.version}"
    each = f", {bag.size_bytes / bag.n_messages:.0f} bytes a message" if bag.n_messages else ""
    yield "storage", f"{bag.storage or 'unknown'}{version}, {size(bag.size_bytes)}{each}"
    if bag.n_messages:
        yield "time", f"{bag.duration_s:.3f} s from {moment(bag.start_ns)}"
    if bag.trial is not None:
        yield "trial", trial_text(bag.trial)
        yield "joints", ", ".join(bag.joints)
    versions = []
    for key, value in sorted(bag.metadata.items()):
        if key.startswith("version."):
            versions.append(f"{key.removeprefix('version.')} {value}")
        elif "\n" in value or len(value) > 120:
            yield key, f"{len(value.splitlines())} lines, {len(value)} characters (--json shows them)"
        else:
            yield key, value
    if versions:
        yield "versions", ", ".join(versions)


def topic_table(bag: InspectedBag) -> Table:
    """Return one row a topic."""
    rows = []
    for topic in bag.topics:
        count = str(topic.found) if topic.found == topic.announced else f"{topic.found} of {topic.announced}"
        numbers = significant(topic.rate_hz), significant(topic.longest_gap_s)
        rows.append((topic.name, topic.msgtype, count, *numbers))
    headings = ("topic", "type", "messages", "rate Hz", "longest gap s")
    return table(headings, rows, left=("topic", "type"))


def run_table(bags: Sequence[InspectedBag]) -> Table:
    """Return one row a bag."""
    headings = ("bag", "state", "messages", "size", "recorded", "trial", "outcome", "RMS error rad")
    rows = []
    for bag in bags:
        told, trial = ("–", "–", "–"), bag.trial
        if trial:
            told = f"{trial.index}", trial.outcome.text, significant(trial.rms_error_rad)
        state, recorded = bag.wholeness.name.lower(), f"{bag.duration_s:.3f} s"
        rows.append((bag.path.name, state, str(bag.n_messages), size(bag.size_bytes), recorded, *told))
    return table(headings, rows, left=("bag", "state", "outcome"))


def trial_text(trial: TrialReport) -> str:
    """Return a line about a trial."""
    why = f" ({trial.message})" if trial.message else ""
    return (
        f"{trial.index}, {trial.outcome.text}{why}: {seconds(trial.duration_s)}, "
        f"α {significant(trial.alpha)}, "
        f"RMS error {significant(trial.rms_error_rad)} rad, at most {significant(trial.max_error_rad)} rad, "
        f"{counted(trial.ticks, 'tick')}"
    )


def size(n_bytes: int) -> str:
    """Return a size of files for people."""
    return f"{n_bytes / 1e6:.2f} MB" if n_bytes >= 1e6 else f"{n_bytes / 1e3:.1f} kB"


def moment(time_ns: int) -> str:
    """Return a time of day, or a time of simulation as it is."""
    if time_ns < 1_000_000_000 * NS_PER_S:  # before September 2001; simulated time begins at zero
        return f"{time_ns / NS_PER_S:.3f} s (no time of day: that of a simulation)"
    return f"{datetime.fromtimestamp(time_ns / NS_PER_S, UTC):%Y-%m-%d %H:%M:%S} UTC"
