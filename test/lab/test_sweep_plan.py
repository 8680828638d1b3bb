"""How a sweep is laid out, and what is refused before anything runs."""

from __future__ import annotations

import copy
import shutil
from pathlib import Path

import pytest

from tel_lab.sweep.plan import (
    MapPlan,
    SweepPlan,
    config_hash,
    lay_out,
    make_plan,
    parse_grid,
)
from tel_ros.core.config import file_keys
from tel_ros.core.errors import ConfigError
from tel_ros.recording.config_file import load_config

ROOT = Path(__file__).parents[2]
PAPER = ROOT / "config" / "paper.yaml"


def test_every_combination_of_cases_grids_and_seeds_is_one_point() -> None:
    plan = SweepPlan(
        overrides=("seed=5",),
        cases={"a": {"practice.strategy": "direct"}, "b": {}},
        grid={"sim.inertia_scale": (1, 2, 3), "practice.goal_duration_s": (6, 4.5)},
        seeds=2,
    )
    points = lay_out(PAPER, plan)
    assert len(points) == len({point.key for point in points}) == 2 * 3 * 2 * 2
    assert dict(points[0].labels) == {
        "case": "a",
        "sim.inertia_scale": 1.0,
        "practice.goal_duration_s": 6.0,
        "seed": 5,
    }
    config = points[-1].config
    assert config is not None
    assert (config.practice.strategy, config.sim.inertia_scale, config.seed) == (
        "trajectory_extension",
        3.0,
        6,
    )


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("sim.inertia_scale=0.5,1", (0.5, 1)),
        ("practice.strategy=direct, adaptive_extension", ("direct", "adaptive_extension")),
        ("sim.coulomb_friction_nm=[0, 0],[0.3, 0.3]", ([0, 0], [0.3, 0.3])),
    ],
)
def test_the_values_of_a_grid_are_yaml(text: str, values: tuple[object, ...]) -> None:
    assert parse_grid(text) == (text.partition("=")[0], values)


@pytest.mark.parametrize("text", ["sim.inertia_scale", "sim.inertia_scale=", "=1,2", "sim.inertia_scale=[1"])
def test_a_grid_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--grid"):
        parse_grid(text)


@pytest.mark.parametrize(
    ("grid", "parts"),
    [
        ("sim.inertia_scal=1,2", ["sim.inertia_scal", "known key", "inertia_scale"]),
        ("sim.inertia_scale=1,heavy", ["--grid sim.inertia_scale", "'heavy'", "a finite number"]),
        ("sim.inertia_scale=1,-2", ["sim.inertia_scale is -2", "above 0"]),
        (
            "practice.goal_duration_s=4.5,12",
            ["--grid practice.goal_duration_s=12", "goal_duration_s = 12.0 s"],
        ),
    ],
)
def test_a_key_or_value_that_fits_nowhere_is_named(grid: str, parts: list[str]) -> None:
    plan = make_plan(ROOT / "config" / "sweeps" / "inertia_speed.yaml", grid=[grid])
    with pytest.raises(ConfigError) as caught:
        lay_out(PAPER, plan)
    for part in parts:
        assert part in str(caught.value)


def test_a_corner_where_two_values_do_not_go_together_is_a_point_with_a_problem() -> None:
    plan = SweepPlan(
        grid={"practice.first_duration_s": (5, 11.5), "practice.goal_duration_s": (4.5, 6)}, seeds=2
    )
    points = lay_out(PAPER, plan)
    (bad,) = [point for point in points if point.config is None]
    assert bad.labels["practice.first_duration_s"] == 5
    assert bad.labels["practice.goal_duration_s"] == 6
    assert "practice.first_duration_s is 5.0" in bad.problem
    assert len(points) == 3 * 2 + 1


def test_a_case_that_fits_nowhere_is_named() -> None:
    plan = SweepPlan(cases={"good": {}, "odd": {"learning.rate": 2}}, grid={"sim.inertia_scale": (1, 2)})
    with pytest.raises(ConfigError, match=r"case odd: learning\.rate is 2"):
        lay_out(PAPER, plan)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"seeds": 0}, "--seeds is 0"),
        ({"grid": {"seed": (1, 2)}, "seeds": 2}, "the grid names the seeds"),
        ({"grid": {"sim.inertia_scale": (1, 2, 1)}}, "each once"),
        ({"grid": {"learning.rate": (1,)}, "cases": {"a": {"learning.rate": 0.5}}}, "not in both"),
        ({"map": MapPlan(x="sim.payload_kg", y="seed", tolerance_rad=0.1)}, "keys of the grid"),
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(wrong: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SweepPlan(**wrong)


def test_a_grid_on_the_command_line_takes_the_place_of_the_files() -> None:
    file = ROOT / "config" / "sweeps" / "inertia_speed.yaml"
    plan = make_plan(file, ["practice.trials=3"], ["sim.inertia_scale=7"], seeds=4)
    assert plan.grid["sim.inertia_scale"] == (7,)
    assert plan.grid["practice.goal_duration_s"] == make_plan(file).grid["practice.goal_duration_s"]
    assert plan.overrides[-1] == "practice.trials=3"
    assert plan.seeds == 4


def test_an_unknown_key_in_the_file_of_a_sweep_is_named(tmp_path: Path) -> None:
    file = tmp_path / "sweep.yaml"
    file.write_text("grids: {sim.inertia_scale: [1]}\n")
    with pytest.raises(ConfigError, match=r"sweep\.yaml: grids is .*; expected a known key: set, cases"):
        make_plan(file)


def test_the_hash_follows_what_files_hold_and_not_where_they_lie(tmp_path: Path) -> None:
    config = load_config(PAPER)
    urdf = tmp_path / "arm.urdf"
    shutil.copy(config.arm.urdf, urdf)
    moved = load_config(PAPER, [f"arm.urdf={urdf}"])
    assert config_hash(moved) == config_hash(config)
    urdf.write_text(urdf.read_text().replace("</robot>", "<!-- another arm --></robot>"))
    assert config_hash(moved) != config_hash(config)
    assert config_hash(load_config(PAPER, ["learning.rate=0.4"])) != config_hash(config)


@pytest.mark.parametrize("key", file_keys())
def test_a_file_whose_content_changes_makes_another_result(key: str, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("before")
    config = load_config(PAPER)
    section, name = key.split(".")
    # Set past the checks, which want some keys together with others.
    part = copy.copy(getattr(config, section))
    object.__setattr__(part, name, (str(file),) if key == "path.files" else str(file))
    object.__setattr__(config, section, part)
    before = config_hash(config)
    file.write_text("after")
    assert config_hash(config) != before
