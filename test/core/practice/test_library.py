"""Several paths, one network."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from made_up_arm import MadeUpArm, config_of, practise, report_of

from tel_ros.core.config import Config, PathConfig
from tel_ros.core.errors import ConfigError
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.trial import Outcome, TrialReport

PATHS = ("reach", "loop", "swing")


def several(**practice: object) -> Config:
    config = config_of(**({"strategy": "adaptive_extension", "trials": 30} | practice))
    return replace(config, path=PathConfig(files=tuple(f"/some/where/{name}.csv" for name in PATHS)))


class MadeUpArms(MadeUpArm):
    """Paths that have nothing to do with each other; those of ``forgets`` forget all when another is learned.

    ``forgets``: path to the number of the trial at which it happens.
    """

    def __init__(self, forgets: dict[str, int] | None = None, **special: MadeUpArm) -> None:
        self.arms = {name: special.get(name, MadeUpArm(growth_rad=0.02)) for name in PATHS}
        self.forgets = forgets or {}

    def forecast(self, movement: Movement) -> Forecast:
        return self.arms[movement.path].forecast(movement)

    def execute(self, plan: PlannedTrial) -> TrialReport:
        for name in [name for name, at in self.forgets.items() if at == plan.index]:
            self.arms[name] = MadeUpArm(growth_rad=0.02)
        return self.arms[plan.movement.path].execute(replace(plan, go_back_to=None))


def practised(strategy: Strategy, arm: MadeUpArms) -> tuple[list[PlannedTrial], list[TrialReport], Ending]:
    return practise(strategy, arm)


def test_paths_take_turns_until_all_are_within_the_tolerance_at_the_goal() -> None:
    plans, reports, ending = practised(make_strategy(several()), MadeUpArms())
    assert ending.outcome == "completed"
    assert [plan.index for plan in plans] == list(range(1, len(plans) + 1))
    assert tuple(plan.movement.path for plan in plans[:6]) == PATHS * 2
    for name in PATHS:
        last = [k for k, plan in enumerate(plans) if plan.movement.path == name][-1]
        assert plans[last].movement == Movement(4.5, path=name)
        assert reports[last].rms_error_rad <= 5e-3
        assert f"{name}: 4.5 s reached" in ending.message
    assert plans[3].reason.startswith("reach, 2: ")


def test_a_path_that_was_forgotten_while_others_were_learned_is_practised_on() -> None:
    slow_to_learn = MadeUpArm(growth_rad=0.06)
    undisturbed, _, _ = practised(make_strategy(several()), MadeUpArms(swing=slow_to_learn))
    of_reach = [plan.index for plan in undisturbed if plan.movement.path == "reach"]
    again = next(plan for plan in undisturbed if "once more" in plan.reason)
    assert again.index == of_reach[-1] and again.movement == Movement(4.5, path="reach")

    arm = MadeUpArms({"reach": again.index - 1}, swing=MadeUpArm(growth_rad=0.06))
    plans, reports, ending = practised(make_strategy(several()), arm)
    assert reports[again.index - 1].rms_error_rad > 5e-3, "it was forgotten"
    assert len(plans) > len(undisturbed)
    assert ending.outcome == "completed"
    last = [k for k, plan in enumerate(plans) if plan.movement.path == "reach"][-1]
    assert reports[last].rms_error_rad <= 5e-3


def test_a_path_that_cannot_reach_its_goal_is_named_with_the_reason_and_the_others_are_practised() -> None:
    too_heavy = MadeUpArm(growth_rad=0.02, peak_nms2=900.0)
    plans, _, ending = practised(make_strategy(several()), MadeUpArms(loop=too_heavy))
    assert ending.outcome == "stopped"
    of_reach, of_loop, of_swing = (
        ending.message.split("; loop: ")[0],
        *ending.message.split("; loop: ")[1].split("; swing: "),
    )
    assert "4.5 s reached" in of_reach and "4.5 s reached" in of_swing
    assert "cannot be reached" in of_loop and "would need" in of_loop
    assert plans[-1].movement.path in PATHS


def test_paths_that_never_stop_disturbing_each_other_end_and_say_so() -> None:
    class Forgetful(MadeUpArms):
        def execute(self, plan: PlannedTrial) -> TrialReport:
            report = super().execute(plan)
            for name in PATHS:
                if name != plan.movement.path:
                    self.arms[name] = MadeUpArm(unlearned_rad=0.004)
            return report

    plans, _, ending = practised(make_strategy(several(trials=8)), Forgetful())
    assert len(plans) <= 3 * 8 + 8
    assert ending.outcome in ("stopped", "completed")
    assert all(f"{name}: " in ending.message for name in PATHS)


@pytest.mark.parametrize("strategy", ["direct", "trajectory_extension"])
def test_a_fixed_schedule_is_gone_through_for_each_path_and_what_is_above_the_tolerance_is_said(
    strategy: str,
) -> None:
    poor = MadeUpArm(floor_rad=0.05, growth_rad=0.0, unlearned_rad=0.05)
    good = {name: MadeUpArm(growth_rad=0.005, unlearned_rad=0.05) for name in ("reach", "loop")}
    plans, _, ending = practised(
        make_strategy(several(strategy=strategy, trials=4)), MadeUpArms(swing=poor, **good)
    )
    assert ending.outcome == "completed"
    # Those that are good enough are tried once more after the last trial of the one that is not.
    assert [plan.movement.path for plan in plans] == [*PATHS * 4, "reach", "loop"]
    assert "swing: 50.00 mrad RMS in the end, more than 5 mrad" in ending.message


def test_after_an_abort_practice_goes_back_to_the_last_completed_trial_of_any_path() -> None:
    strategy, arm = make_strategy(several()), MadeUpArms()
    last = None
    for _ in range(4):
        plan = strategy.next(last, arm.forecast)
        assert isinstance(plan, PlannedTrial)
        last = arm.execute(plan)
    plan = strategy.next(last, arm.forecast)
    assert isinstance(plan, PlannedTrial) and plan.movement.path == "loop"
    last = report_of(plan, Outcome.ABORTED, math.nan)
    while (
        isinstance(plan := strategy.next(last, arm.forecast), PlannedTrial) and plan.movement.path != "loop"
    ):
        assert plan.go_back_to is None
        completed = plan.index
        last = arm.execute(plan)
    assert isinstance(plan, PlannedTrial)
    assert plan.go_back_to == completed
    assert plan.movement.duration_s > 4.5


def test_a_cancelled_run_ends() -> None:
    strategy, arm = make_strategy(several()), MadeUpArms()
    plan = strategy.next(None, arm.forecast)
    assert isinstance(plan, PlannedTrial)
    ending = strategy.next(report_of(plan, Outcome.CANCELLED), arm.forecast)
    assert isinstance(ending, Ending) and ending.outcome == "cancelled"


def test_what_is_covered_and_checked_beforehand_is_that_of_all_paths() -> None:
    strategy = make_strategy(several())
    for movements in (strategy.preview(), strategy.movements_to_cover(), strategy.fastest_movements()):
        assert {movement.path for movement in movements} == set(PATHS)


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        ({"files": ("a.csv",), "file": "b.csv"}, "file is 'b.csv'; expected nothing, because path.files"),
        ({"files": ("a.csv",), "name": "planar_loops"}, "name is 'planar_loops'; expected nothing"),
        ({"files": ("one/a.csv", "other/a.csv")}, "expected files whose names differ"),
        ({"files": ("a.csv", "")}, "expected files whose names differ"),
        ({"files": ()}, "expected either a name or a file"),
    ],
)
def test_a_list_of_paths_that_cannot_be_meant_is_refused(path: dict[str, object], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        PathConfig(**path)  # type: ignore[arg-type]
