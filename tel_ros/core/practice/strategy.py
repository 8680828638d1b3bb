"""Practice strategies by name: the sequence of movements that leads to the one that is wanted."""

from __future__ import annotations

from collections.abc import Callable

from tel_ros.core.config import Config, PracticeConfig
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.decisions import Movement, Strategy
from tel_ros.core.practice.schedules import direct, trajectory_extension
from tel_ros.core.practice.subtasks import Subtasks, parts_of

STRATEGIES: dict[str, Callable[[Config], Strategy]] = {
    "trajectory_extension": lambda config: trajectory_extension(config.practice),
    "adaptive_extension": lambda config: AdaptiveExtension(
        config.practice, config.arm, config.control.path_tolerance_rad
    ),
    "subtasks": lambda config: Subtasks(config.practice, config.arm, config.control.path_tolerance_rad),
    "direct": lambda config: direct(config.practice),
}


def make_strategy(config: Config) -> Strategy:
    """Return the configured strategy."""
    return STRATEGIES[config.practice.strategy](config)


def movements_to_cover(config: PracticeConfig) -> list[Movement]:
    """Return movements that together go as far as any of practice, in postures, speeds and accelerations.

    The goal is the first. A blend of two paths stays between them; a part of a path accelerates more at its
    ends than the whole does.
    """
    movements = [Movement(config.goal_duration_s)]
    if "shape" in config.vary:
        movements.append(Movement(config.goal_duration_s, shape=0.0))
    if config.strategy == "subtasks":
        movements += parts_of(config)
    return movements
