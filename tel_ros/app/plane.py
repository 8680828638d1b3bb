"""How a path of the hand is looked at: the plane it is drawn in, and the viewpoint in 3D."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tel_ros.core.types import FloatArray

FLAT_M = 1e-3
"""A hand that stays this close to a plane moves in it."""

_TILT = 0.35
_ASIDE = 0.2
"""How far the target is moved, as a share of the size: the panel hides the right part of the picture."""


class Plane(NamedTuple):
    """A plane to draw in: an origin, shape (3,), and two unit vectors with their names, shape (2, 3).

    ``out_of_plane_m``: largest distance of a position from it. ``principal``: whether the axes are those of
    largest extent, not those of the base frame.
    """

    origin_m: FloatArray
    axes: FloatArray
    names: tuple[str, str]
    out_of_plane_m: float
    principal: bool

    def project(self, positions_m: FloatArray) -> FloatArray:
        """Return the coordinates [m] in the plane of positions of shape (n, 3). Shape (n, 2)."""
        projected: FloatArray = (positions_m - self.origin_m) @ self.axes.T
        return projected

    @property
    def description(self) -> str:
        """One sentence about the plane."""
        if not self.principal:
            return f"The hand moves in the {'–'.join(self.names)} plane of the base frame."
        where = "Drawn in the plane of largest extent (principal axes of all positions shown)"
        if self.out_of_plane_m <= FLAT_M:
            return f"{where}, which the hand does not leave."
        return f"{where}; the hand leaves it by up to {1e3 * self.out_of_plane_m:.3g} mm."


def drawing_plane(positions_m: FloatArray) -> Plane:
    """Return the plane of the base frame with all positions, shape (n, 3), else that of largest extent."""
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    distance_m = (high - low) / 2.0
    for dropped in (2, 1, 0):
        if distance_m[dropped] <= FLAT_M:
            kept = [axis for axis in range(3) if axis != dropped]
            names = ("xyz"[kept[0]], "xyz"[kept[1]])
            return Plane(np.zeros(3), np.eye(3)[kept], names, float(distance_m[dropped]), principal=False)
    centre = positions_m.mean(axis=0)
    axes = np.linalg.svd(positions_m - centre, full_matrices=False)[2]
    # The decomposition leaves the signs open: let each axis point along the base axis that it is closest to.
    axes *= np.sign(axes[np.arange(3), np.argmax(np.abs(axes), axis=1)])[:, None]
    off_m = (positions_m - centre) @ axes[2]
    names = ("first principal axis", "second principal axis")
    return Plane(centre, axes[:2], names, float(np.abs(off_m).max()), principal=True)


class Viewpoint(NamedTuple):
    """Camera, target, upward direction in the base frame, shape (3,); and the diagonal of what is seen."""

    position_m: FloatArray
    target_m: FloatArray
    up: FloatArray
    size_m: float


def viewpoint(positions_m: FloatArray) -> Viewpoint:
    """Return a viewpoint: before a path in a plane of the base frame, a little tilted; else oblique.

    ``positions_m`` are those of the hand along the path and of the base. Shape (n, 3).
    """
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    target_m, size_m = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), 0.1)
    plane = drawing_plane(positions_m)
    up, normal = np.array([0.0, 0.0, 1.0]), np.cross(*plane.axes)
    if plane.principal:
        direction = np.array([1.0, -1.4, 0.8])
    elif plane.names == ("x", "y"):
        direction, up = normal - _TILT * plane.axes[1], plane.axes[1]
    else:
        direction = normal + _TILT * up
    direction = direction / np.linalg.norm(direction)
    target_m = target_m + _ASIDE * size_m * np.cross(up, direction)
    return Viewpoint(target_m + 1.05 * size_m * direction, target_m, up, size_m)
