"""How well torque is learned from a bag that this project did not record: a table.

    .venv/bin/python benchmarks/import_bag.py [--quick]

A seven-joint arm under gravity with dry friction moves for a minute in simulation, on sums of sines which
never repeat. A bag of its joint states, with encoders, noisy efforts and uneven stamps, is imported as if it
were anybody's; the URDF has the right kinematics and wrong inertias. Then the network is asked about a
movement 2.5 times as fast. Prints tables in Markdown, as they are in docs/imported-bags.md. CPU time
is measured, so that it depends less on what else the machine does.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from inverse_dynamics_data import iiwa_urdf, with_wrong_inertias
from recorded_arm import ENCODER_BITS, FASTEST_HZ, moved, recorded, sines, write_bag
from rosbags.rosbag2 import StoragePlugin
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from tel_ros.app.imported import ImportRequest, extrapolation_warning, import_and_train
from tel_ros.core.learning.noise import low_pass
from tel_ros.core.learning.torque_fit import held_out_error, predict_torque
from tel_ros.core.learning.torque_samples import chosen_cutoff_hz, motion, torque_samples
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray
from tel_ros.recording.foreign.recordings import read_sources
from tel_ros.recording.network_file import load_network

FAST = 2.5
FASTEST = 5.0
"""Factors on the frequencies of the motion."""
LEARNERS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("rigid_body", {"learner": "rigid_body"}),
    ("rigid_body+lms_tree", {"learner": "rigid_body+lms_tree"}),
    ("lms_tree, least squares", {"learner": "lms_tree"}),
    ("lms_tree, LMS", {"learner": "lms_tree", "weights": "lms"}),
)
RATES_HZ = (30.0, 125.0, 1000.0)
RATE_HZ = 125.0
HEADER = (
    "recording",
    "learner",
    "held-out nMSE",
    "worst joint",
    "fast nMSE",
    "fast within 2 std",
    "flagged held out",
    "flagged fast",
    "CPU [s]",
)


def main() -> None:
    """Make the recordings, import them and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="A movement of 20 s, and rigid links alone.")
    quick = parser.parse_args().quick
    slow, fast = moved(20.0 if quick else 60.0, 1.0, seed=1), moved(10.0 if quick else 20.0, FAST, seed=2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = folder / "arm.urdf"
        urdf.write_text(with_wrong_inertias(iiwa_urdf()), encoding="utf-8")
        print("| " + " | ".join(HEADER) + " |")
        print("| --- | --- |" + " ---: |" * (len(HEADER) - 2))
        warning = ""
        for rate_hz in RATES_HZ:
            bags = [folder / f"{what}_{rate_hz:g}" for what in ("slow", "fast")]
            write_bag([recorded(slow, rate_hz, seed=1)], bags[0], StoragePlugin.MCAP)
            write_bag([recorded(fast, rate_hz, seed=2)], bags[1], StoragePlugin.SQLITE3)
            for label, options in LEARNERS if rate_hz == RATE_HZ and not quick else LEARNERS[:1]:
                out = folder / f"{label} {rate_hz:g}.npz"
                request = ImportRequest(sources=(bags[0],), out=out, urdf=str(urdf), **options)
                cells, said = row(request, bags[1])
                print(f"| {rate_hz:g} Hz | {label} | " + " | ".join(cells) + " |", flush=True)
                warning = said if label.startswith("lms_tree") else warning
        if warning:
            print(f"\nOf the tree, about the fast movement: {warning}")
    print()
    print("\n".join(acceleration_table()))


def row(request: ImportRequest, fast: Path) -> tuple[list[str], str]:
    """Import a bag, ask about a faster one; return the figures, and what is said about the faster one."""
    start = time.process_time()
    held_out = import_and_train(request).fit.held_out
    cpu_s = time.process_time() - start
    learner = load_network(request.out)
    recordings, _ = read_sources([fast])
    parts = [part for recording in recordings for part in torque_samples(recording)]
    asked = [(part.torque_nm, predict_torque(learner, part.inputs)) for part in parts]
    outside = held_out_error(asked)
    cells = [
        f"{held_out.nmse.mean():.4f}",
        f"{held_out.nmse.max():.4f}",
        f"{outside.nmse.mean():.4f}",
        f"{outside.within_2_std:.0%}",
        f"{held_out.extrapolated:.0%}",
        f"{outside.extrapolated:.0%}",
        f"{cpu_s:.1f}",
    ]
    return cells, extrapolation_warning(learner, asked[0][1])


def acceleration_table() -> list[str]:
    """Return how wrong accelerations are by four methods: RMS error over RMS acceleration, mean of joints.

    The Savitzky-Golay filter (degree 4) gets the best of all its windows, which only the truth can tell.
    """
    header = (
        "rate",
        "motion up to",
        "differences alone",
        "Savitzky-Golay, best window",
        "Butterworth, differences",
        "Butterworth, spline",
    )
    lines = ["| " + " | ".join(header) + " |", "| --- | --- |" + " ---: |" * 4]
    for speed in (1.0, FASTEST):
        desired = sines(60.0, speed, np.random.default_rng(1))
        for rate_hz in RATES_HZ:
            figures = acceleration_errors(desired, rate_hz)
            row = " | ".join(f"{100.0 * f:.3g} %" for f in figures)
            lines.append(f"| {rate_hz:g} Hz | {speed * FASTEST_HZ:g} Hz | {row} |")
    return lines


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


if __name__ == "__main__":
    main()
