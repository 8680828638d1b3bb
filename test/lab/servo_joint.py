"""One joint on its virtual spring, in formulas: I q̈ = K (u - q) - B q̇."""

from __future__ import annotations

import numpy as np

from tel_ros.core.learning.signals import TrialSignals
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.types import NS_PER_S, FloatArray

RATE_HZ = 200.0
PERIOD_S = 1.0 / RATE_HZ
STIFFNESS, DAMPING, INERTIA = 15.0, 1.5, 0.3
DAMPING_S = np.array([DAMPING / STIFFNESS])
_SUBSTEPS, _HOLD = 10, 100


def swing(duration_s: float = 2.0, amplitude_rad: float = 0.5) -> DesiredTrajectory:
    """Return a movement there and back."""
    omega = 2.0 * np.pi

    def evaluate(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        s = s[:, None]
        return (
            0.5 * amplitude_rad * (1.0 - np.cos(omega * s)),
            0.5 * amplitude_rad * omega * np.sin(omega * s),
            0.5 * amplitude_rad * omega**2 * np.cos(omega * s),
        )

    return sample(Path("swing", 1, evaluate), duration_s, RATE_HZ)


def execute(desired: DesiredTrajectory, command_rad: FloatArray, n_run: int | None = None) -> TrialSignals:
    """Return what is recorded when the command is sent from rest, and held for a while after its end."""
    n = len(command_rad) if n_run is None else n_run
    rows = np.minimum(np.arange(n + (_HOLD if n_run is None else 0)), len(command_rad) - 1)
    q, v, positions = float(desired.position_rad[0, 0]), 0.0, []
    for u in command_rad[rows, 0]:
        positions.append(q)
        for _ in range(_SUBSTEPS):
            effort = STIFFNESS * (u - q) - DAMPING * v
            v += effort / INERTIA * PERIOD_S / _SUBSTEPS
            q += v * PERIOD_S / _SUBSTEPS
    y = np.hstack([desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2])
    return TrialSignals(
        time_ns=np.round(np.arange(len(rows)) * PERIOD_S * NS_PER_S).astype(np.int64),
        run=np.arange(len(rows)) < n,
        desired=y[rows],
        position_rad=np.array(positions)[:, None],
        equilibrium_rad=command_rad[rows],
        saturated=np.zeros((len(rows), 1), dtype=bool),
    )


def rms_error(trial: TrialSignals) -> float:
    """Return the RMS tracking error in rad over RUN."""
    return float(np.sqrt(np.mean((trial.position_rad - trial.desired[:, :1])[trial.run] ** 2)))
