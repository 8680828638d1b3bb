"""Studies have the same options, keep the order of their tasks, and name what failed."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tel_lab.study import StudyOptions, study, study_command
from tel_lab.workers import Failure
from tel_ros.core.errors import TelError


def divided(number: int) -> float:
    if number == 3:
        raise TelError("three is not allowed")
    return 6 / number


@study(seeds=5)
def made_up(options: StudyOptions) -> None:
    """Do nothing."""
    click.echo(f"{options.seeds} {options.jobs} {options.quick} {options.out} {options.command}")
    options.write("page.md", "# Page")


@pytest.mark.timeout(120)
def test_results_come_in_the_order_of_the_tasks_and_expected_errors_are_results() -> None:
    found = list(StudyOptions(jobs=2).run(divided, {f"by {n}": (n,) for n in (1, 3, 2)}))
    assert found == [("by 1", 6.0), ("by 3", Failure("three is not allowed", True)), ("by 2", 3.0)]


@pytest.mark.timeout(120)
def test_a_task_that_breaks_is_named() -> None:
    with pytest.raises(TelError, match="by 0: ZeroDivisionError"):
        list(StudyOptions().results(divided, {"by 0": (0,)}))


def test_a_page_says_the_command_that_makes_it_without_where_and_how_fast(tmp_path: Path) -> None:
    options = ["--seeds", "2", "--jobs", "2", "--set", "a.b=[1, 2]", "--out", str(tmp_path)]
    result = CliRunner().invoke(made_up, options)
    assert result.output.startswith(f"2 2 False {tmp_path} tel study made_up")
    assert "--set 'a.b=[1, 2]'" in result.output
    assert "--seeds 2" in result.output
    assert (tmp_path / "page.md").read_text() == "# Page\n"


def test_a_quick_study_writes_nothing() -> None:
    assert "5 1 True None" in CliRunner().invoke(made_up, ["--quick"]).output


def test_an_unknown_case_is_named() -> None:
    with pytest.raises(click.UsageError, match="'heavy'; expected some of: light"):
        StudyOptions(only=("heavy",)).selected(["light"])


def test_every_study_can_be_loaded_and_says_what_it_does() -> None:
    context = click.Context(study_command)
    for name in study_command.list_commands(context):
        command = study_command.get_command(context, name)
        assert command is not None
        assert command.help
        assert "Cannot be loaded" not in command.help
