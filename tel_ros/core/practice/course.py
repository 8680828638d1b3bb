"""The way from the first movement to the goal, where practice varies one thing or several in turn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

from tel_ros.core.config import PracticeConfig
from tel_ros.core.practice.strategy import Movement

Varied = Literal["speed", "amplitude", "shape", "stiffness"]

_ROUNDING = 1e-12
_SLOWNESS: Mapping[Varied, Callable[[float], float]] = {
    "speed": lambda duration_s: duration_s,
    "amplitude": lambda amplitude: 1.0 / math.sqrt(amplitude),
    "stiffness": math.sqrt,
    "shape": lambda share: math.exp(1.0 - share),
}
_VALUE: Mapping[Varied, Callable[[float], float]] = {
    "speed": lambda slowness: slowness,
    "amplitude": lambda slowness: 1.0 / slowness**2,
    "stiffness": lambda slowness: slowness**2,
    "shape": lambda slowness: 1.0 - math.log(slowness),
}


class Leg(NamedTuple):
    """One thing that varies, from its first value to its goal: s, amplitude, share of the shape, factor on K.

    Its *slowness* says how easy it still is, and falls along the way. Without learning, the arm leaves its
    path by about 1 / slowness²: torques go with 1 / T² and with the amplitude, and the deviations that they
    cause with 1 / K. So equal ratios of slowness are about equally difficult steps. How the difficulty
    changes between two paths is not known beforehand; the whole blend counts like a duration that falls by
    the factor e.
    """

    varied: Varied
    first: float
    goal: float

    def slowness(self, value: float) -> float:
        """Return the slowness at a value."""
        return _SLOWNESS[self.varied](value)

    @property
    def goes_further_back(self) -> bool:
        """Whether there are easier movements than the first: slower or smaller ones always are."""
        return self.varied in ("speed", "amplitude")

    def value(self, slowness: float) -> float:
        """Return what varies at a slowness; beyond the first, only where the leg goes further back."""
        first = self.slowness(self.first)
        if math.isclose(slowness, self.slowness(self.goal), rel_tol=_ROUNDING):
            return self.goal
        if math.isclose(slowness, first, rel_tol=_ROUNDING) or (
            slowness > first and not self.goes_further_back
        ):
            return self.first
        return _VALUE[self.varied](slowness)


class Course:
    """Legs that are gone through in turn.

    One number says where on the course a movement is, its slowness: the product over all legs. It falls from
    :attr:`first_slowness` to :attr:`goal_slowness`; if only the speed varies, it is the duration in seconds.

    At least one, and no two vary the same. The goal is the movement that was asked for, or a part of it.
    """

    def __init__(self, legs: Sequence[Leg], goal: Movement) -> None:
        self.legs, self._goal = tuple(legs), goal
        # Factor on the slowness of a leg: legs before it are at their goals, later ones where they begin.
        self._scales = [
            math.prod([leg.slowness(leg.goal) for leg in self.legs[:i]])
            * math.prod([leg.slowness(leg.first) for leg in self.legs[i + 1 :]])
            for i in range(len(self.legs))
        ]

    @classmethod
    def configured(cls, practice: PracticeConfig) -> Course:
        """Return the course from the configured first movement to the goal."""
        first_and_goal = {
            "speed": (practice.first_duration_s, practice.goal_duration_s),
            "amplitude": (practice.first_amplitude, 1.0),
            "shape": (0.0, 1.0),
            "stiffness": (practice.first_stiffness, 1.0),
        }
        legs = [Leg(varied, *first_and_goal[varied]) for varied in practice.vary]
        return cls(legs, Movement(practice.goal_duration_s))

    @property
    def first_slowness(self) -> float:
        """Slowness of the first movement."""
        return self.legs[0].slowness(self.legs[0].first) * self._scales[0]

    @property
    def goal_slowness(self) -> float:
        """Slowness of the goal."""
        return self.legs[-1].slowness(self.legs[-1].goal) * self._scales[-1]

    @property
    def most_slowness(self) -> float:
        """Slowness beyond which movements do not become easier; inf if they always do."""
        return math.inf if self.legs[0].goes_further_back else self.first_slowness

    @property
    def deviates_with_slowness(self) -> bool:
        """Whether deviations without learning go with 1 / slowness²; one path tells nothing about another."""
        return all(leg.varied != "shape" for leg in self.legs)

    def movement(self, slowness: float) -> Movement:
        """Return the movement at a slowness of at least :attr:`goal_slowness`."""
        i = self._active(slowness)
        return self.on_leg(self.legs[i], self.legs[i].value(slowness / self._scales[i]))

    def on_leg(self, leg: Leg, value: float) -> Movement:
        """Return the movement at a value of what varies on a leg."""
        i = self.legs.index(leg)
        values: dict[str, Any] = {_field(leg): leg.goal for leg in self.legs[:i]}
        values |= {_field(leg): leg.first for leg in self.legs[i + 1 :]}
        return replace(self._goal, **values | {_field(leg): value})

    def alpha(self, movement: Movement) -> float:
        """Return the practice parameter: the product of the shares of the goal that there are already."""
        whole = self._goal.duration_s / movement.duration_s * (movement.end - movement.start)
        return whole * movement.amplitude * movement.shape / movement.stiffness

    def varies_speed_at(self, slowness: float) -> bool:
        """Whether the next step from here is one in speed."""
        return self.legs[self._active(slowness)].varied == "speed"

    def at_duration(self, duration_s: float) -> Movement:
        """Return the movement of a duration on the leg on which the speed varies."""
        return self.on_leg(self.legs[self._speed], duration_s)

    def slowness_at_duration(self, duration_s: float) -> float:
        """Return the slowness at a duration on the leg on which the speed varies."""
        return duration_s * self._scales[self._speed]

    def text(self, movement: Movement, duration: str = "") -> str:
        """Say what a movement is: its duration (or the text given for it), and what else varies."""
        varied = [leg.varied for leg in self.legs if leg.varied != "speed"]
        words = [duration or f"{movement.duration_s:.3f} s"]
        words += [f"{name} {getattr(movement, name):.3f}" for name in varied]
        return ", ".join(words if movement.is_whole else [*words, movement.part_text])

    @property
    def ends(self) -> list[Movement]:
        """The movements at both ends of each leg: none on the course is faster, joint by joint."""
        return [self.on_leg(leg, value) for leg in self.legs for value in (leg.first, leg.goal)]

    @property
    def to_cover(self) -> list[Movement]:
        """Movements that bound the course in position, velocity and acceleration; the goal is the first.

        A blend of two paths stays between them.
        """
        varies_shape = any(leg.varied == "shape" for leg in self.legs)
        return [self._goal, replace(self._goal, shape=0.0)] if varies_shape else [self._goal]

    @property
    def goal(self) -> Movement:
        """The movement at the end of the course."""
        return self.movement(self.goal_slowness)

    @property
    def goal_text(self) -> str:
        """What the goal is."""
        return self.text(self.goal, f"{self.goal.duration_s:g} s")

    @property
    def _speed(self) -> int:
        return [leg.varied for leg in self.legs].index("speed")

    def _active(self, slowness: float) -> int:
        """Return which leg a slowness is on; where two meet, the later one."""
        for i, leg in enumerate(self.legs[:-1]):
            if slowness > leg.slowness(leg.goal) * self._scales[i] * (1.0 + _ROUNDING):
                return i
        return len(self.legs) - 1


def _field(leg: Leg) -> str:
    return "duration_s" if leg.varied == "speed" else leg.varied
