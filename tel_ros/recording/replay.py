"""What a replay publishes, under which names and when; without a graph and without a clock."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path

from rosbags.interfaces import Connection

from tel_ros.core.errors import BagError, ConfigError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.any_bag import AnyBag, is_latched, reading

PREFIX = "/replay"
"""In front of the names of all topics, because an arm may be listening to the recorded ones. Fixed: with
another prefix some name could become that of a topic that moves an arm."""
STANDSTILL_S = 1.0
"""A replay that is later than this does not catch up: its schedule waits for it."""


@dataclass(frozen=True)
class ReplayedTopic:
    """A topic of a bag, and the name under which it is published.

    ``latched``: for late joiners. ``type_hash``: of its type as the bag defines it (RIHS01); empty: unknown.
    """

    connection: Connection
    name: str
    latched: bool
    type_hash: str


class Replay:
    """A bag with what is to be played of it.

    ``rate``: seconds of the bag in a second. ``patterns``: topics to play, as names or with ``*``, ``?`` and
    ``[…]``; empty: all. ``states_to_nodes``: whether the recorded joint states get the name that live nodes
    listen to. BagError: a bag of ROS 1, an empty one, one without a topic that was asked for, or, where joint
    states go to the nodes, without or with several topics of them.
    """

    def __init__(
        self,
        reader: AnyBag,
        rate: float = 1.0,
        start_offset_s: float = 0.0,
        patterns: Sequence[str] = (),
        states_to_nodes: bool = False,
    ) -> None:
        if not 0.0 < rate < math.inf:
            raise ConfigError("rate", rate, "a finite number above 0")
        if not 0.0 <= start_offset_s < math.inf:
            raise ConfigError("start-offset", start_offset_s, "a finite time in s, 0 or more")
        if not reader.is2:
            raise BagError(reader.bag, "is a bag of ROS 1", "a rosbag2 (rosbags-convert makes one of it)")
        chosen = _chosen(reader, patterns)
        self._reader, self.rate = reader, rate
        self.start_ns = reader.start_time + round(start_offset_s * NS_PER_S)
        """Time in the bag at which the replay begins."""
        self.end_ns = reader.end_time
        """Time in the bag at which it is over."""
        if self.start_ns >= self.end_ns:
            length_s = (self.end_ns - reader.start_time) / NS_PER_S
            raise ConfigError("start-offset", start_offset_s, f"less than the bag's {length_s:.3f} s")
        states = _states(reader.bag, chosen) if states_to_nodes else None
        names = {c.topic: topics.absolute(c.topic.removeprefix("/"), PREFIX) for c in chosen}
        self.topics = tuple(
            ReplayedTopic(
                connection,
                topics.JOINT_STATES if connection is states else names[connection.topic],
                is_latched(connection),
                reader.definition(connection)[1],
            )
            for connection in chosen
        )
        """What is played."""

    def messages(self, played: Sequence[ReplayedTopic]) -> Iterator[tuple[ReplayedTopic, int, bytes]]:
        """Yield topic, time in the bag [ns] and serialised message of at least one topic, in order of time.

        What is latched and older than the beginning comes at the beginning: it held there.
        """
        by_connection = {(t.connection.topic, t.connection.id): t for t in played}
        latched = [t.connection for t in played if t.latched]
        earlier = self._reader.messages(latched, stop=self.start_ns) if latched else iter(())
        from_here = self._reader.messages([t.connection for t in played], start=self.start_ns)
        with reading(self._reader.bag):  # what the consumer does wrong is not raised in here
            for connection, time_ns, raw in chain(earlier, from_here):
                topic = by_connection[connection.topic, connection.id]
                yield topic, max(time_ns, self.start_ns), raw


class ReplaySchedule:
    """When messages are due: absolute deadlines, so that delays do not add up."""

    def __init__(self, rate: float, start_ns: int, now_s: float) -> None:
        self._rate, self._start_ns, self._start_s = rate, start_ns, now_s
        self._paused_s: float | None = None
        self.stood_still_s = 0.0
        """How long the schedule has waited for a replay that was held up."""
        self.most_late_s = 0.0
        """Largest delay that the schedule did not wait for."""

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused_s is not None

    def set_paused(self, wanted: bool, now_s: float) -> None:
        """Let time stand still, or go on where it stopped."""
        if wanted and self._paused_s is None:
            self._paused_s = now_s
        elif not wanted and self._paused_s is not None:
            self._start_s += now_s - self._paused_s
            self._paused_s = None

    def due_s(self, time_ns: int) -> float:
        """Return when a time in the bag is due."""
        return self._start_s + (time_ns - self._start_ns) / NS_PER_S / self._rate

    def bag_ns(self, now_s: float) -> int:
        """Return the time in the bag."""
        elapsed_s = (now_s if self._paused_s is None else self._paused_s) - self._start_s
        return self._start_ns + round(elapsed_s * self._rate * NS_PER_S)

    def late(self, time_ns: int, now_s: float) -> None:
        """Take note of when something was done; after a standstill the schedule goes on from there."""
        late_s = now_s - self.due_s(time_ns)
        if late_s > STANDSTILL_S:
            self._start_s += late_s
            self.stood_still_s += late_s
        else:
            self.most_late_s = max(self.most_late_s, late_s)


def _chosen(reader: AnyBag, patterns: Sequence[str]) -> list[Connection]:
    connections = [c for c in reader.connections if c.msgcount]
    names = sorted({connection.topic for connection in connections})
    if not names:
        raise BagError(reader.bag, "holds no message", "a bag with messages")
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            found = f"has no topic {pattern} with messages"
            raise BagError(reader.bag, found, f"some of {', '.join(names)}")
    return [c for c in connections if not patterns or any(fnmatchcase(c.topic, p) for p in patterns)]


def _states(bag: Path, chosen: Sequence[Connection]) -> Connection:
    found = [connection for connection in chosen if connection.msgtype == topics.JOINT_STATE]
    if len(found) != 1:
        names = ", ".join(connection.topic for connection in found) or "none"
        expected = "exactly one topic for the nodes (choose it with --topics)"
        raise BagError(bag, f"has these topics of joint states: {names}", expected)
    return found[0]
