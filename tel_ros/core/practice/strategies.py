"""Practice strategies by name: ours, and entry points of the group ``tel_ros.strategies``.

Such an entry point names a function or class that takes the configuration and returns a
:class:`~.strategy.Strategy`.
"""

from __future__ import annotations

from collections.abc import Callable

from tel_ros.core.config import Config
from tel_ros.core.plugins import plugin, require_known
from tel_ros.core.practice.adaptive import AdaptiveExtension
from tel_ros.core.practice.schedules import Subtasks, direct, trajectory_extension
from tel_ros.core.practice.strategy import Strategy

GROUP = "tel_ros.strategies"
OURS: dict[str, Callable[[Config], Strategy]] = {
    "trajectory_extension": lambda config: trajectory_extension(config.practice),
    "adaptive_extension": lambda config: AdaptiveExtension(
        config.practice, config.arm, config.control.path_tolerance_rad
    ),
    "subtasks": lambda config: Subtasks(config.practice, config.arm, config.control.path_tolerance_rad),
    "direct": lambda config: direct(config.practice),
}
_KEY = "practice.strategy"
_METHODS = ("preview", "next", "movements_to_cover", "fastest_movements")


def make_strategy(config: Config) -> Strategy:
    """Return a new strategy of the configured name.

    Raises:
        ConfigError: the name is not known, or what an entry point names cannot be used.
    """
    strategy: Strategy = plugin(
        _KEY, config.practice.strategy, GROUP, OURS, _METHODS, lambda make: make(config)
    )
    return strategy


def require_strategy(name: str) -> None:
    """Raise :class:`ConfigError` if there is no strategy of this name."""
    require_known(_KEY, name, GROUP, OURS)
