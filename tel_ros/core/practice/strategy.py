"""Practice strategies by name: the sequence of movements that leads to the one that is wanted."""

from __future__ import annotations

from collections.abc import Callable

from tel_ros.core.config import Config
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.decisions import Strategy
from tel_ros.core.practice.schedules import direct, trajectory_extension

STRATEGIES: dict[str, Callable[[Config], Strategy]] = {
    "trajectory_extension": lambda config: trajectory_extension(config.practice),
    "adaptive_extension": lambda config: AdaptiveExtension(
        config.practice, config.arm, config.control.corridor_rad
    ),
    "direct": lambda config: direct(config.practice),
}


def make_strategy(config: Config) -> Strategy:
    """Return the configured strategy."""
    return STRATEGIES[config.practice.strategy](config)
