"""What other packages add to ``tel``: entry points, and those of the laboratory in a checkout."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

LABORATORY = "tel_lab"
"""A package of the same distribution. Its ``ENTRY_POINTS`` (group → name → "module:attribute") is what
setup.py installs; it is also read here, because a checkout keeps the entry points it was installed with."""


def extensions(group: str) -> dict[str, str]:
    """Return the name and the place ("module:attribute") of everything that is offered in a group."""
    places = {point.name: point.value for point in entry_points(group=group)}
    if find_spec(LABORATORY) is None:
        # Installed once, but not there: a checkout without it.
        return {name: place for name, place in places.items() if not place.startswith(f"{LABORATORY}.")}
    return places | getattr(import_module(LABORATORY), "ENTRY_POINTS", {}).get(group, {})


def load(place: str) -> Any:
    """Return what is at a place ("module:attribute")."""
    return EntryPoint(name="", value=place, group="").load()
