"""What a fault does to the messages of a channel: one message in, any number out, each with a delay."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tel_ros.core.types import NS_PER_S
from tel_ros.nodes.conversions import time_ns, to_time

Message = JointState | Float64MultiArray
Passed = list[tuple[float, Message]]
"""Messages with the delay in s that each of them gets."""


class Corruption(ABC):
    """Something that happens to every message while a fault lasts."""

    @abstractmethod
    def __call__(self, message: Message) -> Passed:
        """Return what is passed on for a message. The message may be changed in place."""


class Overwritten(Corruption):
    """One joint's number is another one.

    Args:
        name: of the field: ``position``, ``velocity`` or ``data``.
        joint: index of the joint.
        value: what is written there.
    """

    def __init__(self, name: str, joint: int, value: float) -> None:
        self._name, self._joint, self._value = name, joint, value

    def __call__(self, message: Message) -> Passed:
        """Overwrite the number."""
        getattr(message, self._name)[self._joint] = self._value
        return [(0.0, message)]


class Shortened(Corruption):
    """The last joint is missing in some fields.

    Args:
        names: of the fields.
    """

    def __init__(self, *names: str) -> None:
        self._names = names

    def __call__(self, message: Message) -> Passed:
        """Take the last entries away."""
        for name in self._names:
            setattr(message, name, getattr(message, name)[:-1])
        return [(0.0, message)]


class Reordered(Corruption):
    """Every second message is overtaken by the next."""

    def __init__(self) -> None:
        self._held: Message | None = None

    def __call__(self, message: Message) -> Passed:
        """Hold a message, or pass two on in the wrong order."""
        if self._held is None:
            self._held = message
            return []
        held, self._held = self._held, None
        return [(0.0, message), (0.0, held)]


class Delayed(Corruption):
    """Every message is late.

    Args:
        delay_s: by how much.
    """

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s

    def __call__(self, message: Message) -> Passed:
        """Pass the message on later."""
        return [(self._delay_s, message)]


class Dropped(Corruption):
    """Some messages get lost.

    Args:
        share: of the messages; 1: all.
        seed: of the choice.
    """

    def __init__(self, share: float, seed: int = 0) -> None:
        self._share, self._rng = share, np.random.default_rng(seed)

    def __call__(self, message: Message) -> Passed:
        """Pass the message on, or not."""
        return [] if self._rng.random() < self._share else [(0.0, message)]


class Thinned(Corruption):
    """Only every n-th message gets through, as from a computer that stands still again and again.

    Args:
        every: n.
    """

    def __init__(self, every: int) -> None:
        self._every, self._n = every, 0

    def __call__(self, message: Message) -> Passed:
        """Pass the message on if it is its turn."""
        self._n += 1
        return [] if self._n % self._every else [(0.0, message)]


class Frozen(Corruption):
    """The first message comes again and again."""

    def __init__(self) -> None:
        self._first: Message | None = None

    def __call__(self, message: Message) -> Passed:
        """Pass the first message on."""
        self._first = self._first or message
        return [(0.0, self._first)]


class Shifted(Corruption):
    """The clock that makes the stamps is wrong.

    Args:
        shift_s: by how much.
    """

    def __init__(self, shift_s: float) -> None:
        self._shift_ns = round(shift_s * NS_PER_S)

    def __call__(self, message: Message) -> Passed:
        """Move the stamp; it does not go below zero."""
        message.header.stamp = to_time(max(0, time_ns(message.header.stamp) + self._shift_ns))
        return [(0.0, message)]


def corruption(kind: str, parameters: dict[str, Any]) -> Corruption:
    """Return what a kind of fault does to the messages of its channel.

    Raises:
        ValueError: the kind does nothing to messages.
    """
    channel, _, name = kind.partition("_")
    values = "position" if channel == "state" else "data"
    joint = parameters.get("joint", 0)
    if name == "nan":
        return Overwritten(values, joint, math.nan)
    if name == "inf":
        return Overwritten(values, joint, math.inf)
    if name == "huge":
        return Overwritten(parameters.get("field", values), joint, parameters["value"])
    if name == "short":
        return Shortened(values)
    if name == "nameless":
        return Shortened("name", "position", "velocity", "effort")
    if name == "reordered":
        return Reordered()
    if name == "delayed":
        return Delayed(parameters["delay_s"])
    if name == "dropped":
        return Dropped(parameters["share"], parameters["seed"])
    if name == "stutter":
        return Thinned(parameters["every"])
    if name == "silence":
        return Dropped(1.0)
    if name == "frozen":
        return Frozen()
    if name in ("time_back", "time_forward"):
        return Shifted(parameters["shift_s"])
    raise ValueError(f"{kind} does nothing to messages")
