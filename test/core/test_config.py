"""Records that are right once they exist."""

from __future__ import annotations

import math
from typing import Any

import pytest
from two_link import arm_config

from tel_ros.core.config import (
    ArmConfig,
    Config,
    ControlConfig,
    LearningConfig,
    PathConfig,
    PracticeConfig,
    RunConfig,
    SafetyConfig,
    SimConfig,
)
from tel_ros.core.errors import ConfigError

NAN, INF = math.nan, math.inf
NOT_POSITIVE = (0.0, -1.0, NAN, INF)
NEGATIVE = (-1e-9, NAN, INF)
BAD: list[tuple[type, str, Any, str]] = [
    (RunConfig, "arm", "robot", "'sim' or 'external'"),
    *(
        (PracticeConfig, "durations_s", (9.0, bad), "finite times of at least goal_duration_s = 4.5 s")
        for bad in (4.4, NAN, INF)
    ),
    *((PracticeConfig, "tolerance_rad", bad, "a finite number above 0") for bad in NOT_POSITIVE),
    *((PracticeConfig, "step_tolerance_rad", bad, "at least tolerance_rad = 0.005 rad") for bad in (4e-3,)),
    (PracticeConfig, "spacing", "", "'duration' or 'speed' or 'torque'"),
    (PracticeConfig, "on_abort", None, "'stop' or 'continue'"),
    (LearningConfig, "weights", "LMS", "'least_squares'"),
    (LearningConfig, "filter", "none", "'auto'"),
    (LearningConfig, "gaussians", "unit", "'normalised'"),
    (LearningConfig, "forgetting", 0.0, "above 0 and up to 1"),
    (LearningConfig, "memory_samples", 10, "at least 1000"),
    (LearningConfig, "weights", "rls", "'lms'"),
    (LearningConfig, "training", 1, "'actual' or 'desired'"),
    (SimConfig, "clock", "fast", "'lockstep' or 'realtime'"),
    *((RunConfig, "arm_timeout_s", bad, "a finite number above 0") for bad in NOT_POSITIVE),
    (PracticeConfig, "trials", 0, "a whole number of at least 1"),
    *((PracticeConfig, "goal_duration_s", bad, "a finite number above 0") for bad in NOT_POSITIVE),
    *((PracticeConfig, "first_duration_s", bad, "at least goal_duration_s = 4.5 s") for bad in (4.4,)),
    (LearningConfig, "gaussians_per_input", 1, "at least 2"),
    (LearningConfig, "max_subtrees", -1, "at least 0"),
    (LearningConfig, "growth_per_trial", -1, "at least 0"),
    *((LearningConfig, "rate", bad, "a number above 0 and up to 1") for bad in (0.0, 1.01, NAN)),
    (LearningConfig, "passes", 0, "a whole number of at least 1"),
    *((LearningConfig, "gaussian_width", bad, "a finite number above 0") for bad in NOT_POSITIVE),
    *((LearningConfig, "input_margin", bad, "at least 1") for bad in (0.99, NAN, INF)),
    *((LearningConfig, "filter_cutoff_hz", bad, "a finite number of at least 0") for bad in NEGATIVE),
    *(
        (ControlConfig, key, bad, "a finite number above 0")
        for key in (
            "rate_hz",
            "path_tolerance_rad",
            "approach_speed_rad_s",
            "settle_speed_rad_s",
            "settle_time_s",
            "state_timeout_s",
        )
        for bad in NOT_POSITIVE
    ),
    *((ControlConfig, "realtime_priority", bad, "a whole number from 0 to 98") for bad in (-1, 99)),
    *((ControlConfig, "settle_timeout_s", bad, "above settle_time_s = 0.5 s") for bad in (0.5, 0.1)),
    *(
        (SimConfig, key, bad, "a finite number above 0")
        for key in ("physics_rate_hz", "inertia_scale", "drive_stiffness_scale", "lockstep_timeout_s")
        for bad in NOT_POSITIVE
    ),
    *((SimConfig, "watchdog_s", bad, "above 0 and up to 0.1") for bad in (0.0, 0.11, NAN)),
    *((SimConfig, "encoder_bits", bad, "0 (exact), or 8 to 32") for bad in (1, 7)),
    *(
        (SimConfig, key, bad, "a finite number of at least 0")
        for key in ("position_noise_rad", "velocity_filter_hz", "command_delay_s", "payload_kg")
        for bad in NEGATIVE
    ),
    *(
        (SimConfig, key, (0.1, bad), "finite numbers of at least 0")
        for key in ("viscous_friction_nms_per_rad", "coulomb_friction_nm")
        for bad in NEGATIVE
    ),
]
BAD_ARMS: list[tuple[str, Any, str]] = [
    ("joints", (), "at least one joint name"),
    ("joints", ("elbow", "elbow"), "each joint once"),
    *(
        (key, (15.0, bad), "finite numbers above 0")
        for key in (
            *("stiffness_nm_per_rad", "effort_limit_nm", "velocity_limit_rad_s"),
            "set_point_speed_rad_s",
        )
        for bad in NOT_POSITIVE
    ),
    *(("damping_nms_per_rad", (1.5, bad), "finite numbers of at least 0") for bad in NEGATIVE),
    *(
        (key, (0.0, bad), "finite numbers")
        for key in ("position_min_rad", "position_max_rad")
        for bad in (NAN, INF, -INF)
    ),
    *(
        (key, (1.0,) * n, ", one for each of the joints shoulder, elbow")
        for key in ("stiffness_nm_per_rad", "damping_nms_per_rad", "effort_limit_nm", "position_min_rad")
        for n in (1, 3)
    ),
    ("position_max_rad", (2.9, -2.9), "above [-2.9, -2.9]"),
    ("command_interface", "velocity", "'effort' or 'position'"),
]


def config(**values: Any) -> Config:
    return Config(**({"arm": arm_config(), "path": PathConfig(name="planar_loops")} | values))


def assert_complaint(error: ConfigError, key: str, value: Any, expected: str) -> None:
    value = list(value) if isinstance(value, tuple) else value
    assert str(error).startswith(f"{key} is {value!r}; expected ")
    assert expected in str(error)
    assert error.key == key


def test_a_bad_value_is_refused_with_key_value_and_expectation() -> None:
    for record, key, bad, expected in (*BAD, *((arm_config, *row) for row in BAD_ARMS)):
        try:
            record(**{key: bad})
        except ConfigError as error:
            assert_complaint(error, key, bad, expected)
        else:
            pytest.fail(f"{record.__name__} takes {key} = {bad!r}")


@pytest.mark.parametrize(
    "values", [{}, {"name": "planar_loops", "file": "path.csv"}], ids=["neither", "both"]
)
def test_a_path_is_either_a_name_or_a_file(values: dict[str, str]) -> None:
    with pytest.raises(ConfigError, match="expected either a name or a file .* and not both"):
        PathConfig(**values)


def test_the_defaults_are_the_papers_numbers() -> None:
    practice, learning = PracticeConfig(), LearningConfig()
    assert (practice.trials, practice.first_duration_s, practice.goal_duration_s) == (15, 11.5, 4.5)
    assert (learning.gaussians_per_input, learning.max_subtrees, learning.training) == (10, 15, "actual")


def test_values_at_the_ends_of_their_ranges_are_taken() -> None:
    PracticeConfig(trials=1, first_duration_s=4.5)
    LearningConfig(rate=1.0, max_subtrees=0, growth_per_trial=0, filter_cutoff_hz=0.0, input_margin=1.0)
    SimConfig(encoder_bits=0, watchdog_s=0.1)
    arm_config(damping_nms_per_rad=(0.0, 0.0))


def test_limits_that_the_urdf_is_to_give_may_be_left_out() -> None:
    arm = arm_config(position_min_rad=(), position_max_rad=(), velocity_limit_rad_s=())
    assert isinstance(arm, ArmConfig)


@pytest.mark.parametrize("physics_rate_hz", [499.0, 750.0, 4001.0])
def test_physics_must_run_at_a_whole_multiple_of_the_control_rate(physics_rate_hz: float) -> None:
    with pytest.raises(ConfigError) as refusal:
        config(sim=SimConfig(physics_rate_hz=physics_rate_hz))
    assert_complaint(
        refusal.value, "sim.physics_rate_hz", physics_rate_hz, "a whole multiple of control.rate_hz = 500.0"
    )


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigError) as refusal:
        config(seed=-1)
    assert_complaint(refusal.value, "seed", -1, "a whole number of at least 0")


@pytest.mark.parametrize(
    "key", ["viscous_friction_nms_per_rad", "coulomb_friction_nm", "initial_position_rad"]
)
def test_values_of_the_simulated_arm_are_given_for_all_joints_or_none(key: str) -> None:
    config(sim=SimConfig(**{key: (0.1, 0.2)}))
    with pytest.raises(ConfigError) as refusal:
        config(sim=SimConfig(**{key: (0.1,)}))
    assert_complaint(refusal.value, f"sim.{key}", (0.1,), "one for each of the joints shoulder, elbow")


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
def test_an_initial_position_that_is_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(ConfigError, match="initial_position_rad is .*expected .*finite"):
        config(sim=SimConfig(initial_position_rad=(0.1, bad)))


@pytest.mark.parametrize(
    ("arm", "clock", "waits"),
    [("sim", "lockstep", True), ("sim", "realtime", False), ("external", "lockstep", False)],
)
def test_only_the_simulated_arm_in_lockstep_waits_for_commands(arm: str, clock: str, waits: bool) -> None:
    assert config(run=RunConfig(arm=arm), sim=SimConfig(clock=clock)).arm_waits_for_commands == waits


def test_a_guard_of_an_arm_that_waits_for_commands_makes_no_sense() -> None:
    with pytest.raises(ConfigError, match="guard is 'always'; expected 'external' or 'never'"):
        config(safety=SafetyConfig(guard="always"))


def test_the_stiffness_of_drives_cannot_be_practised() -> None:
    arm = arm_config(command_interface="position")
    with pytest.raises(ConfigError, match="no stiffness, because arm.command_interface is 'position'"):
        config(arm=arm, practice=PracticeConfig(vary=("stiffness", "speed")))
    assert config(practice=PracticeConfig(vary=("stiffness", "speed"))).arm.command_interface == "effort"
