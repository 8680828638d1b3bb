"""Practice towards what the effort limits allow: steps in the share of the effort, and what ends it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from made_up_arm import config_of, report_of

from tel_ros.core.config import Config, SafetyConfig
from tel_ros.core.errors import ConfigError, TrajectoryError
from tel_ros.core.practice.learned_timings import LearnedTimings
from tel_ros.core.practice.session import Prediction
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Ending, Forecast, Movement, PlannedTrial, Strategy
from tel_ros.core.safety.motion_rules import BrakingDistance, SoftLimits
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trajectories.timing import MinimumJerk, Timing
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome, TrialReport


def fastest(**practice: object) -> Config:
    values = {"strategy": "adaptive_extension", "goal": "fastest", "first_duration_s": 12.0} | practice
    config = config_of(**values)  # type: ignore[arg-type]
    limits = {"velocity_limit_rad_s": (15.0, 15.0), "position_min_rad": (-3.0, -3.0)}
    return replace(config, arm=replace(config.arm, **limits, position_max_rad=(3.0, 3.0)))


@dataclass
class EffortArm:
    """Runs its path in ``possible_s`` with 90 % of its limits; what is learned is as uncertain as ``std``."""

    possible_s: float = 1.5
    std: Callable[[float], float] = lambda share: 1e-3
    error: Callable[[float], float] = lambda share: 1e-3
    limit_nm: float = 20.0
    asked: list[Movement] = field(default_factory=list)

    def forecast(self, movement: Movement) -> Forecast:
        self.asked.append(movement)
        share, shape = movement.effort_share, np.ones((10, 2))
        if share is None:
            return Forecast(np.inf * shape, 0.0 * shape, shape, movement.duration_s)
        effort_nm = share * self.limit_nm * shape * [1.0, 0.5]
        return Forecast(self.std(share) * shape, effort_nm, shape, self.possible_s * (0.9 / share) ** 0.5)

    def practise(self, strategy: Strategy) -> tuple[list[PlannedTrial], Ending]:
        plans: list[PlannedTrial] = []
        last: TrialReport | None = None
        while isinstance(plan := strategy.next(last, self.forecast), PlannedTrial):
            plans.append(plan)
            share = plan.movement.effort_share
            error_rad = 0.07 if share is None else self.error(share)
            last = report_of(plan, rms_error_rad=error_rad, max_error_rad=3.0 * error_rad)
        return plans, plan


def test_the_share_of_the_effort_rises_from_a_slow_trial_to_the_goal() -> None:
    plans, ending = EffortArm().practise(make_strategy(fastest()))
    shares = [plan.movement.effort_share for plan in plans]
    assert plans[0].movement == Movement(12.0)
    assert shares[1:] == sorted(shares[1:]) and shares[1] < 0.3 and shares[-1] == 0.9
    assert [plan.alpha for plan in plans] == [0.0, *((share / 0.9) ** 0.5 for share in shares[1:])]
    assert [plan.movement.duration_s for plan in plans[1:]] == pytest.approx(
        [1.5 * (0.9 / share) ** 0.5 for share in shares[1:]]
    )
    assert ending.outcome == "completed"
    assert "limited by effort of shoulder for 100 % of the time" in ending.message.replace("j1", "shoulder")
    assert "elbow" not in ending.message


def test_what_is_believed_possible_is_said_with_each_trial_after_the_first() -> None:
    plans, ending = EffortArm(possible_s=2.34).practise(make_strategy(fastest(effort_share=0.9)))
    assert np.isnan(plans[0].possible_s)
    assert all(plan.possible_s == 2.34 for plan in plans[1:])
    assert all("about 2.34 s are possible at 90 % of the effort limits" in plan.reason for plan in plans[1:])
    assert ending.message.startswith(
        "2.34 s, the fastest with 90 % of the effort limits reached with 1.00 mrad"
    )


def test_a_step_goes_only_as_far_as_what_was_learned_is_certain() -> None:
    certain = EffortArm(std=lambda share: 1e-3 if share < 0.35 else 0.1).practise(make_strategy(fastest()))
    shares = [plan.movement.effort_share for plan in certain[0][1:]]
    assert max(shares) < 0.35
    assert certain[1].outcome == "stopped"
    assert "leaves too little certainty for more than" in certain[1].message
    assert len(shares) < 10, "it does not go on until the trials are used up"


def test_a_step_leaves_room_for_the_uncertainty_of_the_effort() -> None:
    # Errors are small in proportion; of that 1 / 0.3 is believed: twice 12 mrad · 15 N·m/rad are 0.36 N·m.
    arm = EffortArm(std=lambda share: 0.04)
    plans, ending = arm.practise(make_strategy(fastest(effort_share=1.0, step_tolerance_rad=0.2)))
    assert 0.97 < max(plan.movement.effort_share or 0.0 for plan in plans) <= 0.982
    assert ending.outcome == "stopped"


def test_a_little_time_is_traded_for_accuracy_where_repeating_does_not_help() -> None:
    arm = EffortArm(error=lambda share: 6e-3 * (share / 0.9) ** 4)
    plans, ending = arm.practise(make_strategy(fastest()))
    shares = [plan.movement.effort_share for plan in plans]
    assert shares.count(0.9) == 2, "it is repeated once"
    assert 0.75 < shares[-1] < 0.9
    assert ending.outcome == "completed"
    assert ending.message.endswith("faster ones did not come within 5 mrad")


def test_errors_that_fall_by_repeating_are_not_traded() -> None:
    errors = iter([1e-3, 1e-3, 12e-3, 8e-3, 4e-3])
    plans, ending = EffortArm(error=lambda share: next(errors)).practise(make_strategy(fastest()))
    assert [plan.movement.effort_share for plan in plans[-3:]] == [0.9] * 3
    assert ending.outcome == "completed" and "did not come" not in ending.message


def test_after_an_abort_it_goes_back_to_the_last_good_network_and_less_effort() -> None:
    strategy, arm = make_strategy(fastest()), EffortArm()
    last: TrialReport | None = None
    for _ in range(2):
        good = strategy.next(last, arm.forecast)
        assert isinstance(good, PlannedTrial)
        last = report_of(good, rms_error_rad=1e-3, max_error_rad=3e-3)
    tried = strategy.next(last, arm.forecast)
    assert isinstance(tried, PlannedTrial)
    back = strategy.next(report_of(tried, Outcome.ABORTED), arm.forecast)
    assert isinstance(back, PlannedTrial)
    assert back.go_back_to == good.index
    assert back.movement.duration_s > tried.movement.duration_s


def test_a_path_that_efforts_do_not_allow_at_any_speed_ends_practice_with_the_reason() -> None:
    def forecast(movement: Movement) -> Forecast:
        if movement.effort_share is not None:
            raise TrajectoryError("lift needs 19.0 N·m against gravity")
        return EffortArm().forecast(movement)

    strategy = make_strategy(fastest())
    first = strategy.next(None, forecast)
    assert isinstance(first, PlannedTrial)
    ending = strategy.next(report_of(first), forecast)
    assert isinstance(ending, Ending) and ending.outcome == "stopped"
    assert ending.message.endswith("cannot be found: lift needs 19.0 N·m against gravity")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"strategy": "direct"}, "practice.strategy is 'direct'; expected adaptive_extension, because goal"),
        ({"vary": ("amplitude", "speed")}, "vary is .*; expected only speed, because goal is 'fastest'"),
        ({"goal": "duration", "timing": "time_optimal"}, "expected 'auto' or 'minimum_jerk', because goal"),
        ({"effort_share": 1.1}, "effort_share is 1.1; expected a number above 0 and up to 1"),
    ],
)
def test_what_does_not_go_with_the_fastest_movement_is_refused(values: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_strategy(fastest(**values))


def predict_inertia(config: Config, desired: DesiredTrajectory) -> Prediction:
    """Return what is predicted for uncoupled joints of 0.5 kg·m² with viscous friction."""
    effort_nm = 0.5 * desired.acceleration_rad_s2 + 0.1 * desired.velocity_rad_s
    springs = Springs.of(config.arm)
    equilibrium_rad = springs.equilibrium(effort_nm, desired.position_rad, desired.velocity_rad_s)
    return Prediction(equilibrium_rad, np.zeros_like(effort_nm))


def timing_of(config: Config, share: float | None, given_nm: dict[str, float] | None = None) -> Timing:
    timings = LearnedTimings(config, NAMED_PATHS["planar_loops"], None)
    timings.heed(given_nm or {})
    return timings.of(Movement(9.0, effort_share=share), lambda desired: predict_inertia(config, desired))


def test_movements_with_a_share_are_timed_by_what_was_learned_and_others_by_their_duration() -> None:
    config = fastest()
    assert timing_of(config, None) == MinimumJerk(9.0)
    slow, fast = timing_of(config, 0.1), timing_of(config, 0.9)
    assert slow.duration_s > 2.5 * fast.duration_s
    jerk = timing_of(replace(config, practice=replace(config.practice, timing="minimum_jerk")), 0.9)
    assert isinstance(jerk, MinimumJerk)
    assert jerk.duration_s > 1.4 * fast.duration_s


def test_the_first_command_of_a_time_optimal_movement_is_that_of_rest() -> None:
    ds, dds = timing_of(fastest(), 0.9).at(np.array([0, 2_000_000]))[1:]
    assert np.all(ds == 0.0) and np.all(np.abs(dds) < 1e-9)


def test_a_movement_towards_a_soft_limit_is_as_fast_as_the_safety_layer_lets_it_be() -> None:
    """Above that speed the layer takes effort away: impulses would be lost, and the arm leave its path."""
    path, config = NAMED_PATHS["planar_loops"], fastest()
    highest_rad = float(path.evaluate(np.linspace(0.0, 1.0, 500))[0][:, 1].max())
    arm = replace(config.arm, position_max_rad=(3.0, highest_rad + 0.2))
    near = replace(config, arm=arm, safety=SafetyConfig(deceleration_rad_s2=(50.0, 4.0)))
    timing = timing_of(near, 0.9)
    assert timing.duration_s > 1.02 * timing_of(config, 0.9).duration_s
    s, ds, _ = timing.at(np.arange(0, round(1e9 * timing.duration_s), 2_000_000))
    q, dq, _ = path.evaluate(s)
    speed = dq[:, 1] * ds
    walls = SoftLimits.of(arm, near.safety)
    fastest_rad_s = BrakingDistance.of(arm, near.safety, walls).fastest(walls.high_rad - q)[:, 1]
    assert np.all(speed <= fastest_rad_s)
    assert np.max(speed / fastest_rad_s) > 0.8


def test_a_drive_that_gives_less_makes_the_movement_slower() -> None:
    joint = fastest().arm.joints[0]
    assert timing_of(fastest(), 0.9, {joint: 5.0}).duration_s > 1.4 * timing_of(fastest(), 0.9).duration_s


def test_timings_follow_the_network_as_soon_as_they_are_told_that_it_may_have_changed() -> None:
    config, asked = fastest(), []
    timings = LearnedTimings(config, NAMED_PATHS["planar_loops"], None)

    def predict(desired: DesiredTrajectory) -> Prediction:
        asked.append(desired)
        return predict_inertia(config, desired)

    movement = Movement(9.0, effort_share=0.5)
    assert timings.of(movement, predict) is timings.of(replace(movement), predict)
    assert len(asked) == 1
    timings.forget()
    timings.of(movement, predict)
    assert len(asked) == 2
