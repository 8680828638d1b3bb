"""The errors that tel_ros raises on purpose: one family, the numbers kept, a way out named."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

_ALIKE = 0.8


class TelError(Exception):
    """Base of everything that tel_ros raises on purpose."""


class ConfigError(TelError):
    """A configured value cannot be used: its dotted key, as far as it is known, and its file or option."""

    def __init__(self, key: str, value: object, expected: str, source: str | None = None) -> None:
        self.key, self.value, self.expected, self.source = key, value, expected, source
        where = f"{source}: " if source else ""
        super().__init__(f"{where}{key} is {value!r}; expected {expected}")

    def inside(self, section: str, source: str | None = None) -> ConfigError:
        """Return the same error as seen from outside: the key prefixed, the source named."""
        key = f"{section}.{self.key}" if section else self.key
        return ConfigError(key, self.value, self.expected, self.source or source)


class InputFileError(TelError):
    """A file that the user named cannot be used."""

    def __init__(self, path: object, found: str, expected: str) -> None:
        self.path, self.found, self.expected = str(path), found, expected
        super().__init__(f"{path}: {found}; expected {expected}")


class TrajectoryError(TelError):
    """A trajectory is malformed or asks for what the arm must not do."""


class StateError(TelError):
    """A measured state cannot be used: wrong joints, wrong length or not finite."""


class EffortError(TelError):
    """An effort that was computed must not reach the arm: it is not finite."""


class TrainingError(TelError):
    """The network could not be trained; it stays as it was."""


class NetworkFileError(InputFileError):
    """A stored network cannot be read or does not fit."""


class BagError(InputFileError):
    """A trial's bag is missing, not whole, or does not hold what a trial must hold."""


def counted(number: int, noun: str) -> str:
    """Return a number of things as people write it: ``1 trial``, ``2 trials``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def look_alikes(name: str, existing: Iterable[str]) -> list[str]:
    """Return the existing names that may be meant by a name that does not exist, e.g. of a topic.

    Their last part is the same, in another namespace, or spelt alike; the closest come first.
    """
    last = name.rpartition("/")[2]
    likeness = {
        other: SequenceMatcher(None, last, other.rpartition("/")[2]).ratio()
        for other in existing
        if other != name
    }
    return sorted((o for o in likeness if likeness[o] >= _ALIKE), key=lambda o: (-likeness[o], o))
