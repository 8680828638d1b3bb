"""Adaptive trajectory extension on easy, hard, impossible and changing arms: does it keep what it promises?

    .venv/bin/python benchmarks/adaptive.py

Prints and writes docs/adaptive.md: every trial of every run, and targets that are judged by its numbers.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from practice_records import TrialRecord, duration_at_effort_share, fastest_by_speed_s, record

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.offline import OfflinePractice
from tel_ros.core.config import Config
from tel_ros.core.practice.decisions import Ending, PlannedTrial
from tel_ros.recording.config_file import load_config
from tel_ros.recording.new_network import new_network
from tel_ros.recording.waypoint_file import load_path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Run:
    """One practice run.

    Args:
        config: of its beginning.
        trials: what was done.
        ending: how it ended.
        changed_from: first trial with the other arm; 0: the arm stayed as it was.
        fastest_s: shortest duration that the effort limits of the last arm allow, by the exact model.
    """

    config: Config
    trials: Sequence[TrialRecord]
    ending: Ending
    changed_from: int
    fastest_s: float

    @property
    def last(self) -> TrialRecord:
        """The last trial."""
        return self.trials[-1]

    @property
    def largest_rad(self) -> float:
        """Largest deviation in any trial."""
        return max(trial.excursion_rad for trial in self.trials)


Target = Callable[[Run], tuple[str, bool]]
"""Says what was found and whether that is good enough."""


@dataclass(frozen=True)
class Scenario:
    """An arm to practise with, and what is expected of the practice.

    Args:
        name: heading.
        targets: what is wanted, and how it is judged.
        overrides: what is changed in the configuration.
        later: what is changed in ``sim`` between two trials.
        later_from: index of the first trial with that change.
    """

    name: str
    targets: dict[str, Target]
    overrides: tuple[str, ...] = ()
    later: dict[str, float] = dataclasses.field(default_factory=dict)
    later_from: int = 0


def reached(run: Run, *, trials: int | None = None, rms_mrad: float = 5.0) -> tuple[str, bool]:
    """Judge whether the goal speed was reached with that error within so many trials."""
    last, at_goal = (
        run.last,
        math.isclose(run.last.duration_s, run.config.practice.goal_duration_s, rel_tol=1e-3),
    )
    found = f"{last.duration_s:.2f} s with {1e3 * last.rms_rad:.2f} mrad after {len(run.trials)} trials"
    in_time = trials is None or len(run.trials) <= trials
    return found, last.completed and at_goal and in_time and 1e3 * last.rms_rad <= rms_mrad


def no_deviation_above(run: Run, limit_rad: float) -> tuple[str, bool]:
    """Judge the largest deviation of all trials."""
    return f"{run.largest_rad:.3f} rad", run.largest_rad <= limit_rad


def stopped_at_the_limit(run: Run) -> tuple[str, bool]:
    """Judge whether practice ended by itself, within 5 % of the fastest duration that the limits allow."""
    distance = run.last.duration_s / run.fastest_s - 1.0
    found = (
        f"{run.ending.outcome} at {run.last.duration_s:.2f} s; the exact model says {run.fastest_s:.2f} s "
        f"({100 * distance:+.1f} %)"
    )
    return found, run.ending.outcome == "stopped" and run.last.completed and abs(distance) <= 0.05


def says_that_effort_is_short(run: Run) -> tuple[str, bool]:
    """Judge whether the reason for the end names the effort limit."""
    return run.ending.message, "effort limit" in run.ending.message


def nothing_clipped(run: Run) -> tuple[str, bool]:
    """Judge whether no effort was clipped in any trial."""
    clipped = [k for k, trial in enumerate(run.trials, start=1) if trial.saturated > 0.0]
    return f"clipped in trials {clipped}" if clipped else "never clipped", not clipped


def rolled_back(run: Run) -> tuple[str, bool]:
    """Judge whether there was an abort, and after each one the network of an earlier trial was taken up."""
    aborts = [k for k, trial in enumerate(run.trials) if not trial.completed]
    nexts = [run.trials[k + 1] for k in aborts if k + 1 < len(run.trials)]
    back = [trial.went_back_to for trial in nexts]
    return f"aborted: {[k + 1 for k in aborts]}; went back to: {back}", bool(aborts) and None not in back


def not_beyond_the_corridor_twice(run: Run) -> tuple[str, bool]:
    """Judge whether no two trials in a row left the corridor; the arm must have changed for this to count."""
    path_tolerance_rad = run.config.control.path_tolerance_rad
    beyond = [
        k
        for k, t in enumerate(run.trials, start=1)
        if t.excursion_rad > path_tolerance_rad or not t.completed
    ]
    twice = any(b - a == 1 for a, b in zip(beyond, beyond[1:], strict=False))
    tested = 0 < run.changed_from <= len(run.trials)
    return f"beyond it or aborted: {beyond or 'none'}", tested and not twice


def recovered(run: Run) -> tuple[str, bool]:
    """Judge whether after the change the goal, or the fastest feasible speed, was practised to 5 mrad."""
    wanted_s = max(run.config.practice.goal_duration_s, run.fastest_s)
    last = run.last
    found = (
        f"{last.duration_s:.2f} s with {1e3 * last.rms_rad:.2f} mrad after {len(run.trials)} trials "
        f"(possible: {wanted_s:.2f} s)"
    )
    near = last.duration_s <= 1.05 * wanted_s
    tested = 0 < run.changed_from <= len(run.trials)
    return found, tested and last.completed and near and last.rms_rad <= 5e-3


WITHIN_TOLERANCE = {"4.5 s at 5 mrad or less, without retuning": reached}
AFTER_A_CHANGE = {
    "no trial beyond the corridor twice in a row": not_beyond_the_corridor_twice,
    "recovery: the goal, or within 5 % of the fastest feasible speed, at 5 mrad or less": recovered,
}
SCENARIOS = (
    Scenario(
        "Default arm, to 4.5 s",
        {
            "4.5 s within 7 trials at 5 mrad or less": partial(reached, trials=7),
            "no deviation above 0.21 rad": partial(no_deviation_above, limit_rad=0.21),
        },
    ),
    Scenario(
        "Default arm, to 3.0 s",
        {"3.0 s within 12 trials at 5 mrad or less": partial(reached, trials=12)},
        ("practice.goal_duration_s=3.0",),
    ),
    Scenario(
        "Default arm, to 4.5 s, rigid body + least-squares tree",
        {"4.5 s within 4 trials at 2 mrad or less": partial(reached, trials=4, rms_mrad=2.0)},
        ("learning.name=rigid_body+lms_tree",),
    ),
    Scenario("Half the inertia", WITHIN_TOLERANCE, ("sim.inertia_scale=0.5",)),
    Scenario("1.5 times the inertia", WITHIN_TOLERANCE, ("sim.inertia_scale=1.5",)),
    Scenario("Twice the inertia", WITHIN_TOLERANCE, ("sim.inertia_scale=2.0",)),
    Scenario(
        "Three times the inertia: 4.5 s is beyond the effort limit",
        {
            "stops within 5 % of the fastest feasible speed": stopped_at_the_limit,
            "says why": says_that_effort_is_short,
            "no effort clipped before": nothing_clipped,
        },
        ("sim.inertia_scale=3.0",),
    ),
    Scenario(
        "Payload doubled from trial 4 on, 0.5 to 1.0 kg",
        AFTER_A_CHANGE,
        ("sim.payload_kg=0.5",),
        {"payload_kg": 1.0},
        4,
    ),
    Scenario("Inertia doubled from trial 4 on", AFTER_A_CHANGE, (), {"inertia_scale": 2.0}, 4),
    Scenario(
        "Inertia doubled from trial 5 on, on the way to 3.0 s: the present speed becomes impossible",
        AFTER_A_CHANGE,
        ("practice.goal_duration_s=3.0",),
        {"inertia_scale": 2.0},
        5,
    ),
    Scenario(
        "Inertia four times as large from trial 4 on: enough for an abort",
        {"goes back after the abort": rolled_back, **AFTER_A_CHANGE},
        (),
        {"inertia_scale": 4.0},
        4,
    ),
)


def practise(file: Path, scenario: Scenario, overrides: Sequence[str]) -> Run:
    """Run a scenario."""
    config = load_config(file, ["practice.strategy=adaptive_extension", *overrides, *scenario.overrides])
    path, arm = load_path(config.path, config.arm), config.arm
    later = dataclasses.replace(config.sim, **scenario.later)
    with OfflinePractice(config, path, new_network(config)) as practice:

        def change_arm(plan: PlannedTrial) -> None:
            if plan.index == scenario.later_from:
                practice.arm.replace_arm(later)

        trials = [record(practised) for practised in practice.run(before_trial=change_arm)]
        assert practice.ending is not None
        fastest_s = duration_at_effort_share(
            arm, ExactInverseDynamics(config, later), path, 1.0, fastest_by_speed_s(arm, path, 1.0)
        )
        return Run(config, trials, practice.ending, scenario.later_from, fastest_s)


COLUMNS = (
    "trial",
    "duration [s]",
    "expected RMS [mrad]",
    "RMS [mrad]",
    "largest deviation [rad]",
    "clipped [%]",
    "outcome",
    "why this trial",
)


def section(scenario: Scenario, run: Run) -> str:
    """Return the part of the page about a scenario."""
    rows = []
    for k, trial in enumerate(run.trials, start=1):
        expected = "–" if math.isnan(trial.expected_rms_rad) else f"{1e3 * trial.expected_rms_rad:.2f}"
        how = "completed" if trial.completed else f"aborted: {trial.message}"
        back = "" if trial.went_back_to is None else f" (network of trial {trial.went_back_to})"
        rows.append(
            f"| {k} | {trial.duration_s:.3f} | {expected} | {1e3 * trial.rms_rad:.2f} | "
            f"{trial.excursion_rad:.3f} | {100 * trial.saturated:.1f} | {how} | {trial.reason}{back} |"
        )
    judged = "\n".join(
        f"- **{'met' if met else 'not met'}**: {wanted}. Found: {found}."
        for wanted, (found, met) in judge(scenario, run).items()
    )
    changes = " ".join(f"`{text}`" for text in scenario.overrides) or "As configured"
    if scenario.later:
        changes += f"; from trial {scenario.later_from} on " + " ".join(
            f"`sim.{key}={value:g}`" for key, value in scenario.later.items()
        )
    table = "\n".join(rows)
    return f"""## {scenario.name}

{changes}. {run.ending.outcome.capitalize()}: {run.ending.message or "nothing to say"}.

| {" | ".join(COLUMNS)} |
|{"---:|" * (len(COLUMNS) - 2)}---|---|
{table}

{judged}
"""


def judge(scenario: Scenario, run: Run) -> dict[str, tuple[str, bool]]:
    """Return for each target what was found and whether it is met."""
    return {wanted: target(run) for wanted, target in scenario.targets.items()}


def main() -> None:
    """Run the scenarios, print them and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=ROOT / "config" / "planar_arm.yaml")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "adaptive.md")
    options = parser.parse_args()
    sections, targets, met = [], 0, 0
    for scenario in SCENARIOS:
        run = practise(options.config, scenario, options.set)
        sections.append(section(scenario, run))
        print(sections[-1], flush=True)
        targets += len(scenario.targets)
        met += sum(good for _, good in judge(scenario, run).values())
    summary = f"{met} of {targets} targets are met."
    print(summary)
    command = " ".join(["benchmarks/adaptive.py", *(f"--set {text}" for text in options.set)])
    body = "\n".join(sections)
    options.out.write_text(
        f"""# Adaptive trajectory extension: what it promises and what it does

Practice of `config/{options.config.name}` with `practice.strategy=adaptive_extension`, on arms that it is not
tuned to. Errors are measured minus desired position over both joints. The largest deviation includes the
braking after an abort. Made without ROS, tick for tick like the graph, by `{command}`;
the script judges the targets by its numbers. **{summary}**

{body}""",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main()
