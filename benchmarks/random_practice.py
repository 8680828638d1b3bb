"""Practice on random arms along random paths: how often adaptive trajectory extension gets there.

    .venv/bin/python benchmarks/random_practice.py --seeds 200 --jobs 2

Prints a line a seed and writes docs/random_practice.md and docs/figures/random_practice.{svg,png}.
"""

from __future__ import annotations

import argparse
import dataclasses
import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from practice_records import (
    TrialRecord,
    duration_at_effort_share,
    effort_share,
    exact_trial,
    fastest_by_speed_s,
    record,
)
from random_practice_page import write_figure, write_page

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_lab.random_arm import random_sim
from tel_lab.random_path import random_smooth_path
from tel_ros.core.config import Config, SimConfig
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.trajectories.paths import Path as JointPath
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.recording.config_file import load_config
from tel_ros.recording.new_network import learner_context

ROOT = Path(__file__).parents[1]

PROTOCOL = ("practice.strategy=adaptive_extension",)
"""What is changed in the configuration. Random arms are heavier and swing more slowly than the default one:
in 0.2 s they are not yet seen to move at the turning point of a swing."""
RANGE_MARGIN_RAD = 0.3
"""Random paths keep this far from the ends of the joints' ranges, so that there is room for an error."""
EFFORT_SHARE = (0.4, 0.9)
"""The goal movement needs a random share of the effort limit between these."""
SPEED_SHARE = 0.8
"""And no more than this share of a speed limit."""
FIRST_TO_GOAL = 2.5
"""First duration over that of the goal: the first trial needs about a sixth of the goal's dynamic torque."""
EVERY = 20
"""Page and figure are brought up to date after so many runs."""
_GOAL_STREAM = 0x676F616C
"""Makes the draws for a seed independent of those for its arm and its path."""


@dataclass(frozen=True)
class Result:
    """The practice run of one seed.

    Args:
        seed: of arm, path and goal.
        sim: the arm.
        goal_s: duration that was asked for.
        effort_share: largest share of an effort limit that the goal movement needs by the exact model.
        exact_rms_rad: tracking error of the goal movement with the exact model.
        outcome: ``completed``, ``stopped`` or ``aborted`` as the strategy says, or ``failed`` if the run
            ended in an error.
        message: why it ended.
        trials: what was done.
        wall_s: how long that took.
    """

    seed: int
    sim: SimConfig
    goal_s: float
    effort_share: float
    exact_rms_rad: float
    outcome: str
    message: str
    trials: tuple[TrialRecord, ...]
    wall_s: float

    @property
    def final_rms_rad(self) -> float:
        """Tracking error of the last trial; NaN if there was none."""
        return self.trials[-1].rms_rad if self.trials else float("nan")

    @property
    def excursion_rad(self) -> float:
        """Largest deviation in any trial, braking included."""
        return max((trial.excursion_rad for trial in self.trials), default=0.0)

    @property
    def aborts(self) -> int:
        """Trials that did not come to their end."""
        return sum(not trial.completed for trial in self.trials)


def task(config: Config, seed: int) -> tuple[Config, JointPath]:
    """Return the configuration and the path of a seed."""
    arm = config.arm
    sim = random_sim(config.sim, seed, n_joints=len(arm.joints))
    path = random_smooth_path(
        seed,
        np.array(arm.position_min_rad) + RANGE_MARGIN_RAD,
        np.array(arm.position_max_rad) - RANGE_MARGIN_RAD,
    )
    share = np.random.default_rng((_GOAL_STREAM, seed)).uniform(*EFFORT_SHARE)
    goal_s = duration_at_effort_share(
        arm, ExactInverseDynamics(config, sim), path, share, fastest_by_speed_s(arm, path, SPEED_SHARE)
    )
    practice = dataclasses.replace(
        config.practice, goal_duration_s=goal_s, first_duration_s=FIRST_TO_GOAL * goal_s
    )
    return dataclasses.replace(config, sim=sim, practice=practice, seed=seed), path


def untrained(config: Config, path: JointPath) -> Learner:
    """Return the configured learner with input ranges that cover the goal movement along the path."""
    goal = sample(path, config.practice.goal_duration_s, config.control.rate_hz)
    context = dataclasses.replace(
        learner_context(config), input_range=InputRange.covering(goal, config.learning.input_margin)
    )
    return learner_kind(config.learning.name).new(context)


def practise(config: Config, seed: int) -> Result:
    """Run the practice of one seed; whatever goes wrong in it becomes part of the result."""
    varied, path = task(config, seed)
    goal_s = varied.practice.goal_duration_s
    started = time.monotonic()
    trials: list[TrialRecord] = []
    try:
        with OfflinePractice(varied, path, untrained(varied, path)) as practice:
            trials = [record(practised) for practised in practice.run()]
            assert practice.ending is not None
            outcome, message = practice.ending.outcome, practice.ending.message
    except Exception as error:  # One seed that fails must not hide how the others went.
        outcome, message = "failed", f"{type(error).__name__}: {error}"
    return Result(
        seed=seed,
        sim=varied.sim,
        goal_s=goal_s,
        effort_share=effort_share(varied.arm, ExactInverseDynamics(varied, varied.sim), path, goal_s),
        exact_rms_rad=exact_trial(varied, path, goal_s).rms_error_rad,
        outcome=outcome,
        message=message,
        trials=tuple(trials),
        wall_s=time.monotonic() - started,
    )


def campaign(config: Config, seeds: Sequence[int], jobs: int) -> Iterator[Result]:
    """Run all seeds, and give each result when it and all before it are there."""
    # The processes share the cores: each computes on one.
    os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")})
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(partial(practise, config), seeds)


def line(result: Result) -> str:
    """Return one line about a seed."""
    return (
        f"{result.seed:4d}  {result.outcome:9s}  inertia x{result.sim.inertia_scale:.2f}  "
        f"goal {result.goal_s:5.2f} s  {100 * result.effort_share:3.0f} % effort  "
        f"{len(result.trials):2d} trials  {result.aborts} aborts  "
        f"final {1e3 * result.final_rms_rad:6.2f} mrad (exact model {1e3 * result.exact_rms_rad:5.2f})  "
        f"largest {result.excursion_rad:.3f} rad  {result.wall_s:4.1f} s  {result.message}"
    )


def details(result: Result) -> str:
    """Return the trials of a seed, one a line."""
    return "\n".join(
        f"      {k:2d}  {trial.duration_s:6.3f} s  {1e3 * trial.rms_rad:7.2f} mrad  "
        f"max {trial.excursion_rad:.3f} rad  saturated {trial.saturated:.3f}  {trial.reason}  {trial.message}"
        for k, trial in enumerate(result.trials, start=1)
    )


def write(results: Sequence[Result], config: Config, options: argparse.Namespace) -> None:
    """Write figure and page about the results that are there."""
    write_figure(results, config, options.out / "figures" / "random_practice")
    command = f"benchmarks/random_practice.py --seeds {len(results)}"
    command += "".join(f" --set {text}" for text in options.set)
    write_page(results, config, options.out / "random_practice.md", command)


def main() -> None:
    """Run the campaign, print its lines and write page and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=ROOT / "config" / "planar_arm.yaml")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--seeds", type=int, default=200, help="how many, from 1")
    parser.add_argument("--only", type=int, nargs="+", metavar="SEED", help="look at these; write nothing")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    options = parser.parse_args()
    config = load_config(options.config, [*PROTOCOL, *options.set])
    results: list[Result] = []
    for result in campaign(config, options.only or range(1, options.seeds + 1), options.jobs):
        results.append(result)
        print(line(result), flush=True)
        if not options.only and len(results) % EVERY == 0:
            write(results, config, options)
        if options.only or result.outcome != "completed" or result.aborts:
            print(details(result), flush=True)
    if not options.only:
        write(results, config, options)


if __name__ == "__main__":
    main()
