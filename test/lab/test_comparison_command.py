"""``tel compare``: wrong input is said in one line before any work begins."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from tel_lab.comparison.compare_command import compare
from tel_lab.comparison.methods import METHODS, chosen
from tel_ros.core.errors import ConfigError

CONFIG = str(Path(__file__).parents[2] / "config" / "planar_arm.yaml")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--methods", "ilc"], "--methods is 'ilc'; expected some of no_learning, "),
        (["--seeds", "0"], "--seeds is 0; expected a whole number of at least 1"),
        (["--jobs", "0"], "--jobs is 0; expected"),
        (["--trials", "0"], "practice.trials is 0; expected"),
        (["--set", "sim.payload=1"], "sim.payload"),
    ],
)
def test_wrong_input_ends_with_code_2_and_one_line(options: list[str], said: str) -> None:
    result = CliRunner().invoke(compare, [CONFIG, *options])
    assert result.exit_code == 2
    assert said in result.stderr
    assert result.stderr.startswith("tel: ") and result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_a_missing_configuration_is_named() -> None:
    result = CliRunner().invoke(compare, ["nowhere.yaml"])
    assert result.exit_code == 2
    assert "nowhere.yaml" in result.stderr


def test_methods_come_in_the_order_of_the_table_however_they_are_named() -> None:
    assert [spec.name for spec in chosen(["exact_model", "no_learning"])] == ["no_learning", "exact_model"]
    assert [spec.name for spec in chosen([])] == list(METHODS)
    with pytest.raises(ConfigError, match="iterative_learning"):
        chosen(["nothing"])


def test_the_only_method_that_is_told_the_model_is_the_exact_one() -> None:
    assert [spec.name for spec in METHODS.values() if spec.given == "model"] == ["exact_model"]
    kinematics = [spec for spec in METHODS.values() if spec.given == "kinematics"]
    assert all("rigid_body" in spec.name for spec in kinematics)
    assert all(spec in kinematics for spec in METHODS.values() if "rigid_body" in " ".join(spec.settings))
