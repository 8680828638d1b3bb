"""How well torque is learned from a bag that this project did not record.

A seven-joint arm under gravity with dry friction moves for a minute in simulation, on sums of sines which
never repeat. A bag of its joint states, with encoders, noisy efforts and uneven stamps, is imported as if it
were anybody's; the URDF has the right kinematics and wrong inertias. Then the network is asked about a
movement 2.5 times as fast.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rosbags.rosbag2 import StoragePlugin
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from tel_lab.inverse_dynamics.arm_models import iiwa_urdf, with_wrong_inertias
from tel_lab.inverse_dynamics.recorded_arm import (
    ENCODER_BITS,
    FASTEST_HZ,
    Motion,
    moved,
    recorded,
    sines,
    write_bag,
)
from tel_lab.study import StudyOptions, study
from tel_lab.tables import Column, Table
from tel_ros.app.torque_import import extrapolation_warning, import_and_train
from tel_ros.core.learning.noise import low_pass
from tel_ros.core.learning.torque_fit import HeldOutError, held_out_error, predict_torque
from tel_ros.core.learning.torque_samples import chosen_cutoff_hz, motion, torque_samples
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray
from tel_ros.recording.foreign.recordings import read_sources
from tel_ros.recording.network_file import load_network

FAST = 2.5
FASTEST = 5.0
"""Factors on the frequencies of the motion."""
LEARNERS: dict[str, dict[str, Any]] = {
    "rigid_body": {"learner": "rigid_body"},
    "rigid_body+lms_tree": {"learner": "rigid_body+lms_tree"},
    "lms_tree, least squares": {"learner": "lms_tree"},
    "lms_tree, LMS": {"learner": "lms_tree", "weights": "lms"},
}
RATES_HZ = (30.0, 125.0, 1000.0)
RATE_HZ = 125.0


@dataclass(frozen=True)
class Imported:
    """A network that was made from a recording, on what was held out and on a faster movement."""

    recording: str
    learner: str
    held_out: HeldOutError
    fast: HeldOutError
    cpu_s: float
    warning: str


def imported(slow: Motion, fast: Motion, rate_hz: float, label: str) -> Imported:
    """Record both movements, import the slow one, and ask about the fast one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = folder / "arm.urdf"
        urdf.write_text(with_wrong_inertias(iiwa_urdf()), encoding="utf-8")
        bags = folder / "slow", folder / "fast"
        write_bag(recorded(slow, rate_hz, seed=1), bags[0], StoragePlugin.MCAP)
        write_bag(recorded(fast, rate_hz, seed=2), bags[1], StoragePlugin.SQLITE3)
        out, settings = folder / "network.npz", LEARNERS[label]
        start = time.process_time()
        fit, _ = import_and_train(bags[:1], out, urdf=str(urdf), **settings)
        cpu_s = time.process_time() - start
        learner = load_network(out)
        recordings, _, _ = read_sources(bags[1:])
        parts = [part for recording in recordings for part in torque_samples(recording)]
        asked = [(part.torque_nm, predict_torque(learner, part.inputs)) for part in parts]
        warning = extrapolation_warning(learner, asked[0][1])
        return Imported(f"{rate_hz:g} Hz", label, fit.held_out, held_out_error(asked), cpu_s, warning)


COLUMNS: tuple[Column[Imported], ...] = (
    Column("recording", lambda row: row.recording, left=True),
    Column("learner", lambda row: row.learner, left=True),
    Column("held-out nMSE", lambda row: row.held_out.nmse.mean(), ".4f"),
    Column("worst joint", lambda row: row.held_out.nmse.max(), ".4f"),
    Column("fast nMSE", lambda row: row.fast.nmse.mean(), ".4f"),
    Column("fast within 2 std", lambda row: row.fast.within_2_std, ".0%"),
    Column("flagged held out", lambda row: row.held_out.extrapolated, ".0%"),
    Column("flagged fast", lambda row: row.fast.extrapolated, ".0%"),
    Column("CPU [s]", lambda row: row.cpu_s, ".1f"),
)


def acceleration_errors(desired: DesiredTrajectory, rate_hz: float) -> tuple[float, float, float, float]:
    """Return the relative errors of the four methods for a motion that is read by encoders at a rate."""
    rng, step_rad, period_s = np.random.default_rng(5), 2.0 * np.pi / 2**ENCODER_BITS, 1.0 / rate_hz
    time_s = np.arange(1.0, 59.0, period_s)
    exact, truth = (
        CubicSpline(desired.time_s, values)(time_s)
        for values in (desired.position_rad, desired.acceleration_rad_s2)
    )
    q = np.round((exact + rng.normal(0.0, step_rad, exact.shape)) / step_rad) * step_rad
    smooth = low_pass(q, chosen_cutoff_hz(q, period_s), period_s)
    inner = slice(round(rate_hz), -round(rate_hz))

    def wrong(found: FloatArray) -> float:
        return float(np.mean((found - truth)[inner].std(axis=0) / truth[inner].std(axis=0)))

    def differences(values: FloatArray) -> FloatArray:
        return np.gradient(np.gradient(values, time_s, axis=0), time_s, axis=0)

    windows = sorted({int(w) // 2 * 2 + 1 for w in np.geomspace(5.0, rate_hz, 25)})
    best = min(wrong(savgol_filter(q, w, 4, deriv=2, delta=period_s, axis=0)) for w in windows)
    spline = np.split(motion(time_s, smooth), 3, axis=1)[2]
    return wrong(differences(q)), best, wrong(differences(smooth)), wrong(spline)


Errors = tuple[float, float, tuple[float, ...]]
"""Rate, factor on the frequencies, and RMS error over RMS acceleration by four methods, mean of the joints.

The Savitzky-Golay filter (degree 4) gets the best of all its windows, which only the truth can tell."""


def _percent(heading: str, method: int) -> Column[Errors]:
    return Column(heading, lambda row: f"{100.0 * row[2][method]:.3g} %")


ACCELERATION_COLUMNS: tuple[Column[Errors], ...] = (
    Column("rate", lambda row: f"{row[0]:g} Hz", left=True),
    Column("motion up to", lambda row: f"{row[1] * FASTEST_HZ:g} Hz", left=True),
    _percent("differences alone", 0),
    _percent("Savitzky-Golay, best window", 1),
    _percent("Butterworth, differences", 2),
    _percent("Butterworth, spline", 3),
)


@study(sets=False)
def import_bag(options: StudyOptions) -> None:
    """Import a bag that this project did not record, and ask about a faster movement; prints tables.

    CPU time is measured, so that it depends less on what else the machine does.
    """
    quick = options.quick
    slow, fast = moved(20.0 if quick else 60.0, 1.0, seed=1), moved(10.0 if quick else 20.0, FAST, seed=2)
    pairs = [
        (rate_hz, label)
        for rate_hz in RATES_HZ
        for label in (list(LEARNERS) if rate_hz == RATE_HZ and not quick else ["rigid_body"])
    ]
    tasks = {f"{rate_hz:g} Hz, {label}": (slow, fast, rate_hz, label) for rate_hz, label in pairs}
    rows = list(options.results(imported, tasks))
    click.echo(Table(COLUMNS, rows).markdown())
    for warning in [row.warning for row in rows if row.learner.startswith("lms_tree")][-1:]:
        click.echo(f"\nOf the tree, about the fast movement: {warning}")
    accelerations = [
        (rate_hz, speed, acceleration_errors(sines(60.0, speed, np.random.default_rng(1)), rate_hz))
        for speed in (1.0, FASTEST)
        for rate_hz in RATES_HZ
    ]
    click.echo(f"\n{Table(ACCELERATION_COLUMNS, accelerations).markdown()}")
