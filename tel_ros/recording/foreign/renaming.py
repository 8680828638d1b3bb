"""Joints that a recording names otherwise than the arm's description: ``fer_joint1`` and ``panda_joint1``."""

from __future__ import annotations

import os.path
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tel_ros.core.errors import ConfigError


@dataclass(frozen=True)
class Renaming:
    """Rules FROM, TO: the first one whose FROM a name begins with replaces it; FROM may be the whole name."""

    rules: tuple[tuple[str, str], ...] = ()

    @classmethod
    def parsed(cls, texts: Sequence[str]) -> Renaming:
        """Return the rules of texts ``FROM=TO``; ConfigError if one has another form."""
        for text in texts:
            if text.count("=") != 1 or text == "=":
                raise ConfigError("--rename", text, "FROM=TO, e.g. fer_=panda_")
        return cls(tuple((text.split("=")[0].strip(), text.split("=")[1].strip()) for text in texts))

    def __call__(self, name: str) -> str:
        """Return the name of a joint in the arm's description."""
        for old, new in self.rules:
            if name.startswith(old):
                return new + name[len(old) :]
        return name


def advice(recorded: Iterable[str], expected: Iterable[str]) -> str:
    """Return the option that gives most recorded joints the expected names; empty if none does."""
    recorded, expected = list(recorded), set(expected)
    best, most = "", 0
    for name in recorded:
        for other in sorted(expected):
            n = len(os.path.commonprefix([name[::-1], other[::-1]]))
            if n and n < min(len(name), len(other)) and not name[-n].isalnum():
                n -= 1  # fer_=panda_ rather than fer=panda
            old, new = name[: len(name) - n], other[: len(other) - n]
            fit = sum(r.startswith(old) and new + r[len(old) :] in expected for r in recorded)
            if n and (old or new) and fit > most:
                best, most = f" (--rename {old}={new}?)", fit
    return best
