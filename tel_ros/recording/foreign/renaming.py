"""Joints that a recording names otherwise than the arm's description: ``fer_joint1`` and ``panda_joint1``."""

from __future__ import annotations

import os.path
from collections.abc import Callable, Iterable, Sequence

from tel_ros.core.errors import ConfigError

Renaming = Callable[[str], str]
"""From a joint's name in a recording to that in the arm's description; ``str`` leaves names as they are."""


def renaming(texts: Sequence[str]) -> Renaming:
    """Return what texts ``FROM=TO`` do: the first FROM that a name begins with, or is, becomes TO."""
    for text in texts:
        if text.count("=") != 1 or text == "=":
            raise ConfigError("--rename", text, "FROM=TO, e.g. fer_=panda_")
    rules = [[part.strip() for part in text.split("=")] for text in texts]

    def renamed(name: str) -> str:
        matching = (new + name[len(old) :] for old, new in rules if name.startswith(old))
        return next(matching, name)

    return renamed


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
