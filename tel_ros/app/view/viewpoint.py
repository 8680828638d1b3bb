"""Where to look from so that a path is seen well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.app.plane import drawing_plane
from tel_ros.core.types import FloatArray

_OBLIQUE = np.array([1.0, -1.4, 0.8])
_TILT = 0.35
_DISTANCE = 1.05
_ASIDE = 0.2
"""How far the target is moved, as a share of the size: the panel hides the right part of the picture."""
_LEAST_SIZE_M = 0.1


@dataclass(frozen=True)
class Viewpoint:
    """Camera, target and upward direction in the base frame. Arrays of shape (3,)."""

    position_m: FloatArray
    target_m: FloatArray
    up: FloatArray
    size_m: float
    """Of what is seen: the diagonal of its box."""


def viewpoint(positions_m: FloatArray) -> Viewpoint:
    """Return a viewpoint: before a path in a plane of the base frame, a little tilted; else oblique.

    Args:
        positions_m: of the hand along the path and of the base. Shape (n, 3).
    """
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    target_m, size_m = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), _LEAST_SIZE_M)
    plane = drawing_plane(positions_m)
    up = np.array([0.0, 0.0, 1.0])
    direction = _OBLIQUE
    if not plane.principal:
        normal = np.cross(plane.axes[0], plane.axes[1])
        if plane.names == ("x", "y"):
            direction, up = normal - _TILT * plane.axes[1], plane.axes[1]
        else:
            direction = normal + _TILT * up
    direction = direction / np.linalg.norm(direction)
    target_m = target_m + _ASIDE * size_m * np.cross(up, direction)
    return Viewpoint(target_m + _DISTANCE * size_m * direction, target_m, up, size_m)
