"""Small run folders made of numbers, written with the same writers as real ones."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import sim_bridge
from tel_ros.core.config import ArmConfig, Config, PathConfig, PracticeConfig
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.practice.strategy import Movement, PlannedTrial
from tel_ros.core.trial import LoopTiming, Outcome, Phase, TrialReport
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import TrialBagWriter
from tel_ros.recording.run_folder import create_run_folder, trial_bag
from tel_ros.recording.summary import RunSummary, TrialRow
from tel_ros.recording.trial_result import result_fields

URDF = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm.urdf"
JOINTS = ("shoulder", "elbow")
LINK_M = 0.33  # both of them
RATE_HZ = 25.0
LIMIT_NM = 20.0

MakeRun = Callable[..., Path]
"""``make_run(trials(3), outcome="aborted", message="why")`` writes a run folder."""


@dataclass(frozen=True)
class Trial:
    """What a trial of a made-up run is like."""

    index: int = 1
    duration_s: float = 1.0
    outcome: Outcome = Outcome.COMPLETED
    message: str = ""
    reached_run: bool = True
    saturated: bool = False
    timing: LoopTiming | None = None
    path: str = ""
    std_rad: tuple[float, ...] = ()
    """What the network expected of its command: one value a point of the goal, for both joints alike."""
    grown: list[str] = field(default_factory=lambda: ["shoulder: subtree 1 under Gaussian 2", "a new root"])

    @property
    def n_points(self) -> int:
        """Points of its goal, and ticks of a movement that was not broken off."""
        return round(self.duration_s * RATE_HZ) + 1


def trials(n: int) -> list[Trial]:
    return [Trial(index=i + 1, duration_s=2.0 - i / max(1, n)) for i in range(n)]


def desired_rad(share: np.ndarray) -> np.ndarray:
    return np.column_stack([0.6 + 0.45 * np.sin(2 * np.pi * share), 1.3 + 0.3 * np.cos(2 * np.pi * share)])


def stamp(time_ns: int) -> Any:
    return typestore().types["builtin_interfaces/msg/Time"](
        sec=time_ns // NS_PER_S, nanosec=time_ns % NS_PER_S
    )


def write_bag(bag: Path, trial: Trial) -> TrialReport:
    """Write a bag with SETTLE, RUN and HOLD, the hand 0.05 rad off in RUN and far away outside of it."""
    types, serialise = typestore().types, typestore().serialize_cdr
    n_run = trial.n_points if trial.reached_run else 0
    phases = [Phase.SETTLE] * 3 + [Phase.RUN] * n_run + [Phase.HOLD] * 3
    period_ns = round(NS_PER_S / RATE_HZ)
    with TrialBagWriter(bag, {"trial": str(trial.index)}) as writer:
        for tick, phase in enumerate(phases):
            share = np.clip((tick - 3) / max(1, n_run - 1), 0.0, 1.0)
            wanted = desired_rad(np.array([share]))[0]
            actual = wanted + (0.05 if phase == Phase.RUN else 1.0)
            clipped = trial.saturated and tick == 10
            state = types["tel_interfaces/msg/ControlState"](
                header=types["std_msgs/msg/Header"](stamp=stamp(tick * period_ns), frame_id=""),
                trial=trial.index,
                phase=int(phase),
                time_from_start_s=(tick - 3) / RATE_HZ,
                desired_position_rad=wanted,
                desired_velocity_rad_s=np.zeros(2),
                desired_acceleration_rad_s2=np.zeros(2),
                equilibrium_rad=wanted - 0.1,
                position_rad=actual,
                velocity_rad_s=np.zeros(2),
                effort_nm=np.array([LIMIT_NM if clipped else 8.0 * math.sin(tick / 5.0), 1.0]),
                saturated=np.array([clipped, False]),
            )
            kind = topics.RECORDED_LIVE[topics.CONTROL_STATES]
            writer.write(topics.CONTROL_STATES, tick * period_ns, serialise(state, kind))
        writer.write(topics.TRIAL_GOAL, 0, goal_message(trial))
        report = report_of(trial, len(phases))
        kind = topics.RECORDED_ONCE[topics.TRIAL_RESULT]
        fields = result_fields(replace(report, end_ns=len(phases) * period_ns), stamp)
        arrays = {key: np.array(value) for key, value in fields.items() if isinstance(value, array)}
        result = types[kind](joint_names=list(JOINTS), **{**fields, **arrays})
        writer.write(topics.TRIAL_RESULT, len(phases) * period_ns, serialise(result, kind))
    return report


def goal_message(trial: Trial) -> bytes:
    """Return the goal of a trial: its points lie as far apart as the ticks."""
    n = trial.n_points
    wanted = desired_rad(np.linspace(0.0, 1.0, n))
    kind = topics.RECORDED_ONCE[topics.TRIAL_GOAL]
    goal = typestore().types[kind](
        trial=trial.index,
        alpha=1.0 / trial.duration_s,
        joint_names=list(JOINTS),
        time_ns=np.arange(n) * round(NS_PER_S / RATE_HZ),
        position_rad=wanted.ravel(),
        velocity_rad_s=np.zeros(2 * n),
        acceleration_rad_s2=np.zeros(2 * n),
        equilibrium_rad=(wanted - 0.1).ravel(),
        stiffness_nm_per_rad=np.empty(0),
        damping_nms_per_rad=np.empty(0),
        std_rad=np.repeat(trial.std_rad, 2),
    )
    return bytes(typestore().serialize_cdr(goal, kind))


def report_of(trial: Trial, ticks: int) -> TrialReport:
    error_rad = 0.05 / trial.index if trial.reached_run else math.nan
    return TrialReport(
        index=trial.index,
        alpha=1.0 / trial.duration_s,
        duration_s=trial.duration_s,
        outcome=trial.outcome,
        message=trial.message,
        start_ns=0,
        run_ns=1 if trial.reached_run else 0,
        end_ns=ticks,
        ticks=ticks,
        rms_error_rad=error_rad,
        rms_error_per_joint_rad=np.full(2, error_rad),
        max_error_rad=2.0 * error_rad if trial.reached_run else 0.0,
        max_effort_nm=np.array([8.0, 1.0]),
        saturated_ratio=0.01 if trial.saturated else 0.0,
        timing=trial.timing,
    )


def write_run(
    folder: Path,
    made_of: list[Trial],
    *,
    outcome: str = "completed",
    message: str = "",
    arm_name: str = "test_arm",
) -> Path:
    """Write the folder of a run that had these trials."""
    paths = tuple(dict.fromkeys(trial.path for trial in made_of if trial.path))  # built-in ones: no files
    config = Config(
        arm=ArmConfig(
            name=arm_name,
            urdf=str(URDF),
            joints=JOINTS,
            hand_link="hand",
            stiffness_nm_per_rad=(15.0, 15.0),
            damping_nms_per_rad=(1.5, 1.5),
            effort_limit_nm=(LIMIT_NM, LIMIT_NM),
        ),
        path=PathConfig(files=paths) if paths else PathConfig(name="planar_loops"),
        practice=PracticeConfig(trials=max(1, len(made_of))),
        seed=77,
    )
    summary = RunSummary(folder, create_run_folder(folder, config))
    for trial in made_of:
        bag = trial_bag(folder, trial.index)
        report = write_bag(bag, trial)
        plan = PlannedTrial(trial.index, report.alpha, Movement(report.duration_s, path=trial.path))
        learned = TrainingOutcome(0.04321, 0.00321, math.nan, tuple(trial.grown))
        training = learned if trial.outcome == Outcome.COMPLETED else None
        summary.add(TrialRow.of(PractisedTrial(plan, report, bag, training), bag.name, 1.25))
    summary.end(outcome, message)
    return folder
