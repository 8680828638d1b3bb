"""Adaptive trajectory extension on easy, hard, impossible and changing arms: what it promises, judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from tel_lab.study import ROOT, Chapter, StudyOptions, study
from tel_lab.tables import Column, Table
from tel_lab.trial_record import ArmChange, TrialRecord, fastest_feasible_s, practise
from tel_ros.core.config import Config
from tel_ros.core.practice.strategy import Ending, PlannedTrial
from tel_ros.recording.config_file import load_config

CONFIG = ROOT / "config" / "planar_arm.yaml"


@dataclass(frozen=True)
class Run:
    """One practice run; ``fastest_s``: what the effort limits of the last arm allow, by the exact model."""

    config: Config
    trials: Sequence[TrialRecord]
    ending: Ending
    change: ArmChange | None
    fastest_s: float

    @property
    def last(self) -> TrialRecord:
        return self.trials[-1]

    @property
    def is_of_a_change(self) -> bool:
        return self.change is not None and self.change.at_trial <= len(self.trials)

    def last_in_words(self) -> str:
        last = self.last
        return f"{last.report.duration_s:.2f} s with {last.rms_mrad:.2f} mrad after {len(self.trials)} trials"


Target = Callable[[Run], tuple[str, bool]]
"""Says what was found and whether that is good enough."""


@dataclass(frozen=True)
class Scenario:
    """An arm to practise with: what is wanted and how it is judged, what is changed, also on the way."""

    targets: Mapping[str, Target]
    overrides: tuple[str, ...] = ()
    change: ArmChange | None = None


def reached(run: Run, *, trials: int | None = None, rms_mrad: float = 5.0) -> tuple[str, bool]:
    """Judge whether the goal speed was reached with that error within so many trials."""
    last = run.last
    at_goal = math.isclose(last.report.duration_s, run.config.practice.goal_duration_s, rel_tol=1e-3)
    in_time = trials is None or len(run.trials) <= trials
    return run.last_in_words(), last.completed and at_goal and in_time and last.rms_mrad <= rms_mrad


def no_deviation_above(run: Run, limit_rad: float) -> tuple[str, bool]:
    largest_rad = max(trial.excursion_rad for trial in run.trials)
    return f"{largest_rad:.3f} rad", largest_rad <= limit_rad


def stopped_at_the_limit(run: Run) -> tuple[str, bool]:
    """Judge whether practice ended by itself, within 5 % of the fastest duration that the limits allow."""
    reached_s = run.last.report.duration_s
    distance = reached_s / run.fastest_s - 1.0
    found = (
        f"{run.ending.outcome} at {reached_s:.2f} s; the exact model says {run.fastest_s:.2f} s "
        f"({100 * distance:+.1f} %)"
    )
    return found, run.ending.outcome == "stopped" and run.last.completed and abs(distance) <= 0.05


def says_that_effort_is_short(run: Run) -> tuple[str, bool]:
    return run.ending.message, "effort limit" in run.ending.message


def nothing_clipped(run: Run) -> tuple[str, bool]:
    clipped = [k for k, trial in enumerate(run.trials, start=1) if trial.report.saturated_ratio > 0.0]
    return f"clipped in trials {clipped}" if clipped else "never clipped", not clipped


def rolled_back(run: Run) -> tuple[str, bool]:
    """Judge whether there was an abort, and after each one the network of an earlier trial was taken up."""
    aborts = [k for k, trial in enumerate(run.trials) if not trial.completed]
    nexts = [run.trials[k + 1] for k in aborts if k + 1 < len(run.trials)]
    back = [trial.plan.go_back_to for trial in nexts]
    return f"aborted: {[k + 1 for k in aborts]}; went back to: {back}", bool(aborts) and None not in back


def not_beyond_the_path_tolerance_twice(run: Run) -> tuple[str, bool]:
    """Judge whether no two trials in a row were beyond it; for this to count the arm must have changed."""
    limit_rad, trials = run.config.control.path_tolerance_rad, enumerate(run.trials, start=1)
    beyond = [k for k, trial in trials if trial.excursion_rad > limit_rad or not trial.completed]
    twice = any(b - a == 1 for a, b in pairwise(beyond))
    return f"beyond it or aborted: {beyond or 'none'}", run.is_of_a_change and not twice


def recovered(run: Run) -> tuple[str, bool]:
    """Judge whether after the change the goal, or the fastest feasible speed, was practised to 5 mrad."""
    wanted_s = max(run.config.practice.goal_duration_s, run.fastest_s)
    last, found = run.last, f"{run.last_in_words()} (possible: {wanted_s:.2f} s)"
    good = last.report.duration_s <= 1.05 * wanted_s and last.report.rms_error_rad <= 5e-3
    return found, run.is_of_a_change and last.completed and good


WITHIN_TOLERANCE = {"4.5 s at 5 mrad or less, without retuning": reached}
AFTER_A_CHANGE = {
    "no trial beyond the path tolerance twice in a row": not_beyond_the_path_tolerance_twice,
    "recovery: the goal, or within 5 % of the fastest feasible speed, at 5 mrad or less": recovered,
}
SCENARIOS = {
    "Default arm, to 4.5 s": Scenario(
        {
            "4.5 s within 7 trials at 5 mrad or less": partial(reached, trials=7),
            "no deviation above 0.21 rad": partial(no_deviation_above, limit_rad=0.21),
        },
    ),
    "Default arm, to 3.0 s": Scenario(
        {"3.0 s within 12 trials at 5 mrad or less": partial(reached, trials=12)},
        ("practice.goal_duration_s=3.0",),
    ),
    "Default arm, to 4.5 s, rigid body + least-squares tree": Scenario(
        {"4.5 s within 4 trials at 2 mrad or less": partial(reached, trials=4, rms_mrad=2.0)},
        ("learning.name=rigid_body+lms_tree",),
    ),
    "Half the inertia": Scenario(WITHIN_TOLERANCE, ("sim.inertia_scale=0.5",)),
    "1.5 times the inertia": Scenario(WITHIN_TOLERANCE, ("sim.inertia_scale=1.5",)),
    "Twice the inertia": Scenario(WITHIN_TOLERANCE, ("sim.inertia_scale=2.0",)),
    "Three times the inertia: 4.5 s is beyond the effort limit": Scenario(
        {
            "stops within 5 % of the fastest feasible speed": stopped_at_the_limit,
            "says why": says_that_effort_is_short,
            "no effort clipped before": nothing_clipped,
        },
        ("sim.inertia_scale=3.0",),
    ),
    "Payload doubled from trial 4 on, 0.5 to 1.0 kg": Scenario(
        AFTER_A_CHANGE, ("sim.payload_kg=0.5",), ArmChange(4, {"payload_kg": 1.0})
    ),
    "Inertia doubled from trial 4 on": Scenario(AFTER_A_CHANGE, (), ArmChange(4, {"inertia_scale": 2.0})),
    "Inertia doubled from trial 5 on, on the way to 3.0 s: the present speed becomes impossible": Scenario(
        AFTER_A_CHANGE, ("practice.goal_duration_s=3.0",), ArmChange(5, {"inertia_scale": 2.0})
    ),
    "Inertia four times as large from trial 4 on: enough for an abort": Scenario(
        {"goes back after the abort": rolled_back, **AFTER_A_CHANGE}, (), ArmChange(4, {"inertia_scale": 4.0})
    ),
}


COLUMNS: list[Column[tuple[int, TrialRecord]]] = [
    Column("trial", lambda row: row[0]),
    Column("duration [s]", lambda row: row[1].report.duration_s, ".3f"),
    Column("expected RMS [mrad]", lambda row: 1e3 * row[1].plan.expected_rms_rad, ".2f"),
    Column("RMS [mrad]", lambda row: row[1].rms_mrad, ".2f"),
    Column("largest deviation [rad]", lambda row: row[1].excursion_rad, ".3f"),
    Column("clipped [%]", lambda row: 100 * row[1].report.saturated_ratio, ".1f"),
    Column("outcome", lambda row: _outcome(row[1]), left=True),
    Column("why this trial", lambda row: _reason(row[1].plan), left=True),
]


def _outcome(trial: TrialRecord) -> str:
    return "completed" if trial.completed else f"aborted: {trial.report.message}"


def _reason(plan: PlannedTrial) -> str:
    return plan.reason + ("" if plan.go_back_to is None else f" (network of trial {plan.go_back_to})")


def chapter(name: str, overrides: Sequence[str]) -> Chapter:
    scenario = SCENARIOS[name]
    config = load_config(CONFIG, ["practice.strategy=adaptive_extension", *overrides, *scenario.overrides])
    trials, ending = practise(config, scenario.change)
    fastest_s = fastest_feasible_s(config, scenario.change.of(config) if scenario.change else config.sim)
    run = Run(config, [TrialRecord.of(trial) for trial in trials], ending, scenario.change, fastest_s)
    changes = " ".join(f"`{text}`" for text in scenario.overrides) or "As configured"
    if scenario.change:
        values = " ".join(f"`sim.{key}={value:g}`" for key, value in scenario.change.sim.items())
        changes += f"; from trial {scenario.change.at_trial} on {values}"
    head = f"{changes}. {ending.outcome.capitalize()}: {ending.message or 'no message'}."
    table = Table(COLUMNS, list(enumerate(run.trials, start=1))).markdown()
    return f"{head}\n\n{table}", [(wanted, *target(run)) for wanted, target in scenario.targets.items()]


@study()
def adaptive(options: StudyOptions) -> None:
    """Practise adaptively on easy, hard, impossible and changing arms, and judge what is promised.

    --only takes the headings of the page.
    """
    options.chapters("adaptive.md", list(SCENARIOS), chapter, options.overrides, config=CONFIG.name)
