"""What a service knows of the movements that it has executed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

_MOST_MOVEMENTS = 1000
"""That are remembered; the ones that have not been asked for the longest are forgotten first."""


@dataclass(frozen=True)
class Remembered:
    """What is known of a movement that has been executed."""

    error_rad: float
    """The best one (RMS), at..."""
    slowdown: float
    """... how many times slower than requested."""
    network: int
    """With which it came: that after this execution."""
    least_slowdown: float = 1.0
    """Faster ones have been aborted."""


@dataclass(frozen=True)
class ServiceMemory:
    """What a service has to know after a restart."""

    executions: int = 0
    """Numbers of executions up to this one are taken."""
    network: int = 0
    """The one in use: that after this execution."""
    ratio: float = 1.0
    """Tracking errors in proportion to the network's standard deviation, as they came."""
    movements: Mapping[str, Remembered] = field(default_factory=dict)
    """By :attr:`~.reference.Points.key`."""

    def to_plain(self) -> dict[str, Any]:
        """Return values that JSON holds."""
        return asdict(self)

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> ServiceMemory:
        """Return the memory of such values; KeyError, TypeError, ValueError: they are none."""
        movements = {str(key): Remembered(**each) for key, each in values["movements"].items()}
        ratio = float(values["ratio"])
        if not 0.0 < ratio < math.inf:
            raise ValueError(f"ratio is {ratio}")
        return cls(int(values["executions"]), int(values["network"]), ratio, movements)

    def remembering(self, key: str, movement: Remembered) -> ServiceMemory:
        """Return it with what is known of a movement now, as the one that was asked for last."""
        movements = {k: each for k, each in self.movements.items() if k != key}
        movements[key] = movement
        for oldest in list(movements)[:-_MOST_MOVEMENTS]:
            del movements[oldest]
        return replace(self, movements=movements)
