"""Writing the trials of a run into one MCAP file, with what other programs need to show them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from heapq import merge
from pathlib import Path

from rosbags.interfaces import Connection

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording.any_bag import AnyBag, open_any_bag, profiles, reading
from tel_ros.recording.bag_format import offered_qos
from tel_ros.recording.bag_inspection import inspect_bag
from tel_ros.recording.bag_writer import BagWriter
from tel_ros.recording.export import added_messages as added
from tel_ros.recording.run_folder import is_run_folder, trial_bags
from tel_ros.recording.trial_bag import RecordedTrial, read_trial

_SYNC_S = 60.0
"""The file is flushed to the disk this often; after a crash the export can be repeated."""
GAP_NS = NS_PER_S
"""Left before a trial whose time had to be moved."""


@dataclass(frozen=True)
class ExportedTrial:
    """Where a trial is in the file: times of its first and last message there, and what was added to them."""

    bag: Path
    index: int
    begin_s: float
    end_s: float
    shift_s: float


@dataclass(frozen=True)
class Export:
    """What was written: a rosbag2 folder, and the MCAP file in it.

    ``counts``: messages in the file by topic. ``left_out``: bags of the run that are not in it, and why.
    """

    folder: Path
    file: Path
    arm: added.ExportedArm
    counts: dict[str, int]
    trials: tuple[ExportedTrial, ...]
    left_out: dict[Path, str]


class _LeftOutError(Exception):
    """A bag that does not get into the file; says why."""


def export(source: Path, out: Path) -> Export:
    """Write a run, or a single trial, into one MCAP file, which is also a rosbag2 folder.

    Everything that was recorded is there byte by byte, with its definition; what is added to it lies on
    topics of its own (:data:`.added_messages.ADDED`). Times are the recorded ones as long as they do not go
    back from one trial to the next (:class:`Timeline`). BagError: there is neither run nor bag, no trial of
    it is whole, or the folder exists or cannot be written; or, also as ConfigError, about the arm's
    description.
    """
    if out.exists():
        raise BagError(out, "exists already", "a folder that is new")
    is_run = is_run_folder(source)
    bags = trial_bags(source) if is_run else [source]
    if not bags:
        raise BagError(source, "has no trial", "a run with at least one")
    left_out: dict[Path, str] = {}
    run: _RunWriter | None = None
    try:
        with ExitStack() as stack:
            for bag in bags:
                try:
                    trial = _whole_trial(bag)
                    if run is None:
                        arm = added.exported_arm(bag, trial.metadata)
                        recording = RecordingConfig(chunk_s=_SYNC_S)
                        writer = BagWriter(out, {"exported": source.resolve().name}, recording)
                        run = _RunWriter(stack.enter_context(writer), arm)
                    run.add(trial)
                except _LeftOutError as error:
                    left_out[bag] = str(error)
            if run is None or not run.trials:
                if not is_run:
                    raise BagError(source, left_out[source], "the whole bag of a trial")
                why = "; ".join(f"{bag.name} {problem}" for bag, problem in left_out.items())
                raise BagError(source, f"has no trial that is whole ({why})", "at least one")
    except BaseException:
        if run is not None:
            run.writer.discard()  # it can be exported again
        raise
    return Export(out, out / f"{out.name}.mcap", run.arm, run.writer.counts, tuple(run.trials), left_out)


def _whole_trial(bag: Path) -> RecordedTrial:
    try:
        inspected = inspect_bag(bag)
        if inspected.wholeness.is_good:
            return read_trial(bag)
    except BagError as error:
        raise _LeftOutError(error.found) from error
    raise _LeftOutError(f"is {inspected.wholeness.name.lower()} ({inspected.problem})")


class Timeline:
    """Places trials one after another; each keeps its recorded time if that comes after the trial before it.

    Where the clock was set back or began anew, trials overlap: the first such one is moved to :data:`GAP_NS`
    after the trial before it, and all later ones by as much.
    """

    def __init__(self) -> None:
        self._shift_ns = 0
        self._end_ns: int | None = None

    def place(self, first_ns: int, last_ns: int) -> int:
        """Return what to add [ns] to the times of the next trial, given those of its two ends."""
        if self._end_ns is not None and first_ns + self._shift_ns < self._end_ns:
            self._shift_ns = self._end_ns + GAP_NS - first_ns
        self._end_ns = last_ns + self._shift_ns
        return self._shift_ns


@dataclass
class _RunWriter:
    """Writes the trials of one arm after another."""

    writer: BagWriter
    arm: added.ExportedArm
    trials: list[ExportedTrial] = field(default_factory=list)
    _timeline: Timeline = field(default_factory=Timeline)
    _types: dict[str, str] = field(default_factory=dict)

    def add(self, trial: RecordedTrial) -> None:
        """Append a trial; _LeftOutError, with nothing written, if it does not fit the arm or the topics."""
        joints, expected = (", ".join(each.joints) for each in (trial, self.arm.config))
        if joints != expected:
            raise _LeftOutError(f"is of the joints {joints}, not {expected}")
        with open_any_bag(trial.bag) as reader:
            self._announce(reader)
            # For rosbags, the end is the nanosecond after the last message.
            shift_ns = self._timeline.place(reader.start_time, reader.end_time - 1)
            begin_ns, end_ns = reader.start_time + shift_ns, reader.end_time - 1 + shift_ns
            if not self.trials:
                for topic, time_ns, raw in added.messages_of_arm(self.arm, begin_ns):
                    self.writer.write(topic, time_ns, raw)
            made = added.messages_of_trial(trial, self.arm, begin_ns, end_ns, shift_ns)
            for topic, time_ns, raw in merge(
                made, _recorded(reader, shift_ns), key=lambda message: message[1]
            ):
                self.writer.write(topic, time_ns, raw)
        span_s = (begin_ns / NS_PER_S, end_ns / NS_PER_S, shift_ns / NS_PER_S)
        self.trials.append(ExportedTrial(trial.bag, trial.report.index, *span_s))

    def _announce(self, reader: AnyBag) -> None:
        """Announce the topics of a bag that are new; with the first bag also those that are added."""
        types, new = dict(self._types), dict[str, tuple[Connection, tuple[str, str]]]()
        for connection in reader.connections:
            if connection.topic in added.ADDED:
                raise _LeftOutError(f"has a topic {connection.topic}, which the export adds")
            defined = reader.definition(connection)
            if types.setdefault(connection.topic, defined[1]) != defined[1]:
                found = f"defines {connection.msgtype} on {connection.topic} otherwise than before"
                raise _LeftOutError(found)
            if connection.topic not in self._types:
                new.setdefault(connection.topic, (connection, defined))
        self._types = types
        for connection, defined in new.values():
            self.writer.add_topic(connection.topic, connection.msgtype, profiles(connection), defined)
        if not self.trials:
            for topic, kind in added.ADDED.items():
                qos = offered_qos(topic, latched=topic not in added.STREAMED)
                self.writer.add_topic(topic, kind, [qos])


def _recorded(reader: AnyBag, shift_ns: int) -> Iterator[added.Added]:
    with reading(reader.bag):
        for connection, time_ns, raw in reader.messages():
            yield connection.topic, time_ns + shift_ns, raw
