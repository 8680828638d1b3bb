"""As fast as the arm can: how near practice comes to the time-optimal movement, on unseen arms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import click
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from tel_lab.comparison.statistics import Median, median
from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_lab.random_arm import FAR, vary
from tel_lab.random_path import random_smooth_path
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import Column, Table, of_texts
from tel_lab.time_bound import time_bound
from tel_lab.trial_record import TRIALS, TrialRecord, practise_unseen, shown_runs
from tel_ros.app.plotting import BLUE, GREEN, ORANGE, PURPLE, SOFT
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.practice.strategy import PlannedTrial
from tel_ros.core.trajectories.paths import Path
from tel_ros.core.types import FloatArray
from tel_ros.recording.config_file import load_config
from tel_ros.recording.waypoint_file import load_path

FIRST_SEED = 9001
"""No test and no other study has used these arms and paths."""
RANGE_MARGIN_RAD = 0.3
"""Random paths of the planar arm keep this far from the ends of the joints' ranges. Those of arms under
gravity go this far beyond the positions of the configured path: elsewhere they may hit themselves."""
HEAVY_ARMS = PATHS = 10
NEAR_SHARE = 0.7
"""Of the effort limits: the payload is doubled before the first trial that uses so much."""
PAYLOAD_KG = 0.5
SETTINGS = ("practice.goal=fastest", "practice.strategy=adaptive_extension")


@dataclass(frozen=True)
class Group:
    """Runs that are judged together: an arm, a learner, and what is promised of the time over the bound."""

    title: str
    config: str
    learner: str
    promised: float
    colour: str
    n: int | None = None
    """Runs; None: as many as there are seeds."""
    varied: bool = False
    """Whether each seed has an arm of its own."""
    doubled: bool = False
    """Whether the payload is doubled near the limit."""
    settings: tuple[str, ...] = ()


GROUPS = {
    "kinematics": Group("kinematics told", "planar_arm", "rigid_body", 1.10, BLUE, varied=True),
    "no_model": Group("without a model", "planar_arm", "polynomial", 1.30, ORANGE, varied=True),
    # The first trial is so slow that the data sheet's velocity limits permit it on all paths.
    "kuka_iiwa": Group(
        *("iiwa, kinematics told", "fastest_iiwa", "rigid_body", 1.15, GREEN, PATHS),
        settings=("practice.first_duration_s=24",),
    ),
    "franka_panda": Group("Franka Panda, kinematics told", "franka_panda", "rigid_body", 1.15, PURPLE, PATHS),
    "payload": Group(
        "payload doubled, kinematics told", "planar_arm", "rigid_body", 1.10, SOFT, HEAVY_ARMS, True, True
    ),
    "payload_no_model": Group(
        "payload doubled, without a model", "planar_arm", "polynomial", 1.30, SOFT, HEAVY_ARMS, True, True
    ),
}


@dataclass(frozen=True)
class Result:
    """One run: its arm, the time-optimal bounds at the whole and at the permitted share of effort, trials."""

    group: str
    seed: int
    sim: SimConfig
    bound_s: float
    at_share_s: float
    outcome: str
    message: str
    trials: tuple[TrialRecord, ...]
    n_before: int
    """Trials before the payload was doubled; 0: it was not."""

    @property
    def last(self) -> TrialRecord:
        return self.trials[-1]

    @property
    def time_over_bound(self) -> float:
        """Inf if the last trial was not completed, or there was none."""
        return self.last.report.duration_s / self.bound_s if self.trials and self.last.completed else np.inf

    @property
    def share_over_bound(self) -> float:
        """What leaving some effort to the springs costs by itself."""
        return self.at_share_s / self.bound_s

    @property
    def rms_mrad(self) -> float:
        return self.last.rms_mrad if self.trials else np.inf

    @property
    def clipped(self) -> int:
        """Control periods of the last trial in which an effort was clipped."""
        return round(self.last.report.saturated_ratio * self.last.report.ticks) if self.trials else 0

    @property
    def aborts(self) -> int:
        """Without the first trial."""
        return sum(not trial.completed for trial in self.trials[1:])

    @property
    def beyond_first(self) -> bool:
        """Whether a joint was farther off its path in a later trial than in the first one."""
        excursions = [trial.excursion_rad for trial in self.trials]
        return max(excursions[1:], default=0.0) > max(excursions[:1], default=0.0)

    @property
    def largest_rad(self) -> float:
        return max((trial.excursion_rad for trial in self.trials[1:]), default=0.0)


def task(group: Group, seed: int, overrides: Sequence[str]) -> tuple[Config, Path]:
    settings = [*SETTINGS, *group.settings, f"learning.name={group.learner}", f"seed={seed}", *overrides]
    config = load_config(ROOT / "config" / f"{group.config}.yaml", settings)
    arm, sim = config.arm, config.sim
    if group.varied:
        sim = vary(sim, seed, FAR, n_joints=len(arm.joints))
    if group.doubled:
        sim = replace(sim, payload_kg=PAYLOAD_KG)
    low_rad, high_rad = (np.array(arm.position_min_rad), np.array(arm.position_max_rad))
    low_rad, high_rad = low_rad + RANGE_MARGIN_RAD, high_rad - RANGE_MARGIN_RAD
    if not group.varied:
        q, _, _ = load_path(config.path, arm).evaluate(np.linspace(0.0, 1.0, 200))
        low_rad = np.maximum(low_rad, q.min(axis=0) - RANGE_MARGIN_RAD)
        high_rad = np.minimum(high_rad, q.max(axis=0) + RANGE_MARGIN_RAD)
    return replace(config, sim=sim), random_smooth_path(seed, low_rad, high_rad)


def practise(name: str, seed: int, overrides: Sequence[str]) -> Result:
    group = GROUPS[name]
    config, path = task(group, seed, overrides)
    sim, n_before = config.sim, 0

    def before_trial(practice: OfflinePractice, plan: PlannedTrial) -> None:
        nonlocal sim, n_before
        if group.doubled and not n_before and (plan.movement.effort_share or 0.0) >= NEAR_SHARE:
            sim, n_before = replace(sim, payload_kg=2.0 * PAYLOAD_KG), plan.index - 1
            practice.arm.replace_arm(sim)

    # What a user knows: the path and the speed limits.
    ended = practise_unseen(config, path, config.practice.first_duration_s, before_trial)
    model = ExactInverseDynamics(config, sim).predict
    bound_s = time_bound(config.arm, model, path).duration_s
    at_share_s = time_bound(config.arm, model, path, config.practice.effort_share).duration_s
    return Result(name, seed, sim, bound_s, at_share_s, *ended, n_before)


RUNS: list[Column[Result]] = [
    Column("run", lambda r: GROUPS[r.group].title, left=True),
    Column("seed", lambda r: r.seed),
    Column("bound [s]", lambda r: r.bound_s, ".2f"),
    Column("time / bound", lambda r: r.time_over_bound, ".3f"),
    Column("of which the share", lambda r: r.share_over_bound, ".3f"),
    Column("share reached", lambda r: r.trials and r.last.plan.movement.effort_share or None, ".2f"),
    Column("RMS [mrad]", lambda r: r.rms_mrad, ".2f"),
    Column("trials", lambda r: len(r.trials)),
    Column("clipped", lambda r: r.clipped),
    Column("aborts", lambda r: r.aborts),
    Column("deviation, first [rad]", lambda r: r.trials and r.trials[0].excursion_rad or None, ".3f"),
    Column("later [rad]", lambda r: r.largest_rad, ".3f"),
    Column("inertia", lambda r: r.sim.inertia_scale, ".2f"),
    Column("dry friction [N·m]", lambda r: max(r.sim.coulomb_friction_nm, default=0.0), ".2f"),
    Column("viscous [N·m·s/rad]", lambda r: max(r.sim.viscous_friction_nms_per_rad, default=0.0), ".2f"),
    Column("how it ended", lambda r: f"{r.outcome}: {r.message}", left=True),
]
SHARE: Column[TrialRecord] = Column("share", lambda t: t.plan.movement.effort_share, ".3f")


def _with_interval(found: Median, form: str = ".2f") -> str:
    return f"{found.value:{form}} [{found.low:{form}}, {found.high:{form}}]"


def _counts(results: Sequence[Result], holds: Callable[[Result], bool]) -> str:
    return f"{sum(map(holds, results))} of {len(results)}"


def group_row(name: str, results: Sequence[Result], config: Config) -> list[str]:
    group, tolerance_mrad = GROUPS[name], 1e3 * config.practice.tolerance_rad
    ratio = median([r.time_over_bound for r in results])
    return [
        group.title,
        _with_interval(ratio, ".3f"),
        f"{group.promised:.2f}: {'met' if ratio.value <= group.promised else 'not met'}",
        _with_interval(median([r.rms_mrad for r in results])),
        _counts(results, lambda r: r.outcome == "completed" and r.rms_mrad <= tolerance_mrad),
        _with_interval(median([len(r.trials) for r in results]), ".0f"),
        _counts(results, lambda r: len(r.trials) > 12),
        _counts(results, lambda r: r.clipped > 0),
        _counts(results, lambda r: r.aborts > 0),
        _counts(results, lambda r: r.beyond_first),
        f"{max(r.largest_rad for r in results):.3f}",
    ]


HEADINGS = (
    *("", "time / bound", "promised"),
    "RMS [mrad]",
    "within the tolerance",
    "trials",
    "more than 12 trials",
    "clipped in the last",
    "aborts after the first",
    "farther off than in the first",
    "farthest off after the first [rad]",
)


def figure(results: Sequence[Result], config: Config) -> Figure:
    drawing = Figure(figsize=(7.2, 2.8), layout="constrained")
    ratios, errors, courses = drawing.subplots(1, 3)
    shown = {name: [r for r in results if r.group == name] for name in GROUPS if not GROUPS[name].doubled}
    for name, mine in ((name, mine) for name, mine in shown.items() if mine):
        group = GROUPS[name]
        sorted_ratios = np.sort([r.time_over_bound for r in mine])
        part = 100.0 * np.arange(1, len(mine) + 1) / len(mine)
        ratios.step(
            sorted_ratios, part, where="post", color=group.colour, label=f"{group.title} ({len(mine)})"
        )
        look: dict[str, Any] = {"color": group.colour, "markersize": 3.0, "alpha": 0.7}
        errors.plot([r.time_over_bound for r in mine], [r.rms_mrad for r in mine], "o", **look)
        courses.plot(*_course(mine), "o-", **look)
    right = 1.02 * min(max((r.time_over_bound for r in results), default=1.5), 2.0)
    for axes in (ratios, errors):
        axes.axvline(1.0, color=SOFT, linewidth=0.8, linestyle="--")
        axes.set(xlabel="time / time-optimal", xlim=(0.98, right))
    ratios.set(title="a  How fast", ylabel="runs with no more [%]", ylim=(0.0, 102.0))
    errors.axhline(1e3 * config.practice.tolerance_rad, color=SOFT, linewidth=0.8, linestyle="--")
    errors.set(title="b  Last trial", ylabel="RMS error [mrad]", ylim=(0.0, None))
    courses.axhline(1.0, color=SOFT, linewidth=0.8, linestyle="--")
    courses.set(title="c  From trial to trial", xlabel="trial", ylabel="time / time-optimal", yscale="log")
    courses.yaxis.set_major_formatter("{x:g}")
    courses.yaxis.set_minor_formatter(NullFormatter())
    handles, labels = ratios.get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside lower center", ncols=2)
    return drawing


def _course(results: Sequence[Result]) -> tuple[FloatArray, FloatArray]:
    """Return numbers of trials, and medians of time over bound; runs that have ended stay where they are."""
    longest = max(len(r.trials) for r in results)
    ratios = [[t.report.duration_s / r.bound_s for t in r.trials] for r in results if r.trials]
    held = np.array([row + row[-1:] * (longest - len(row)) for row in ratios])
    return np.arange(1.0, longest + 1.0), np.median(held, axis=0)


def summary(results: Sequence[Result], config: Config) -> dict[str, Any]:
    by_group = {name: [r for r in results if r.group == name] for name in GROUPS}
    rows = [group_row(name, mine, config) for name, mine in by_group.items() if mine]
    worst = {
        GROUPS[name].title: Table(
            RUNS[1:], sorted(mine, key=lambda r: (-r.time_over_bound, r.seed))[:5]
        ).markdown()
        for name, mine in by_group.items()
        if mine and not GROUPS[name].doubled
    }
    doubled = [r for r in results if r.n_before]
    tolerance_rad = config.control.path_tolerance_rad
    payload = [
        ("runs in which the payload was doubled near the limit", f"{len(doubled)}"),
        ("recovered: within the tolerance at the end", _counts(doubled, lambda r: r.outcome == "completed")),
        ("trials from then on", ", ".join(str(len(r.trials) - r.n_before) for r in doubled)),
        (
            f"a joint farther off its path than the tolerance of {tolerance_rad:g} rad",
            _counts(doubled, lambda r: max(t.excursion_rad for t in r.trials[r.n_before :]) > tolerance_rad),
        ),
    ]
    return {
        "results": results,
        "practice": config.practice,
        "groups": {name: group for name, group in GROUPS.items() if by_group[name]},
        "first_seed": FIRST_SEED,
        "table": of_texts(HEADINGS, rows).markdown(),
        "worst": worst,
        "payload": doubled and of_texts(("", ""), payload).markdown(),
        "payload_kg": PAYLOAD_KG,
        "near_share": NEAR_SHARE,
    }


@study(seeds=100)
def fastest(options: StudyOptions) -> None:
    """Practise as fast as the arm can on random arms and paths: how near does it come to the bound?

    --only takes names of groups (kinematics, no_model, kuka_iiwa, …) or seeds of the first group, and shows
    each trial.
    """
    seeds = [int(word) for word in options.only if word.isdecimal()]
    names = replace(options, only=tuple(w for w in options.only if not w.isdecimal())).selected(list(GROUPS))
    tasks: dict[str, tuple[str, int, tuple[str, ...]]] = {}
    for name in names[:1] if seeds else names:
        n = 1 if options.quick else min(GROUPS[name].n or options.seeds, options.seeds)
        for seed in seeds or range(FIRST_SEED, FIRST_SEED + n):
            tasks[f"{name}, seed {seed}"] = (name, seed, options.overrides)
    results = list(shown_runs(options, practise, tasks, RUNS, [*TRIALS[:1], SHARE, *TRIALS[1:]]))
    config, _ = task(GROUPS[names[0]], FIRST_SEED, options.overrides)
    values = summary(results, config)
    click.echo(values["table"])
    options.write("fastest-measured.md", {"fastest": partial(figure, results, config)}, **values)
