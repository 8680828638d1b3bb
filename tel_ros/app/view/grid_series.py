"""Values over the time of a trial, however long it is and however fast they come."""

from __future__ import annotations

import math

import numpy as np

from tel_ros.core.types import FloatArray

N_CELLS = 240
"""About as many as a small plot has room for."""


class GridSeries:
    """One value a joint in each cell of a grid of times: that of the largest magnitude, so that peaks stay.

    Args:
        n_joints: number of values at a time.
        end_s: of the grid, which begins at 0; above 0.
        n_cells: number of cells.
    """

    def __init__(self, n_joints: int, end_s: float, n_cells: int = N_CELLS) -> None:
        self._cell_s = end_s / n_cells
        self.time_s: FloatArray = (np.arange(n_cells) + 0.5) * self._cell_s
        """Middle of each cell. Shape (n_cells,)."""
        self.values: FloatArray = np.full((n_cells, n_joints), np.nan)
        """NaN where nothing has come. Shape (n_cells, n_joints)."""

    def add(self, time_s: float, values: FloatArray) -> None:
        """Take in the values at a time; outside the grid they are left out.

        Args:
            time_s: since the start of the grid.
            values: Shape (n_joints,).
        """
        cell = int(time_s // self._cell_s) if np.isfinite(time_s) else -1
        if not 0 <= cell < len(self.values):
            return
        there = self.values[cell]
        self.values[cell] = np.where(np.abs(there) >= np.abs(values), there, values)


def magnitude(values: FloatArray) -> float:
    """Return the largest magnitude of those values that are finite; 0 if none is."""
    finite = values[np.isfinite(values)]
    return float(np.abs(finite).max()) if len(finite) else 0.0


def round_up(value: float) -> float:
    """Return the next of 1, 2.5, 5 or 10 times a power of ten: an axis that seldom changes; 1 for 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.5, 5.0, 10.0) if step * power >= value)
