"""Finding learners by name, those of other packages included."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.learner import LearnerKind
from tel_ros.core.learning.learners import LmsTreeKind, RigidBodyAndTreeKind, RigidBodyKind

GROUP = "tel_ros.learners"
_OURS: dict[str, LearnerKind] = {
    "lms_tree": LmsTreeKind(),
    "rigid_body": RigidBodyKind(),
    "rigid_body+lms_tree": RigidBodyAndTreeKind(),
}


@cache
def learner_kind(name: str) -> LearnerKind:
    """Return the kind of learner with a name.

    Args:
        name: one of ours, or that of an entry point of the group ``tel_ros.learners`` in any installed
            package.

    Raises:
        ConfigError: there is none, or what an entry point names cannot be loaded.
    """
    if name in _OURS:
        return _OURS[name]
    offered = {point.name: point for point in entry_points(group=GROUP)}
    if name not in offered:
        known = ", ".join(sorted({*_OURS, *offered}))
        raise ConfigError(
            "learning.name", name, f"one of {known}, or an installed entry point of the group {GROUP}"
        )
    point = offered[name]
    try:
        named = point.load()
        kind: LearnerKind = named() if isinstance(named, type) else named
    except Exception as error:  # whatever a foreign package raises
        found = f"an entry point that loads ({point.value}: {' '.join(str(error).split())})"
        raise ConfigError("learning.name", name, found) from error
    missing = [method for method in ("new", "restored") if not callable(getattr(kind, method, None))]
    if missing:
        raise ConfigError(
            "learning.name", name, f"an entry point with new and restored; {point.value} lacks {missing}"
        )
    return kind
