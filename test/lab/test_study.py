"""Studies have the same options, keep the order of their tasks, and name what failed."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tel_lab.study import StudyOptions, study, study_command
from tel_lab.workers import Workforce
from tel_ros.core.errors import TelError


def divided(number: int) -> float:
    return 6 / number


@study(seeds=5)
def made_up(options: StudyOptions) -> None:
    """Do nothing."""
    click.echo(f"{options.seeds} {options.jobs} {options.quick} {options.out} {options.command}")
    options.write("arms.md", n_steps=3, summary="1 of 2 targets are met.", sections=["## One"])


def missing() -> None:
    import no_such_module  # noqa: F401


@study()
def of_a_missing_module(options: StudyOptions) -> None:
    """Need a module."""
    list(options.results(missing, {"only": ()}))


@pytest.mark.timeout(120)
def test_results_come_in_the_order_of_the_tasks_and_one_that_breaks_is_named() -> None:
    results = StudyOptions().results(divided, {f"by {n}": (n,) for n in (1, 3, 2, 0)})
    assert [next(results) for _ in range(3)] == [6.0, 2.0, 3.0]
    with pytest.raises(TelError, match="by 0: ZeroDivisionError"):
        next(results)


def test_results_that_are_ready_in_another_order_wait_for_their_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ready = iter([("third", 3), ("first", 1), ("second", 2)])
    monkeypatch.setattr(Workforce, "run", lambda self, function, tasks: (pair for pair in ready))
    assert list(StudyOptions(jobs=2).results(divided, {"first": (), "second": (), "third": ()})) == [1, 2, 3]


def test_a_page_says_the_command_that_makes_it_without_where_and_how_fast(tmp_path: Path) -> None:
    options = ["--seeds", "2", "--jobs", "2", "--set", "a.b=[1, 2]", "--out", str(tmp_path)]
    result = CliRunner().invoke(made_up, options)
    assert result.output.startswith(f"2 2 False {tmp_path} tel study made_up")
    assert "--set 'a.b=[1, 2]'" in result.output
    assert "--seeds 2" in result.output
    page = (tmp_path / "arms.md").read_text()
    assert "by `tel study made_up " in page
    assert "**1 of 2 targets are met.**\n" in page
    assert page.endswith("\n\n## One\n")


@pytest.mark.timeout(120)
def test_a_module_that_is_missing_in_a_task_is_named_and_ends_with_code_3() -> None:
    result = CliRunner().invoke(of_a_missing_module)
    assert result.exit_code == 3
    assert result.stderr == "tel: this needs the Python module no_such_module\n"


def test_a_quick_study_writes_nothing() -> None:
    assert "5 1 True None" in CliRunner().invoke(made_up, ["--quick"]).output


def test_an_unknown_case_is_named() -> None:
    with pytest.raises(click.UsageError, match="'heavy'; expected some of: light"):
        StudyOptions(only=("heavy",)).selected(["light"])


def test_a_seed_that_is_no_number_is_named() -> None:
    result = CliRunner().invoke(study_command, ["random_practice", "--only", "x"])
    assert (result.exit_code, "--only is 'x'; expected seeds" in result.stderr) == (2, True)


def test_every_study_can_be_loaded_and_says_what_it_does() -> None:
    context = click.Context(study_command)
    for name in study_command.list_commands(context):
        command = study_command.get_command(context, name)
        assert command is not None
        assert command.help
        assert "Cannot be loaded" not in command.help
