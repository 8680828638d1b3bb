"""Methods on simulated arms: the same arms for all, repeatable, and each method does what its name says."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tel_lab.comparison.compare_command import compare
from tel_lab.comparison.method_runs import Task, method_config, new_movement, run_method
from tel_lab.comparison.methods import METHODS, chosen, goal_movement
from tel_lab.comparison.results import MethodRun
from tel_ros.app.cli import main as tel
from tel_ros.core.errors import ConfigError

CONFIG = Path(__file__).parents[2] / "config" / "planar_arm.yaml"
QUICK = (
    *("practice.first_duration_s=4", "practice.goal_duration_s=3", "control.path_tolerance_rad=2"),
    *("control.rate_hz=200", "sim.physics_rate_hz=1000"),
)


def task(trials: int = 2) -> Task:
    return Task(CONFIG, QUICK, trials)


def without_clock(run: MethodRun) -> MethodRun:
    return dataclasses.replace(run, cpu_s=0.0)


def test_all_methods_get_the_same_arm_and_noise_and_another_seed_another() -> None:
    configs = [method_config(task(), spec, 3) for spec in METHODS.values()]
    assert len({(repr(config.sim), config.seed) for config in configs}) == 1
    assert method_config(task(), METHODS["no_learning"], 4).sim != configs[0].sim


def test_only_the_stiffer_servo_has_other_springs_and_keeps_the_damping_ratio() -> None:
    springs = {
        name: (config.arm.stiffness_nm_per_rad, config.arm.damping_nms_per_rad)
        for name, config in ((name, method_config(task(), spec, 1)) for name, spec in METHODS.items())
    }
    assert springs.pop("stiffer_servo") == ((60.0, 60.0), (3.0, 3.0))
    assert set(springs.values()) == {((15.0, 15.0), (1.5, 1.5))}


@pytest.mark.parametrize("seed", range(1, 11))
def test_the_new_path_asks_for_no_more_than_was_practised_but_for_something_else(seed: int) -> None:
    config = method_config(task(), METHODS["no_learning"], seed)
    practised, other = goal_movement(config), new_movement(config, seed)
    for name, tolerance in (("velocity_rad_s", 1.001), ("acceleration_rad_s2", 1.01)):
        ratio = np.abs(getattr(other, name)).max(axis=0) / np.abs(getattr(practised, name)).max(axis=0)
        assert np.all(ratio <= tolerance)
    assert np.all(other.position_rad.min(axis=0) >= practised.position_rad.min(axis=0))
    assert np.all(other.position_rad.max(axis=0) <= practised.position_rad.max(axis=0))
    assert np.abs(other.position_rad[len(other.position_rad) // 3] - practised.position_rad[0]).max() > 1e-3


def test_the_exact_model_is_far_better_than_the_servo_on_both_paths() -> None:
    exact, servo = (run_method(task(), name, 2) for name in ("exact_model", "no_learning"))
    assert exact.final_error_rad < 0.05 * servo.final_error_rad
    assert exact.new_path_error_rad < 0.05 * servo.new_path_error_rad
    assert len(servo.trials) == 1  # a second one would be the same


def test_iterative_learning_improves_and_has_nothing_to_say_about_another_path() -> None:
    run = run_method(task(trials=3), "iterative_learning", 1)
    assert run.final_error_rad < 0.6 * run.trials[0].rms_error_rad
    assert run.new_path is None
    assert len(run.trials) == 3


def test_practice_that_has_reached_its_goal_uses_up_its_budget_at_the_goal_speed() -> None:
    run = run_method(task(trials=5), "tel_adaptive_rigid_body", 1)
    assert len(run.trials) == 5
    assert run.trials_to_tolerance < 5
    assert [t.duration_s for t in run.trials[int(run.trials_to_tolerance) :]] == pytest.approx(
        [3.0] * (5 - int(run.trials_to_tolerance))
    )


def test_equal_runs_have_equal_results() -> None:
    one, other = (run_method(task(trials=1), "feedback_error", 5) for _ in range(2))
    assert without_clock(one) == without_clock(other)


@pytest.mark.timeout(180)
def test_the_command_prints_what_a_run_of_its_own_finds(tmp_path: Path) -> None:
    options = ["--methods", "no_learning", "--seeds", "1", "--trials", "1", "--json", "--out", str(tmp_path)]
    settings = [part for text in QUICK for part in ("--set", text)]
    result = CliRunner().invoke(compare, [str(CONFIG), *options, *settings], catch_exceptions=False)
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    (run,) = found["methods"]["no_learning"]["runs"]
    assert run["final_error_rad"] == run_method(task(trials=1), "no_learning", 1).final_error_rad
    assert json.loads((tmp_path / "comparison.json").read_text()) == found
    assert (tmp_path / "comparison.png").stat().st_size > 0
    assert "1/1" in result.stderr


@pytest.mark.timeout(180)
def test_a_run_that_breaks_down_ends_the_command_with_code_1_and_one_line() -> None:
    options = ["--methods", "no_learning", "--seeds", "1", "--set", "practice.goal_duration_s=0.3"]
    result = CliRunner().invoke(compare, [str(CONFIG), *options], catch_exceptions=False)
    assert result.exit_code == 1
    assert result.stderr.startswith("tel: no_learning on arm 1: ")
    assert "rad/s" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--methods", "ilc"], "--methods is 'ilc'; expected some of no_learning, "),
        (["--seeds", "0"], "--seeds is 0; expected a whole number of at least 1"),
        (["--jobs", "0"], "--jobs is 0; expected"),
        (["--trials", "0"], "practice.trials is 0; expected"),
        (["--set", "sim.payload=1"], "sim.payload"),
        (["--set", "path.file=nowhere.csv"], "nowhere.csv"),
        (["--set", "arm.urdf=nowhere.urdf"], "nowhere.urdf"),
        (["--out", "/proc/nowhere"], "/proc/nowhere: cannot be written to"),
    ],
)
def test_wrong_input_ends_with_code_2_and_one_line(options: list[str], said: str) -> None:
    result = CliRunner().invoke(compare, [str(CONFIG), *options])
    assert result.exit_code == 2
    assert said in result.stderr
    assert result.stderr.startswith("tel: ") and result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_a_missing_configuration_is_named() -> None:
    result = CliRunner().invoke(tel, ["compare", "nowhere.yaml"])
    assert result.exit_code == 2
    assert "nowhere.yaml" in result.stderr


def test_methods_come_in_the_order_of_the_table_however_they_are_named() -> None:
    assert [spec.name for spec in chosen(["exact_model", "no_learning"])] == ["no_learning", "exact_model"]
    assert [spec.name for spec in chosen([])] == list(METHODS)
    with pytest.raises(ConfigError, match="iterative_learning"):
        chosen(["nothing"])


def test_only_methods_that_say_so_are_told_the_model() -> None:
    for given in ("urdf", "model"):
        told = {spec.name for spec in METHODS.values() if spec.given == given}
        assert (
            told
            == {"urdf": {"toppra_urdf_servo"}, "model": {"exact_model", "toppra_urdf_exact", "toppra_exact"}}[
                given
            ]
        )
    kinematics = [spec for spec in METHODS.values() if spec.given == "kinematics"]
    assert all("rigid_body" in spec.name for spec in kinematics)
    assert all(spec in kinematics for spec in METHODS.values() if "rigid_body" in str(spec.settings))


def test_what_people_use_is_as_fast_as_the_urdf_says_and_follows_worse_than_practice() -> None:
    """The arm of seed 2 is not that of the URDF, for which the timing of two of the rivals is made."""
    names = ("toppra_urdf_servo", "toppra_urdf_exact", "toppra_exact", "tel_fastest_rigid_body")
    servo, exact, both, practised = (run_method(Task(CONFIG, (), 8), name, 2) for name in names)
    assert servo.final.duration_s == exact.final.duration_s != both.final.duration_s
    assert 1.0 < both.time_over_bound < 1.1 < practised.time_over_bound + 0.05
    assert practised.time_over_bound < 1.2
    assert 5.0 * practised.final_error_rad < exact.final_error_rad < servo.final_error_rad
