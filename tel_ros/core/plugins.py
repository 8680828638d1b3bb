"""What other installed packages offer by name, as entry points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from typing import Any

from tel_ros.core.errors import ConfigError


def plugin(
    key: str,
    name: str,
    group: str,
    ours: Mapping[str, Any],
    methods: Sequence[str],
    made: Callable[[Any], Any] = lambda found: found,
) -> Any:
    """Return one of ours, whose names another package cannot take, or what an installed entry point names.

    ``key``: of the configuration, for messages. ``methods``: that the object has to have. ``made``: makes the
    object from what is found under the name. Raises ConfigError: the name is not known, or what the entry
    point names cannot be used.
    """
    if name in ours:
        return made(ours[name])
    offered = {point.name: point for point in entry_points(group=group)}
    if name not in offered:
        known = ", ".join(sorted({*ours, *offered}))
        raise ConfigError(key, name, f"one of {known}, or an installed entry point of the group {group}")
    point = offered[name]
    try:
        found = made(point.load())
    except ConfigError:
        raise
    except Exception as error:  # whatever a foreign package raises
        said = f"an entry point that loads ({point.value}: {' '.join(str(error).split())})"
        raise ConfigError(key, name, said) from error
    missing = [method for method in methods if not callable(getattr(found, method, None))]
    if missing:
        expected = f"an entry point with {' and '.join(methods)}; {point.value} lacks {missing}"
        raise ConfigError(key, name, expected)
    return found
