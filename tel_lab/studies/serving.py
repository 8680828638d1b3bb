"""A service that knows nothing is asked for pick-and-place movements at full speed, in random order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflineArm
from tel_lab.study import ROOT, Chapter, StudyOptions, study
from tel_lab.tables import Column, Table
from tel_lab.trial_record import duration_at_effort_share, excursion_rad, fastest_by_speed_s
from tel_ros.core.config import Config
from tel_ros.core.errors import NetworkFileError
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.session import Prediction, predicted, trained
from tel_ros.core.serving.memory import ServiceMemory
from tel_ros.core.serving.reference import Points, Reference
from tel_ros.core.serving.session import ServingSession
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.trial import Outcome, Trial, TrialGoal
from tel_ros.core.types import NS_PER_S, FloatArray, IntArray
from tel_ros.recording.config_file import load_config
from tel_ros.recording.service_folder import KEPT_NETWORKS, first_network

CASES = {
    "planar arm, no model": ("planar_arm.yaml", "polynomial", 0.015),
    "planar arm, kinematics": ("planar_arm.yaml", "rigid_body", 0.015),
    "iiwa, kinematics": ("kuka_iiwa.yaml", "rigid_body", 0.005),
}
"""Configuration, learner, and serve.tolerance_rad."""
MOVEMENTS, TIMES, EFFORT_SHARE, SPEED_SHARE = 20, 6, 0.4, 0.9
REACH_RAD, RANGE_SHARE, POINT_S = 0.9, 0.8, 0.05
STIFFER = 10.0
FIRST = 20


class InMemory:
    """Network and store of a service in this process."""

    def __init__(self, config: Config) -> None:
        self._config, self._learner = config, first_network(config)
        self._after = {0: self._learner}

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        return predicted(self._learner, desired, self._config.control.rate_hz)

    def train(self, trial: Trial) -> TrainingOutcome:
        self._learner, outcome = trained(self._learner, trial, self._config)
        return outcome

    def save(self, index: int) -> None:
        self._after[index] = self._learner

    def load(self, index: int) -> None:
        if index not in self._after:
            raise NetworkFileError(index, "is not kept", "one of the last")
        self._learner = self._after[index]

    def keep(self, memory: ServiceMemory) -> None:
        for index in self.networks()[:-KEPT_NETWORKS]:
            del self._after[index]

    def networks(self) -> list[int]:
        return sorted(self._after)


@dataclass(frozen=True)
class Execution:
    """One execution: of which movement, how often that was asked for, and how it went."""

    movement: int
    time: int
    slowdown: float
    error_rad: float
    deviation_rad: float
    completed: bool

    @classmethod
    def of(cls, movement: int, time: int, slowdown: float, trial: Trial) -> Execution:
        completed = trial.report.outcome == Outcome.COMPLETED
        return cls(movement, time, slowdown, trial.report.rms_error_rad, excursion_rad(trial), completed)


def pick_and_place(config: Config, n: int, seed: int) -> list[Points]:
    """Return movements from home to a random posture, to another one and home again, as planners give them.

    Each leg goes straight in joint space, from rest to rest, in the shortest time in which a joint needs
    :data:`EFFORT_SHARE` of its effort or :data:`SPEED_SHARE` of its speed, by the exact model.
    """
    arm, random = config.arm, np.random.default_rng((0x736572, seed))
    home = np.array(config.sim.initial_position_rad)
    low, high = np.array(arm.position_min_rad), np.array(arm.position_max_rad)
    half = 0.5 * RANGE_SHARE * (high - low)
    exact, found = ExactInverseDynamics(config, config.sim), []
    for _ in range(n):
        away = np.clip(
            home + random.uniform(-REACH_RAD, REACH_RAD, (2, len(home))),
            0.5 * (low + high) - half,
            0.5 * (low + high) + half,
        )
        legs, begins_ns = [home, *away, home], 0
        time_ns: list[IntArray] = [np.zeros(1, dtype=np.int64)]
        rows: list[FloatArray] = [np.array([[home, 0.0 * home, 0.0 * home]])]
        for start, end in zip(legs, legs[1:], strict=False):
            path = straight(start, end)
            fastest_s = fastest_by_speed_s(arm, path, SPEED_SHARE)
            desired = sample(
                path, duration_at_effort_share(arm, exact, path, EFFORT_SHARE, fastest_s), 1 / POINT_S
            )
            states = desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2
            time_ns.append(begins_ns + desired.time_ns[1:])
            rows.append(np.stack(states, axis=1)[1:])
            begins_ns += int(desired.time_ns[-1])
        points = np.concatenate(rows)
        found.append(Points(np.concatenate(time_ns), points[:, 0], points[:, 1], points[:, 2]))
    return found


def straight(start: FloatArray, end: FloatArray) -> Path:
    """Return the straight line between two postures."""

    def evaluate(s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        way = np.tile(end - start, (len(s), 1))
        return start + s[:, None] * way, way, 0.0 * way

    return Path("straight", len(start), evaluate)


def in_service(config: Config, movements: Sequence[Points], times: int, seed: int) -> list[Execution]:
    """Ask a service that knows nothing for each movement so many times, in random order."""
    order = np.random.default_rng((0x6F72, seed)).permutation(np.repeat(np.arange(len(movements)), times))
    network, asked, done = InMemory(config), Counter[int](), []
    with OfflineArm(config) as arm:
        session = ServingSession(config, arm, network, network, ServiceMemory())
        for movement in order.tolist():
            asked[movement] += 1
            here = np.array(arm.plant.true_position_rad)
            served = session.execute(session.decide(movements[movement], here))
            slowdown = served.decision.slowdown
            done.append(Execution.of(movement, asked[movement], slowdown, served.trial))
    return done


def unlearned(config: Config, movements: Sequence[Points], stiffer: float) -> list[Execution]:
    """Return what joint_trajectory_controller alone makes of each movement at full speed.

    Its law, K (y - q) + B (ẏ - q̇), is that of the equilibrium point û = y + B ẏ / K. ``stiffer``: factor on
    K; B goes with its root.
    """
    springs, done = Springs.of(config.arm).scaled(stiffer), []
    for k, points in enumerate(movements):
        with OfflineArm(config) as arm:  # a new one: after some aborts no other trial would start
            reference = Reference(points, np.array(arm.plant.true_position_rad))
            desired = reference.desired(1.0, config.control.rate_hz)
            lead_s = springs.damping_nms_per_rad / springs.stiffness_nm_per_rad
            command = desired.position_rad + lead_s * desired.velocity_rad_s
            done.append(
                Execution.of(k, 1, 1.0, arm.run_trial(TrialGoal(k + 1, 1.0, desired, command, springs)))
            )
    return done


def chapter(name: str, overrides: tuple[str, ...], movements: int, times: int) -> Chapter:
    """Serve one arm; return the tables, and what is wanted."""
    file, learner, tolerance_rad = CASES[name]
    own = f"learning.name={learner}", f"serve.tolerance_rad={tolerance_rad}"
    config = load_config(ROOT / "config" / file, (*own, *overrides))
    low, high = np.array(config.arm.position_min_rad), np.array(config.arm.position_max_rad)
    config = replace(config, sim=replace(config.sim, initial_position_rad=tuple(0.5 * (low + high))))
    asked = pick_and_place(config, movements, seed=1)
    done = in_service(config, asked, times, seed=1)
    slower = [0] * movements  # the last time that it was, of each movement
    for each in done:
        if each.slowdown > 1.0 or not each.completed:
            slower[each.movement] = each.time
    counts = Counter(time + 1 for time in slower)
    last = [each for each in done if each.time == times]
    rows = {
        "in service, all executions": done,
        "in service, the last of each": last,
        "unlearned": unlearned(config, asked, 1.0),
        f"unlearned, p {STIFFER:g} times as high": unlearned(config, asked, STIFFER),
    }

    def mrad(of: str, function: str) -> Column[str]:
        def value(row: str) -> float:
            return 1e3 * float(getattr(np, function)([getattr(each, of) for each in rows[row]]))

        shown = {"median": "median", "max": "worst"}[function]
        return Column(f"{of.removesuffix('_rad')} [mrad], {shown}", value, ".2f")

    table = Table(
        [
            Column("", lambda row: row, left=True),
            mrad("error_rad", "median"),
            mrad("error_rad", "max"),
            mrad("deviation_rad", "max"),
            Column("aborted", lambda row: sum(not each.completed for each in rows[row])),
            Column("slower", lambda row: sum(each.slowdown > 1.0 for each in rows[row])),
        ],
        list(rows),
    ).markdown()
    durations_s = [points.time_ns[-1] / NS_PER_S for points in asked]
    asked_for = ", ".join(
        f"{'never' if k > times else k} ({counts[k]})" for k in range(1, times + 2) if counts[k]
    )
    text = (
        f"Movements of {min(durations_s):.2f} to {max(durations_s):.2f} s. As requested from which execution "
        f"of a movement on (movements): {asked_for}. Of the first {FIRST} executions of all, "
        f"{sum(each.slowdown > 1.0 for each in done[:FIRST])} were slower, of the last {FIRST} "
        f"{sum(each.slowdown > 1.0 for each in done[-FIRST:])}.\n\n{table}"
    )
    worst_rad = max(each.error_rad for each in last)
    as_requested = sum(each.slowdown == 1.0 for each in last)
    targets = [
        (
            "every movement runs as requested in the end",
            f"{as_requested} of {movements}",
            as_requested == movements,
        ),
        (
            f"then with at most {1e3 * config.serve.tolerance_rad:g} mrad RMS",
            f"{1e3 * worst_rad:.2f} mrad",
            worst_rad <= tolerance_rad,
        ),
        ("nothing is aborted", str(sum(not e.completed for e in done)), all(e.completed for e in done)),
    ]
    return text, targets


@study()
def serving(options: StudyOptions) -> None:
    """Ask a service that knows nothing for pick-and-place movements at full speed."""
    movements, times = (3, 3) if options.quick else (MOVEMENTS, TIMES)
    options.chapters(
        "serving.md",
        list(CASES),
        chapter,
        options.overrides,
        movements,
        times,
        movements=movements,
        times=times,
        effort_share=EFFORT_SHARE,
        speed_share=SPEED_SHARE,
    )
