"""Practice of every ready arm, from slow to its goal speed: what comes out, judged by its numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import starmap

import numpy as np

from tel_lab.study import ROOT, Chapter, StudyOptions, study
from tel_lab.tables import Column, Table
from tel_lab.trial_record import fastest_feasible_s, practise
from tel_ros.core.config import Config
from tel_ros.core.practice.session import PractisedTrial
from tel_ros.core.trial import Outcome, Trial
from tel_ros.recording.config_file import load_config

CONFIGS = ROOT / "config"
N_STEPS = 15
MODEL_FREE_REPEATS, RIGID_BODY_REPEATS = 3, 2


@dataclass(frozen=True)
class Practised:
    """A practice run on a schedule that is even in torque; so many trials at its end repeat the goal."""

    config: Config
    trials: Sequence[PractisedTrial[Trial]]
    repeats: int

    @property
    def first(self) -> PractisedTrial[Trial]:
        return self.trials[-1 - self.repeats]

    @property
    def last(self) -> PractisedTrial[Trial]:
        return self.trials[-1]

    @property
    def within_limits(self) -> bool:
        """Whether every trial was completed, no effort was clipped and no measured joint left its range."""
        arm = self.config.arm
        return all(
            trial.report.outcome == Outcome.COMPLETED
            and not trial.trial.saturated.any()
            and bool(np.all(trial.trial.position_rad >= np.array(arm.position_min_rad)))
            and bool(np.all(trial.trial.position_rad <= np.array(arm.position_max_rad)))
            for trial in self.trials
        )


def rms_mrad(trial: PractisedTrial[Trial]) -> float:
    return 1e3 * trial.report.rms_error_rad


def worst_joint_mrad(trial: PractisedTrial[Trial]) -> float:
    return 1e3 * float(np.max(trial.report.rms_error_per_joint_rad))


def schedule(config: Config, repeats: int) -> str:
    """Return durations even in torque, then repeats of the goal, as an option."""
    first_s, goal_s = config.practice.first_duration_s, config.practice.goal_duration_s
    durations_s = 1.0 / np.sqrt(np.linspace(first_s**-2, goal_s**-2, N_STEPS))
    durations_s[-1] = goal_s
    return f"practice.durations_s={[*durations_s.tolist(), *[goal_s] * repeats]}"


def on_schedule(file: str, repeats: int, *overrides: str) -> Practised:
    config = load_config(CONFIGS / file, overrides)
    overrides = ("practice.strategy=trajectory_extension", *overrides, schedule(config, repeats))
    config = load_config(CONFIGS / file, overrides)
    return Practised(config, practise(config)[0], repeats)


def unlearned(file: str) -> PractisedTrial[Trial]:
    """Return one trial at the goal speed with nothing learned, to its end: without speed limits."""
    overrides = ["practice.strategy=direct", "practice.trials=1"]
    no_limits = [1e6] * len(load_config(CONFIGS / file).arm.joints)
    return practise(load_config(CONFIGS / file, [*overrides, f"arm.velocity_limit_rad_s={no_limits}"]))[0][0]


def errors(trial: PractisedTrial[Trial]) -> str:
    return f"{rms_mrad(trial):.2f} ({worst_joint_mrad(trial):.2f})"


def table(runs: dict[str, Practised]) -> str:
    longest = max((run.trials for run in runs.values()), key=len)

    def of(name: str, run: Practised) -> Column[int]:
        return Column(name, lambda k: errors(run.trials[k]) if k < len(run.trials) else "")

    columns: list[Column[int]] = [
        Column("trial", lambda k: k + 1),
        Column("duration [s]", lambda k: longest[k].report.duration_s, ".3f"),
        *starmap(of, runs.items()),
    ]
    return Table(columns, range(len(longest))).markdown()


def seven_joints(file: str) -> Chapter:
    start = unlearned(file)
    free = on_schedule(file, MODEL_FREE_REPEATS)
    friction_nm = [0.01 * limit for limit in free.config.arm.effort_limit_nm]
    rigid = on_schedule(file, RIGID_BODY_REPEATS, "learning.name=rigid_body")
    friction = f"sim.coulomb_friction_nm={friction_nm}"
    rough = on_schedule(file, RIGID_BODY_REPEATS, "learning.name=rigid_body", friction)
    runs = {"model-free": free, "rigid body": rigid, "rigid body, dry friction": rough}
    without, first, last = rms_mrad(start), rms_mrad(free.first), rms_mrad(free.last)
    one, more = worst_joint_mrad(rigid.first), worst_joint_mrad(rigid.last)
    rubbed = worst_joint_mrad(rough.first), worst_joint_mrad(rough.last)

    def share(mrad: float) -> str:
        return f"{mrad:.2f} mrad, 1/{without / mrad:.0f}"

    wanted_first = "first trial at goal speed at most 1/30 of the unlearned error"
    wanted_at_once = "rigid body: at most 3 mrad a joint in the first trial at goal speed"
    wanted_later = f"rigid body: at most 1 mrad a joint after {rigid.repeats} repeats"
    rubbed_text = f"{rubbed[0]:.2f}, then {rubbed[1]:.2f} mrad"
    limits = "no abort, nothing clipped, no joint out of its range"
    judged = [
        (wanted_first, share(first), first <= without / 30),
        (f"at most 1/100 after {free.repeats} repeats", share(last), last <= without / 100),
        (wanted_at_once, f"{one:.2f} mrad", one <= 3.0),
        (wanted_later, f"{more:.2f} mrad", more <= 1.0),
        ("rigid body, with dry friction: at most 3 mrad a joint", rubbed_text, max(rubbed) <= 3.0),
    ]
    kept = {name: run.within_limits for name, run in runs.items()}
    judged += [(f"{name}: {limits}", "so" if met else "not so", met) for name, met in kept.items()]
    head = f"Unlearned at the goal speed, without speed limits: {rms_mrad(start):.2f} mrad RMS "
    head += f"({worst_joint_mrad(start):.2f}), {start.report.outcome.name.lower()}."
    return f"{head}\n\n{table(runs)}", judged


def planar(file: str) -> Chapter:
    config = load_config(CONFIGS / file)
    trials, ending = practise(config)
    start = unlearned(file)
    columns: list[Column[tuple[int, PractisedTrial[Trial]]]] = [
        Column("trial", lambda row: row[0]),
        Column("duration [s]", lambda row: row[1].report.duration_s, ".3f"),
        Column("adaptive, model-free", lambda row: errors(row[1])),
        Column("why", lambda row: row[1].plan.reason, left=True),
    ]
    rows = Table(columns, list(enumerate(trials, start=1))).markdown()
    text = f"Unlearned at the goal speed: {rms_mrad(start):.2f} mrad RMS. {ending.message}.\n\n{rows}"
    met = ending.outcome == "completed" and rms_mrad(trials[-1]) <= 5.0 and len(trials) <= 7
    found = f"{ending.outcome}, {rms_mrad(trials[-1]):.2f} mrad after {len(trials)} trials"
    return text, [("as the two-joint arm: 4.5 s within 7 trials at 5 mrad or less", found, met)]


def beyond_the_wrist(file: str, goal_s: float) -> Chapter:
    overrides = ["practice.strategy=adaptive_extension", f"practice.goal_duration_s={goal_s}"]
    overrides += ["learning.name=rigid_body", "practice.tolerance_rad=0.001"]
    config = load_config(CONFIGS / file, overrides)
    fastest_s = fastest_feasible_s(config, config.sim)
    trials, ending = practise(config)
    reached_s = trials[-1].report.duration_s
    clipped = any(trial.trial.saturated.any() for trial in trials)
    met = ending.outcome == "stopped" and abs(reached_s / fastest_s - 1.0) <= 0.05 and not clipped
    found = (
        f"{ending.outcome} at {reached_s:.2f} s after {len(trials)} trials (exact model: {fastest_s:.2f} s): "
        f"{ending.message}"
    )
    wanted = f"asked for {goal_s} s, practice stops within 5 % of the fastest that the effort limits allow"
    return f"Adaptive, rigid body, goal {goal_s} s.", [(wanted, found, met)]


ARMS: dict[str, Callable[[], Chapter]] = {
    "config/planar_arm_3.yaml: three joints in a plane": partial(planar, "planar_arm_3.yaml"),
    "config/kuka_iiwa.yaml: seven joints, 6 s to 1.5 s": partial(seven_joints, "kuka_iiwa.yaml"),
    "config/franka_panda.yaml: a goal beyond the wrist's 12 N·m": partial(
        beyond_the_wrist, "franka_panda.yaml", 4.1
    ),
    "config/franka_panda.yaml: seven joints, 12 s to 4.5 s": partial(seven_joints, "franka_panda.yaml"),
}
"""Heading, and what practises."""


def chapter(name: str) -> Chapter:
    return ARMS[name]()


@study(sets=False)
def arms(options: StudyOptions) -> None:
    """Practise with every ready arm, and judge what comes out; takes some minutes.

    --only takes the headings of the page.
    """
    options.chapters("arms.md", list(ARMS), chapter, n_steps=N_STEPS)
