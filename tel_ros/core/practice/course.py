"""The way from the first movement to the goal, where practice varies one thing or several in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from tel_ros.core.config import PracticeConfig
from tel_ros.core.practice.strategy import Movement

Varied = Literal["speed", "amplitude", "shape", "stiffness"]

_ROUNDING = 1e-12


@dataclass(frozen=True)
class Leg:
    """One thing that varies, from its first value to that of the goal.

    Its *slowness* says how easy it still is, and falls along the way. Without learning, the arm leaves its
    path by about 1 / slowness²: torques go with 1 / T² and with the amplitude, and the deviations that they
    cause with 1 / K. So equal ratios of slowness are about equally difficult steps. How the difficulty
    changes between two paths is not known beforehand; the whole blend counts like a duration that falls by
    the factor e.

    Args:
        varied: what varies.
        first: duration in s, amplitude, share of the goal's shape or factor on K where the leg begins.
        goal: the same where it ends.
    """

    varied: Varied
    first: float
    goal: float

    @property
    def first_slowness(self) -> float:
        """Slowness where the leg begins."""
        return self._slowness(self.first)

    @property
    def goal_slowness(self) -> float:
        """Slowness where the leg ends."""
        return self._slowness(self.goal)

    @property
    def goes_further_back(self) -> bool:
        """Whether there are easier movements than the first: slower or smaller ones always are."""
        return self.varied in ("speed", "amplitude")

    def value(self, slowness: float) -> float:
        """Return what varies at a slowness; beyond the first, only where the leg goes further back."""
        if math.isclose(slowness, self.goal_slowness, rel_tol=_ROUNDING):
            return self.goal
        if math.isclose(slowness, self.first_slowness, rel_tol=_ROUNDING) or (
            slowness > self.first_slowness and not self.goes_further_back
        ):
            return self.first
        if self.varied == "speed":
            return slowness
        if self.varied == "amplitude":
            return 1.0 / slowness**2
        if self.varied == "stiffness":
            return slowness**2
        return 1.0 - math.log(slowness)

    def _slowness(self, value: float) -> float:
        if self.varied == "speed":
            return value
        if self.varied == "amplitude":
            return 1.0 / math.sqrt(value)
        if self.varied == "stiffness":
            return math.sqrt(value)
        return math.exp(1.0 - value)


class Course:
    """Legs that are gone through in turn.

    One number says where on the course a movement is, its slowness: the product over all legs. It falls from
    :attr:`first_slowness` to :attr:`goal_slowness`; if only the speed varies, it is the duration in seconds.

    Args:
        legs: at least one; no two vary the same.
        goal: the movement that was asked for, or the part of it that this course is about.
    """

    def __init__(self, legs: Sequence[Leg], goal: Movement) -> None:
        self._legs = tuple(legs)
        self._goal = goal
        # Factor on the slowness of a leg: legs before it are at their goals, later ones where they begin.
        self._scales = [
            math.prod([leg.goal_slowness for leg in self._legs[:i]])
            * math.prod([leg.first_slowness for leg in self._legs[i + 1 :]])
            for i in range(len(self._legs))
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
    def legs(self) -> Sequence[Leg]:
        """What varies, in turn."""
        return self._legs

    @property
    def first_slowness(self) -> float:
        """Slowness of the first movement."""
        return self._legs[0].first_slowness * self._scales[0]

    @property
    def goal_slowness(self) -> float:
        """Slowness of the goal."""
        return self._legs[-1].goal_slowness * self._scales[-1]

    @property
    def most_slowness(self) -> float:
        """Slowness beyond which movements do not become easier; inf if they always do."""
        return math.inf if self._legs[0].goes_further_back else self.first_slowness

    @property
    def deviates_with_slowness(self) -> bool:
        """Whether deviations without learning go with 1 / slowness²; one path tells nothing about another."""
        return all(leg.varied != "shape" for leg in self._legs)

    def movement(self, slowness: float) -> Movement:
        """Return the movement at a slowness of at least :attr:`goal_slowness`."""
        i = self._active(slowness)
        return self.on_leg(self._legs[i], self._legs[i].value(slowness / self._scales[i]))

    def on_leg(self, leg: Leg, value: float) -> Movement:
        """Return the movement at a value of what varies on a leg."""
        i = self._legs.index(leg)
        values = {leg.varied: leg.goal for leg in self._legs[:i]}
        values |= {leg.varied: leg.first for leg in self._legs[i + 1 :]}
        values[leg.varied] = value
        return replace(
            self._goal,
            duration_s=values.get("speed", self._goal.duration_s),
            amplitude=values.get("amplitude", 1.0),
            shape=values.get("shape", 1.0),
            stiffness=values.get("stiffness", 1.0),
        )

    def alpha(self, movement: Movement) -> float:
        """Return the practice parameter: the product of the shares of the goal that there are already."""
        whole = self._goal.duration_s / movement.duration_s * (movement.end - movement.start)
        return whole * movement.amplitude * movement.shape / movement.stiffness

    def varies_speed_at(self, slowness: float) -> bool:
        """Whether the next step from here is one in speed."""
        return self._legs[self._active(slowness)].varied == "speed"

    def at_duration(self, duration_s: float) -> Movement:
        """Return the movement of a duration on the leg on which the speed varies."""
        return self.on_leg(self._speed_leg, duration_s)

    def slowness_at_duration(self, duration_s: float) -> float:
        """Return the slowness at a duration on the leg on which the speed varies."""
        return duration_s * self._speed_scale

    def text(self, movement: Movement, duration: str = "") -> str:
        """Say what a movement is: its duration (or the text given for it), and what else varies."""
        words = [duration or f"{movement.duration_s:.3f} s"]
        for leg in self._legs:
            if leg.varied != "speed":
                words.append(f"{leg.varied} {getattr(movement, leg.varied):.3f}")
        if not movement.is_whole:
            words.append(f"from {movement.start:.3g} to {movement.end:.3g} of the path")
        return ", ".join(words)

    @property
    def ends(self) -> list[Movement]:
        """The movements at both ends of each leg: none on the course is faster, joint by joint."""
        return [self.on_leg(leg, value) for leg in self._legs for value in (leg.first, leg.goal)]

    @property
    def to_cover(self) -> list[Movement]:
        """Movements that bound the course in position, velocity and acceleration; the goal is the first.

        A blend of two paths stays between them.
        """
        varies_shape = any(leg.varied == "shape" for leg in self._legs)
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
    def _speed_leg(self) -> Leg:
        return next(leg for leg in self._legs if leg.varied == "speed")

    @property
    def _speed_scale(self) -> float:
        return self._scales[self._legs.index(self._speed_leg)]

    def _active(self, slowness: float) -> int:
        """Return which leg a slowness is on; where two meet, the later one."""
        for i, leg in enumerate(self._legs[:-1]):
            if slowness > leg.goal_slowness * self._scales[i] * (1.0 + _ROUNDING):
                return i
        return len(self._legs) - 1
