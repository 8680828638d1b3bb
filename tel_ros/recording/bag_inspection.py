"""What a bag holds, and whether it is whole: a trial's, or anybody's."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection

from tel_ros.core.errors import BagError, TelError, counted
from tel_ros.core.trial import TrialReport
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import any_bag, topics
from tel_ros.recording.any_bag import AnyBag
from tel_ros.recording.bag_writer import CHECKSUMS, RECOVERED, UNFINISHED
from tel_ros.recording.data_files import data_kind
from tel_ros.recording.trial_bag import check_sums
from tel_ros.recording.trial_result import report_of

STORAGE_OF = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "rosbag1"}


class Wholeness(Enum):
    """Whether a bag is what was recorded; the value says so to people."""

    WHOLE = "whole: its data are as they were recorded"
    COMPLETE = "complete: all messages are there; without checksums nobody knows whether they have changed"
    RECOVERED = "recovered from an unfinished recording: its end is missing"
    UNFINISHED = "unfinished: it was never closed"
    BROKEN = "broken"

    @property
    def is_good(self) -> bool:
        """Whether nothing is missing and nothing known to be wrong."""
        return self in (Wholeness.WHOLE, Wholeness.COMPLETE)


@dataclass(frozen=True)
class InspectedTopic:
    """A topic of a bag: how many messages the bag announces, and how many can be read.

    ``rate_hz`` and ``longest_gap_s``: NaN for fewer than two messages. ``latched``: for late joiners of a
    replay.
    """

    name: str
    msgtype: str
    announced: int
    found: int
    rate_hz: float
    longest_gap_s: float
    latched: bool


@dataclass(frozen=True)
class InspectedBag:
    """What is to be said about a bag: ``problem`` in words, topics by name, ``trial`` if it is one's.

    ``storage``: ``mcap``, ``sqlite3`` or ``rosbag1``. ``version``: of the rosbag2 metadata; None: there are
    none.
    """

    path: Path
    wholeness: Wholeness
    problem: str = ""
    storage: str = ""
    version: int | None = None
    size_bytes: int = 0
    start_ns: int = 0
    duration_s: float = 0.0
    topics: tuple[InspectedTopic, ...] = ()
    trial: TrialReport | None = None
    joints: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def n_messages(self) -> int:
        """Messages that can be read."""
        return sum(topic.found for topic in self.topics)


def inspect_bag(bag: Path) -> InspectedBag:
    """Read all of a bag and tell what there is and what is wrong; BagError if it is none."""
    is_closed = not bag.is_dir() or (bag / any_bag.METADATA_FILE).is_file()
    try:
        data = any_bag.data_files(bag)
    except BagError:
        if not bag.is_dir() or not is_closed:
            raise
        data = []  # opening it says what is wrong
    files = [file for file in bag.iterdir() if file.is_file()] if bag.is_dir() else [bag]
    known: dict[str, Any] = {
        "path": bag,
        "storage": STORAGE_OF[data_kind(data[0])] if data else "",
        "size_bytes": sum(file.stat().st_size for file in files),
    }
    if not is_closed:
        found = f"it has no {any_bag.METADATA_FILE}; `tel bag recover` takes out what can be read"
        return InspectedBag(wholeness=Wholeness.UNFINISHED, problem=found, **known)
    with suppress(BagError):  # the data tell enough
        information = any_bag.bag_information(bag)
        known["metadata"] = any_bag.custom_data(information)
        known["version"] = int(information["version"]) if str(information.get("version")).isdigit() else None
    try:
        with any_bag.open_any_bag(bag) as reader, any_bag.reading(bag):
            known |= _topics(reader) | _trial(reader)
    except BagError as error:
        return InspectedBag(wholeness=Wholeness.BROKEN, problem=error.found, **known)
    wholeness, problem = _wholeness(bag, known["topics"], known.get("metadata", {}))
    return InspectedBag(wholeness=wholeness, problem=problem, **known)


def bags_of_run(folder: Path) -> list[Path]:
    """Return the bags in the folder of a run: of its trials, then the unfinished and the recovered ones."""
    places = (folder.glob("trial_*"), (folder / UNFINISHED).glob("*"), (folder / RECOVERED).glob("*"))
    return [path for place in places for path in sorted(place) if path.is_dir()]


def _topics(reader: AnyBag) -> dict[str, Any]:
    """Return time of the first message, duration, and what there is of each topic."""
    times_ns = defaultdict[int, list[int]](list)
    for connection, time_ns, _ in reader.messages():
        times_ns[connection.id].append(time_ns)

    def inspected(connection: Connection) -> InspectedTopic:
        times = times_ns.get(connection.id, [])
        span_s = (times[-1] - times[0]) / NS_PER_S if times else 0.0
        longest_gap_ns = max((later - earlier for earlier, later in pairwise(times)), default=math.nan)
        return InspectedTopic(
            name=connection.topic,
            msgtype=connection.msgtype,
            announced=max(connection.msgcount, reader.announced[connection.topic]),
            found=len(times),
            rate_hz=(len(times) - 1) / span_s if span_s > 0.0 else math.nan,
            longest_gap_s=longest_gap_ns / NS_PER_S,
            latched=any_bag.is_latched(connection),
        )

    start_ns = min((times[0] for times in times_ns.values()), default=0)
    end_ns = max((times[-1] for times in times_ns.values()), default=0)
    found = tuple(map(inspected, sorted(reader.connections, key=lambda each: each.topic)))
    return {"start_ns": start_ns, "duration_s": (end_ns - start_ns) / NS_PER_S, "topics": found}


def _trial(reader: AnyBag) -> dict[str, Any]:
    """Return what the result of a trial says and its joints, if there is exactly one that can be read."""
    of_result = [
        c for c in reader.connections if topics.is_named(c.topic, topics.TRIAL_RESULT) and c.msgcount
    ]
    messages = reader.messages(of_result) if of_result else ()
    results: list[Any] = [reader.deserialize(raw, c.msgtype) for c, _, raw in messages]
    with suppress(AttributeError, ValueError, TypeError):  # somebody else's topic of that name
        if len(results) == 1:
            return {"trial": report_of(results[0]), "joints": tuple(results[0].joint_names)}
    return {}


def _wholeness(
    bag: Path, found: tuple[InspectedTopic, ...], metadata: Mapping[str, str]
) -> tuple[Wholeness, str]:
    short = [topic for topic in found if topic.found < topic.announced]
    if short:
        said = ", ".join(f"{counted(t.found, 'message')} of {t.name} instead of {t.announced}" for t in short)
        return Wholeness.BROKEN, f"it yields {said}"
    try:
        check_sums(bag)
    except (TelError, OSError, ValueError) as error:
        return Wholeness.BROKEN, getattr(error, "found", f"{CHECKSUMS} cannot be used ({error})")
    recovered = {key: value for key, value in metadata.items() if key.startswith(RECOVERED)}
    if recovered:
        return Wholeness.RECOVERED, "; ".join(f"{key}: {value}" for key, value in recovered.items())
    if bag.absolute().parent.name == UNFINISHED:
        return Wholeness.UNFINISHED, "it was given up, and lies where unfinished bags lie"
    return (Wholeness.WHOLE if (bag / CHECKSUMS).is_file() else Wholeness.COMPLETE), ""
