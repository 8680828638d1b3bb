"""The timings of movements that are to be as fast as efforts allow, from what a network has learned."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.practice.movement_path import movement_path
from tel_ros.core.practice.strategy import Movement
from tel_ros.core.safety.motion_rules import BrakingDistance, MotionLimits, SoftLimits
from tel_ros.core.safety.rules import EffortRate
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.path_dynamics import PathDynamics, middles
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.time_optimal import (
    Bounds,
    EffortBounds,
    fastest_minimum_jerk,
    room,
    time_optimal,
)
from tel_ros.core.trajectories.timing import MinimumJerk, Timing
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray

VELOCITY_SHARE = 0.95
"""Of a velocity limit: the rest is for errors, since a joint that is too fast ends the trial."""
RATE_SHARE = 0.65
"""Of the rate at which the safety layer lets efforts grow."""


class Answer(Protocol):
    """What a network answers, as far as it matters here."""

    @property
    def equilibrium_rad(self) -> FloatArray:
        """The command û."""
        ...


class LearnedTimings:
    """Turns shares of the effort limits into timings; remembers them until the network changes."""

    def __init__(self, config: Config, path: Path, known: Path | None) -> None:
        self._config, self._path, self._known = config, path, known
        self._springs = Springs.of(config.arm)
        self._limit_nm = np.array(config.arm.effort_limit_nm)
        self._velocity_rad_s = VELOCITY_SHARE * np.array(config.arm.velocity_limit_rad_s)
        self._timings: dict[Movement, Timing] = {}
        self._dynamics: dict[Movement, PathDynamics] = {}

    def forget(self) -> None:
        """Make all timings anew: the network may be another one."""
        self._timings.clear()
        self._dynamics.clear()

    def heed(self, given_nm: Mapping[str, float]) -> None:
        """Take in how much of their commands drives have given that are limited to less; by joint."""
        for j, joint in enumerate(self._config.arm.joints):
            self._limit_nm[j] = min(self._limit_nm[j], given_nm.get(joint, np.inf))

    def of(self, movement: Movement, predict: Callable[[DesiredTrajectory], Answer]) -> Timing:
        """Return the timing of a movement; ``predict`` asks the network as it is now.

        Raises:
            TrajectoryError: the effort limits do not allow it at any speed.
        """
        if movement.effort_share is None:
            return MinimumJerk(movement.own_duration_s)
        if movement not in self._timings:
            self._timings[movement] = self._found(movement, movement.effort_share, predict)
        return self._timings[movement]

    def _found(
        self, movement: Movement, share: float, predict: Callable[[DesiredTrajectory], Answer]
    ) -> Timing:
        dynamics, most = self._dynamics_of(movement, predict), self._config.practice.effort_share
        arm, safety = self._config.arm, self._config.safety
        rate = EffortRate.of(arm, safety, 1.0 / self._config.control.rate_hz).rate_nm_per_s
        walls = SoftLimits.of(arm, safety)
        braking, limits = BrakingDistance.of(arm, safety, walls), MotionLimits(walls)
        q, dq, _ = movement_path(self._path, self._known, movement).evaluate(middles())
        above, below = walls.high_rad - q, q - walls.low_rad
        fastest = braking.fastest(np.maximum(np.where(dq > 0.0, above, below), 0.0))
        k = walls.k_velocity_nms_per_rad
        motion = EffortBounds(
            -k * VELOCITY_SHARE * limits.fastest_outward(below),
            k * VELOCITY_SHARE * limits.fastest_outward(above),
            k * dq,
        )
        bounds = Bounds(
            [room(dynamics, self._limit_nm, share, max(share, most), arm.joints), motion],
            RATE_SHARE * rate,
            np.minimum(self._velocity_rad_s, VELOCITY_SHARE * fastest),
        )
        minimum_jerk = self._config.practice.timing == "minimum_jerk"
        if minimum_jerk:
            return fastest_minimum_jerk(dynamics, bounds)
        # The arm settles where the first command pulls it: one that would already begin to accelerate it
        # would draw it off its path.
        return replace(time_optimal(dynamics, bounds), rest_s=1.0 / self._config.control.rate_hz)

    def _dynamics_of(
        self, movement: Movement, predict: Callable[[DesiredTrajectory], Answer]
    ) -> PathDynamics:
        shape = replace(movement, duration_s=1.0, stiffness=1.0, effort_share=None)
        if shape not in self._dynamics:
            path = movement_path(self._path, self._known, movement)
            steepest = np.abs(path.evaluate(middles())[1]).max(axis=0)
            with np.errstate(divide="ignore"):
                top_per_s = float(np.min(self._velocity_rad_s / steepest))
            probe = PathDynamics.probe(path, top_per_s)
            effort_nm = self._springs.effort(
                predict(probe).equilibrium_rad, probe.position_rad, probe.velocity_rad_s
            )
            self._dynamics[shape] = PathDynamics.of(path, top_per_s, effort_nm)
        return self._dynamics[shape]
