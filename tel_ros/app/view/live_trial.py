"""What there is to see of one trial while it goes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.app.view.grid_series import GridSeries
from tel_ros.core.kinematics import SerialChain
from tel_ros.core.trial import Phase, TrialGoal
from tel_ros.core.types import FloatArray

PATH_POINTS = 200
"""Of a path that is drawn: more cannot be told apart on a screen."""
MEASURED_POINTS = 400
"""At most, of the measured path in the time of the movement: it may shake."""
GAP_SHARE = 0.1
"""Points that are further apart than this share of the duration have nothing drawn between them."""
HOLD_SHARE = 0.1
"""How much of the hold is plotted behind the movement, as a share of its duration."""


@dataclass(frozen=True)
class Sample:
    """What the controller saw and did in one tick. Shape (n_joints,) each; nothing is desired in IDLE."""

    trial: int
    phase: Phase
    time_from_start_s: float
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    desired_rad: FloatArray
    effort_nm: FloatArray


class LiveTrial:
    """Gathers the samples of one trial: where the hand has been, and what is plotted over time.

    Args:
        goal: what the trial is to do.
        std_rad: standard deviation expected of the error in û. Shape (n, n_joints), or empty: not known.
        chain: from the base to the hand.
        effort_limit_nm: of each joint.
    """

    def __init__(
        self, goal: TrialGoal, std_rad: FloatArray, chain: SerialChain, effort_limit_nm: tuple[float, ...]
    ) -> None:
        self.index, self.alpha = goal.index, goal.alpha
        self.duration_s = goal.desired.duration_s
        self._chain, self._limit_nm = chain, np.array(effort_limit_nm)
        n_joints = goal.desired.n_joints
        end_s = (1.0 + HOLD_SHARE) * self.duration_s
        self.error_rad, self.speed_rad_s, self.effort_share = (GridSeries(n_joints, end_s) for _ in range(3))
        drawn = thinned(len(goal.equilibrium_rad))
        self.desired_m = chain.hand_positions(goal.desired.position_rad[drawn])
        """Where the hand should go. Shape (n, 3)."""
        self.equilibrium_m = chain.hand_positions(goal.equilibrium_rad[drawn])
        """Where the springs pull it. Shape (n, 3)."""
        time_s, cells = goal.desired.time_ns / 1e9, self.error_rad.time_s

        def on_grid(values: FloatArray) -> FloatArray:
            columns = [np.interp(cells, time_s, column, right=np.nan) for column in values.T]
            return np.stack(columns, axis=1)

        self.desired_speed_rad_s = on_grid(goal.desired.velocity_rad_s)
        """Over the times of the grids. Shape (n_cells, n_joints)."""
        known = std_rad.shape == goal.equilibrium_rad.shape and bool(np.isfinite(std_rad).all())
        self.std_rad = on_grid(std_rad) if known else np.full_like(self.desired_speed_rad_s, np.nan)
        """Of the error in û, which the error of the motion is compared with; NaN: nothing is known yet."""
        self.is_std_known = known
        self._path_rad: list[FloatArray] = []
        self._gaps: list[int] = []
        self._last_point_s = -np.inf

    @property
    def hand_m(self) -> FloatArray:
        """Where the hand has been since the start of RUN; NaN where that is not known. Shape (n, 3)."""
        if not self._path_rad:
            return np.zeros((0, 3))
        return np.insert(self._chain.hand_positions(np.array(self._path_rad)), self._gaps, np.nan, axis=0)

    def see(self, sample: Sample) -> None:
        """Take in a sample of this trial; what is not of its movement is left out."""
        if sample.trial != self.index or sample.time_from_start_s < 0.0:
            return
        time_s = sample.time_from_start_s
        if sample.phase in (Phase.RUN, Phase.STOP):
            self._add_point(time_s, sample.position_rad)
        if sample.phase in (Phase.RUN, Phase.HOLD):
            self.error_rad.add(time_s, sample.position_rad - sample.desired_rad)
        self.speed_rad_s.add(time_s, sample.velocity_rad_s)
        self.effort_share.add(time_s, sample.effort_nm / self._limit_nm)

    def _add_point(self, time_s: float, position_rad: FloatArray) -> None:
        share = (time_s - self._last_point_s) / self.duration_s
        if share < 1.0 / MEASURED_POINTS:
            return
        if self._path_rad and share > GAP_SHARE:
            self._gaps.append(len(self._path_rad))
        self._path_rad.append(position_rad)
        self._last_point_s = time_s


def thinned(n: int) -> FloatArray:
    """Return which of n points to draw, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, PATH_POINTS)).round().astype(int))
