"""What is seen of the trials while the view is open."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from tel_ros.core.kinematics import SerialChain
from tel_ros.core.trial import Phase, TrialGoal
from tel_ros.core.types import FloatArray, evenly_spaced

if TYPE_CHECKING:
    from tel_interfaces.msg import ControlState, TrialResult

N_CELLS = 240
"""As many as a small plot can show."""
PATH_POINTS = 200
MEASURED_POINTS = 400
"""At most, of the measured path, which may shake."""
GAP_SHARE = 0.1
"""Points further apart than this share of the duration are not connected."""
HOLD_SHARE = 0.1
"""How much of the hold is plotted after the movement, as a share of its duration."""
KEPT_PATHS = 8
"""Earlier paths that are drawn; more would hide each other."""


class GridSeries:
    """Values over time on a grid from 0 to ``end_s``; each cell keeps the value of largest magnitude."""

    def __init__(self, n_joints: int, end_s: float, n_cells: int = N_CELLS) -> None:
        self._cell_s = end_s / n_cells
        self.time_s: FloatArray = (np.arange(n_cells, dtype=np.float64) + 0.5) * self._cell_s
        """Middle of each cell. Shape (n_cells,)."""
        self.values: FloatArray = np.full((n_cells, n_joints), np.nan)
        """NaN where nothing has come. Shape (n_cells, n_joints)."""

    def add(self, time_s: float, values: FloatArray) -> None:
        """Take in values of shape (n_joints,) at a time; outside the grid they are left out."""
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
    """Return the next of 1, 2.5, 5 or 10 times a power of ten, so that an axis seldom changes; 1 for 0."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.5, 5.0, 10.0) if step * power >= value)


class LiveTrial:
    """Gathers the samples of one trial: the path of the hand, and what is plotted over time.

    ``std_rad`` is the standard deviation expected of the error in û. Shape (n, n_joints), or empty: unknown.
    """

    def __init__(
        self, goal: TrialGoal, std_rad: FloatArray, chain: SerialChain, effort_limit_nm: tuple[float, ...]
    ) -> None:
        self.index, self.alpha = goal.index, goal.alpha
        self.duration_s = goal.desired.duration_s
        self._chain, self._limit_nm = chain, np.array(effort_limit_nm)
        grid = goal.desired.n_joints, (1.0 + HOLD_SHARE) * self.duration_s
        self.error_rad, self.speed_rad_s, self.effort_share = (GridSeries(*grid) for _ in range(3))
        drawn = evenly_spaced(len(goal.equilibrium_rad), PATH_POINTS)
        self.desired_m = chain.hand_positions(goal.desired.position_rad[drawn])
        """Where the hand should go. Shape (n, 3)."""
        self.equilibrium_m = chain.hand_positions(goal.equilibrium_rad[drawn])
        """Where the springs pull the hand. Shape (n, 3)."""
        time_s, cells = goal.desired.time_ns / 1e9, self.error_rad.time_s

        def on_grid(values: FloatArray) -> FloatArray:
            columns = [np.interp(cells, time_s, column, right=np.nan) for column in values.T]
            return np.stack(columns, axis=1)

        self.desired_speed_rad_s = on_grid(goal.desired.velocity_rad_s)
        """Over the times of the grids. Shape (n_cells, n_joints)."""
        self.is_std_known = std_rad.shape == goal.equilibrium_rad.shape and bool(np.isfinite(std_rad).all())
        self.std_rad = on_grid(std_rad) if self.is_std_known else np.nan * self.desired_speed_rad_s
        """Of the error in û; NaN where nothing is known yet."""
        self._path_rad: list[FloatArray] = []
        self._gaps: list[int] = []
        self._last_point_s = -np.inf

    @property
    def hand_m(self) -> FloatArray:
        """Where the hand has been since the start of RUN; NaN where that is not known. Shape (n, 3)."""
        if not self._path_rad:
            return np.zeros((0, 3))
        return np.insert(self._chain.hand_positions(np.array(self._path_rad)), self._gaps, np.nan, axis=0)

    def see(self, sample: ControlState) -> None:
        """Take in a sample; those of other trials and from before the movement are left out."""
        time_s, position_rad = sample.time_from_start_s, np.array(sample.position_rad)
        if sample.trial != self.index or time_s < 0.0:
            return
        share = (time_s - self._last_point_s) / self.duration_s
        if sample.phase in (Phase.RUN, Phase.STOP) and share >= 1.0 / MEASURED_POINTS:
            if self._path_rad and share > GAP_SHARE:
                self._gaps.append(len(self._path_rad))
            self._path_rad.append(position_rad)
            self._last_point_s = time_s
        if sample.phase in (Phase.RUN, Phase.HOLD):
            self.error_rad.add(time_s, position_rad - sample.desired_position_rad)
        self.speed_rad_s.add(time_s, np.array(sample.velocity_rad_s))
        self.effort_share.add(time_s, np.array(sample.effort_nm) / self._limit_nm)


class History:
    """The trials of this run that ended while the view was open."""

    def __init__(self) -> None:
        self.trials: list[tuple[TrialResult, str]] = []
        """Results, and why each trial was chosen or ended so, in any text."""
        self.paths: deque[tuple[int, FloatArray]] = deque(maxlen=KEPT_PATHS)
        """Number of the trial and positions of the hand [m], shape (n, 3), NaN in gaps; oldest first."""

    def end(self, result: TrialResult, reason: str, live: LiveTrial | None) -> None:
        """Take in a trial that has ended, and what was seen of it, unless it repeats the last one."""
        if self.trials and (result, reason) == self.trials[-1]:
            return
        if self.trials and result.index <= self.trials[-1][0].index:
            self.trials.clear()
            self.paths.clear()
        self.trials.append((result, reason))
        if live is not None and live.index == result.index and len(live.hand_m) > 1:
            self.paths.append((result.index, live.hand_m))
