"""Practice on random arms along random paths: how often adaptive trajectory extension gets there."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import click
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.stats import binomtest

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.random_arm import FAR, vary
from tel_lab.random_path import random_smooth_path
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import Column, Table, of_texts
from tel_lab.trial_record import (
    TrialRecord,
    duration_at_effort_share,
    effort_share,
    exact_trial,
    fastest_by_speed_s,
    practise_unseen,
    shown_runs,
)
from tel_ros.app.plotting import BLUE, GREEN, ORANGE, PURPLE, SOFT
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.trajectories.paths import Path as JointPath
from tel_ros.recording.config_file import load_config

RANGE_MARGIN_RAD = 0.3
"""Random paths keep this far from the ends of the joints' ranges, so that there is room for an error."""
EFFORT_SHARE, SPEED_SHARE = (0.4, 0.9), 0.8
"""The goal needs a random share of the effort limit between the two, and at most that of a speed limit."""
FIRST_TO_GOAL = 2.5
"""First duration over that of the goal: the first trial needs about a sixth of the goal's dynamic torque."""


@dataclass(frozen=True)
class Result:
    """The practice run of one seed: its arm, the goal, and how it went.

    By the exact model the goal needs ``effort_share`` of a limit and has an error of ``exact_rms_rad``. The
    outcome is what the strategy says, or ``failed`` if the run ended in an error.
    """

    seed: int
    sim: SimConfig
    goal_s: float
    effort_share: float
    exact_rms_rad: float
    outcome: str
    message: str
    trials: tuple[TrialRecord, ...]

    @property
    def final_rms_mrad(self) -> float:
        return self.trials[-1].rms_mrad if self.trials else float("nan")

    @property
    def excursion_rad(self) -> float:
        """Largest deviation in any trial, braking included."""
        return max((trial.excursion_rad for trial in self.trials), default=0.0)

    @property
    def aborts(self) -> int:
        return sum(not trial.completed for trial in self.trials)


def task(config: Config, seed: int) -> tuple[Config, JointPath]:
    arm = config.arm
    sim = vary(config.sim, seed, FAR, n_joints=len(arm.joints))
    low_rad, high_rad = np.array(arm.position_min_rad), np.array(arm.position_max_rad)
    path = random_smooth_path(seed, low_rad + RANGE_MARGIN_RAD, high_rad - RANGE_MARGIN_RAD)
    # With a stream of its own: the draw is independent of those for the seed's arm and path.
    share = np.random.default_rng((0x676F616C, seed)).uniform(*EFFORT_SHARE)
    exact, fastest_s = ExactInverseDynamics(config, sim), fastest_by_speed_s(arm, path, SPEED_SHARE)
    goal_s = duration_at_effort_share(arm, exact, path, share, fastest_s)
    first_s = FIRST_TO_GOAL * goal_s
    practice = dataclasses.replace(config.practice, goal_duration_s=goal_s, first_duration_s=first_s)
    return dataclasses.replace(config, sim=sim, practice=practice, seed=seed), path


def practise(config: Config, seed: int) -> Result:
    varied, path = task(config, seed)
    goal_s = varied.practice.goal_duration_s
    ended = practise_unseen(varied, path, goal_s)
    share = effort_share(varied.arm, ExactInverseDynamics(varied, varied.sim), path, goal_s)
    exact_rms_rad = exact_trial(varied, path, goal_s).rms_error_rad
    return Result(seed, varied.sim, goal_s, share, exact_rms_rad, *ended)


OUTCOMES = {
    "completed": (GREEN, "o", "reached the tolerance"),
    "stopped": (ORANGE, "s", "stopped: saw no way on"),
    "aborted": (PURPLE, "^", "ended after an abort"),
    "failed": (BLUE, "X", "ended in an error"),
}
"""Colour, marker and words for each outcome of a run."""

FACTORS: list[Column[Result]] = [
    Column("inertia scale", lambda r: r.sim.inertia_scale, ".2f"),
    Column("payload [kg]", lambda r: r.sim.payload_kg, ".2f"),
    Column("dry friction [N·m]", lambda r: max(r.sim.coulomb_friction_nm), ".2f"),
    Column("position noise [mrad]", lambda r: 1e3 * r.sim.position_noise_rad, ".2f"),
    Column("goal [s]", lambda r: r.goal_s, ".2f"),
    Column("effort [%]", lambda r: 100 * r.effort_share, ".0f"),
    Column("exact model [mrad]", lambda r: 1e3 * r.exact_rms_rad, ".2f"),
]
"""What may tell the runs that did not reach the tolerance from the others."""

MISSED: list[Column[Result]] = [
    Column("seed", lambda r: r.seed),
    Column("outcome", lambda r: r.outcome, left=True),
    *FACTORS,
    Column("last error [mrad]", lambda r: r.final_rms_mrad, ".2f"),
    Column("trials", lambda r: len(r.trials)),
    Column("aborts", lambda r: r.aborts),
    Column("message", lambda r: r.message, left=True),
]


def figure(results: Sequence[Result], config: Config) -> Figure:
    drawing = Figure(figsize=(7.2, 2.7), layout="constrained")
    errors, counts, excursions = drawing.subplots(1, 3)
    for outcome, (colour, marker, words) in OUTCOMES.items():
        mine = [result for result in results if result.outcome == outcome]
        if mine:
            shares = [100.0 * result.effort_share for result in mine]
            final_mrad = [result.final_rms_mrad for result in mine]
            look = {"color": colour, "markersize": 3.5, "markeredgewidth": 0.0, "alpha": 0.8}
            errors.plot(shares, final_mrad, marker, label=f"{words} ({len(mine)})", **look)
    errors.axhline(1e3 * config.practice.tolerance_rad, color=SOFT, linewidth=0.8, linestyle="--")
    errors.set(title="a  Last trial", xlabel="effort that the goal needs [% of limit]")
    errors.set(ylabel="RMS error [mrad]", ylim=(0.0, None))
    counts.hist(
        [[len(result.trials) for result in results if result.outcome == outcome] for outcome in OUTCOMES],
        bins=np.arange(0.5, max(len(result.trials) for result in results) + 1.0),
        stacked=True,
        color=[colour for colour, _, _ in OUTCOMES.values()],
        rwidth=0.85,
    )
    counts.set(title="b  Length of practice", xlabel="trials", ylabel="runs")
    for axis in (counts.xaxis, counts.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    largest = np.sort([result.excursion_rad for result in results])
    part = 100.0 * np.arange(1, len(largest) + 1) / len(largest)
    excursions.step(largest, part, where="post", color=BLUE)
    limit_rad = config.control.path_tolerance_rad
    excursions.axvline(limit_rad, color=SOFT, linewidth=0.8, linestyle="--")
    excursions.set(title="c  Largest deviation in any trial", xlabel="of a joint from its path [rad]")
    excursions.set(ylabel="runs with no more [%]", ylim=(0.0, 102.0))
    excursions.set_xlim(0.0, max(1.1 * limit_rad, 1.05 * largest[-1]))
    where = {"color": SOFT, "rotation": 90, "ha": "right", "va": "center"}
    excursions.text(0.97 * limit_rad, 50.0, "path tolerance", **where)
    handles, labels = errors.get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return drawing


def summary(results: Sequence[Result], config: Config) -> dict[str, Any]:
    trials = [trial for result in results for trial in result.trials]
    reached = [result for result in results if result.outcome == "completed"]
    missed = [result for result in results if result.outcome != "completed"]
    later = [max(t.excursion_rad for t in r.trials[1:]) for r in results if len(r.trials) > 1]
    beyond_rad = 2.0 * config.control.path_tolerance_rad

    def count(holds: Callable[[TrialRecord], bool]) -> str:
        return f"{sum(map(holds, trials))} of {len(trials)}"

    rows = [
        *(
            (f"runs that {words}" if outcome == "completed" else f"runs, {words}", _share(results, outcome))
            for outcome, (_, _, words) in OUTCOMES.items()
        ),
        ("trials that were aborted", count(lambda t: not t.completed)),
        (
            "trials in which a joint was off its path by more than twice the tolerance",
            count(lambda t: t.excursion_rad > beyond_rad),
        ),
        ("trials in which an effort was clipped", count(lambda t: t.report.saturated_ratio > 0)),
        ("trials until the tolerance was reached", _spread([len(r.trials) for r in reached], "{:.0f}")),
        ("last RMS error where it was reached [mrad]", _spread([r.final_rms_mrad for r in reached])),
        ("largest deviation in any trial [rad]", _spread([r.excursion_rad for r in results], "{:.3f}")),
        ("the same after the first trial [rad]", _spread(later, "{:.3f}")),
    ]
    medians = [
        (factor.heading, *(f"{np.median([factor.value(r) for r in some]):.2f}" for some in (reached, missed)))
        for factor in FACTORS
        if reached and missed
    ]
    return {
        "results": results,
        "practice": config.practice,
        "control": config.control,
        "table": of_texts(("", ""), rows).markdown(),
        "missed": missed and Table(MISSED, missed).markdown(),
        "medians": of_texts(("", "reached", "not reached"), medians).markdown(),
    }


def _share(results: Sequence[Result], outcome: str) -> str:
    k, n = sum(result.outcome == outcome for result in results), len(results)
    interval = binomtest(k, n).proportion_ci(0.95)
    return f"{k} of {n}: {100 * k / n:.1f} % ({100 * interval.low:.1f} to {100 * interval.high:.1f} %)"


def _spread(values: Sequence[float], form: str = "{:.2f}") -> str:
    if not values:
        return "–"
    low, middle, high = np.percentile(values, [5, 50, 95])
    low, middle, high, largest = (form.format(x) for x in (low, middle, high, max(values)))
    return f"{middle} ({low} to {high}; {largest})"


@study(seeds=200)
def random_practice(options: StudyOptions) -> None:
    """Practise on random arms along random paths: how often does adaptive extension get there?

    --only takes seeds, and shows each of their trials.
    """
    config = load_config(
        ROOT / "config" / "planar_arm.yaml", ["practice.strategy=adaptive_extension", *options.overrides]
    )
    if wrong := [word for word in options.only if not word.isdecimal()]:
        raise click.UsageError(f"--only is {wrong[0]!r}; expected seeds: whole numbers from 0")
    seeds = [int(seed) for seed in options.only] or range(1, (2 if options.quick else options.seeds) + 1)
    results: list[Result] = []
    tasks = {f"seed {seed}": (config, seed) for seed in seeds}
    for result in shown_runs(options, practise, tasks, MISSED):
        results.append(result)
        if len(results) % 20 == 0 or len(results) == len(tasks):
            drawn = {"random_practice": partial(figure, list(results), config)}
            options.write("random_practice.md", drawn, **summary(results, config))
