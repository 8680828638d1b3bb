"""What holds for every command: JSON for scripts, one line for what goes wrong, names, completion."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from importlib import metadata
from importlib.metadata import EntryPoint
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tel_ros.app import bring_up, command_group, config_argument
from tel_ros.app.cli import COMMANDS, main
from tel_ros.app.command_group import CommandGroup
from tel_ros.core.errors import ConfigError
from tel_ros.recording.config_file import load_config
from tel_ros.recording.shared_files import shipped_configs

NO_RESULT_TO_PRINT = {"tel view", "tel replay", "tel bag plot", "tel stop", "tel reset", "tel serve"}
"""Commands that show something until they are stopped, write one file, or tell one thing to a controller."""


def commands(group: click.Group, name: str) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for key in group.list_commands(context):
        command = group.get_command(context, key)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, f"{name} {key}")
        else:
            yield f"{name} {key}", command


@pytest.mark.parametrize(("name", "command"), list(commands(main, "tel")))
def test_every_command_that_prints_a_result_prints_it_as_json_on_request(
    name: str, command: click.Command
) -> None:
    options = {option for parameter in command.params for option in parameter.opts}
    writes_files = name in NO_RESULT_TO_PRINT or name.startswith("tel study ")
    assert ("--json" in options) is not writes_files


@pytest.mark.parametrize(("name", "command"), list(commands(main, "tel")))
def test_every_command_is_named_in_the_help_that_teaches(name: str, command: click.Command) -> None:
    if name.split()[1] in COMMANDS:
        assert name in (main.help or "")
    assert command.help


def failing(error: Exception) -> click.Group:
    @click.group(cls=CommandGroup)
    def group() -> None:
        pass

    @group.command()
    def fail() -> None:
        raise error

    return group


@pytest.mark.parametrize(
    ("error", "code", "parts"),
    [
        (
            RuntimeError("the dog\n  ate it"),
            3,
            ["RuntimeError", "the dog ate it", "test_commands.py", "TEL_DEBUG"],
        ),
        (ConfigError("control.rate_hz", -1.0, "above 0"), 2, ["control.rate_hz", "-1.0", "above 0"]),
        (ModuleNotFoundError("", name="pybullet"), 3, ["pybullet", "tel_ros[sim]"]),
        (ModuleNotFoundError("", name="tel_interfaces.action"), 3, ["tel_interfaces", "make dist"]),
        (KeyboardInterrupt(), 130, ["interrupted"]),
    ],
)
def test_what_no_command_has_caught_ends_in_one_line(error: Exception, code: int, parts: list[str]) -> None:
    result = CliRunner().invoke(failing(error), ["fail"])
    assert result.exit_code == code
    assert result.stdout == ""
    assert len(result.stderr.strip().splitlines()) == 1
    for part in parts:
        assert part in result.stderr


@pytest.mark.parametrize("error", [RuntimeError("the dog ate it"), ConfigError("rate", -1, "above 0")])
def test_a_traceback_is_shown_to_those_who_ask_for_it(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TEL_DEBUG", "1")
    result = CliRunner().invoke(failing(error), ["fail"])
    assert "Traceback" in result.stderr
    assert "raise error" in result.stderr


def test_the_shipped_configurations_are_listed_and_can_all_be_read() -> None:
    result = CliRunner().invoke(main, ["configs", "--json"])
    assert result.exit_code == 0
    rows = {row["name"]: row for row in json.loads(result.stdout)}
    assert {"paper", "planar_arm", "real_arm"} <= set(rows)
    for row in rows.values():
        assert row["about"]
        if "package://" not in Path(row["file"]).read_text():
            load_config(row["file"])


def test_practice_without_the_simulator_says_what_to_install_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bring_up, "find_spec", lambda name: None)
    result = CliRunner().invoke(main, ["practice", "planar_arm", "--out", str(tmp_path / "run")])
    assert result.exit_code == 3
    assert "pip install 'tel_ros[sim]'" in result.stderr
    assert not (tmp_path / "run").exists()


def converted(value: str) -> Path:
    return config_argument.ConfigFile().convert(value, None, None)


def test_a_name_stands_for_a_shipped_configuration_in_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert converted("paper") == shipped_configs()["paper"]


def test_a_file_of_ones_own_comes_before_a_shipped_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("paper").write_text("mine")
    assert converted("paper") == Path("paper")


def test_a_name_that_stands_for_nothing_is_told_with_those_that_do() -> None:
    result = CliRunner().invoke(main, ["practice", "papper"])
    assert result.exit_code == 2
    assert "papper: there is no such file" in result.stderr
    assert "paper, planar_arm" in result.stderr


@pytest.mark.timeout(300)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_gets_a_completion_script(shell: str) -> None:
    assert "_TEL_COMPLETE" in complete(f"{shell}_source")


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("tel pra", "plain,practice"),
        ("tel practice plan", "plain,planar_arm"),
        ("tel sweep pap", "plain,paper"),
    ],
)
def test_commands_and_shipped_names_are_completed(typed: str, offered: str) -> None:
    words = {"COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    assert offered in complete("bash_complete", **words).splitlines()


def complete(instruction: str, **words: str) -> str:
    return CliRunner(env={"_TEL_COMPLETE": instruction, **words}).invoke(main, prog_name="tel").stdout


@pytest.fixture
def laboratory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package ``tel_lab`` in a checkout whose entry points have not been installed."""
    package = tmp_path / "tel_lab"
    package.mkdir()
    table = {"tel_ros.commands": {"greet": "tel_lab.greet:greet", "broken": "tel_lab.nowhere:command"}}
    (package / "__init__.py").write_text(f"ENTRY_POINTS = {table}")
    (package / "greet.py").write_text("import click\n@click.command()\ndef greet(): click.echo('hello')\n")
    for name in [name for name in sys.modules if name.split(".")[0] == "tel_lab"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    for name in [name for name in sys.modules if name.split(".")[0] == "tel_lab"]:
        del sys.modules[name]


@pytest.mark.usefixtures("laboratory")
def test_commands_of_the_laboratory_are_found_before_they_are_installed() -> None:
    assert CliRunner().invoke(main, ["greet"]).output == "hello\n"


@pytest.mark.usefixtures("laboratory")
def test_a_command_that_cannot_be_imported_spoils_no_other() -> None:
    assert "Cannot be loaded from tel_lab.nowhere" in " ".join(
        CliRunner().invoke(main, ["--help"]).output.split()
    )
    result = CliRunner().invoke(main, ["broken", "--option", "value"])
    assert (result.exit_code, result.stdout) == (3, "")
    assert "tel_lab.nowhere" in result.stderr


def test_without_the_laboratory_its_installed_commands_are_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint(name="greet", value="tel_lab.greet:greet", group="tel_ros.commands")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point])
    monkeypatch.setattr(command_group, "find_spec", lambda name: None)
    assert CliRunner().invoke(main, ["greet"]).exit_code == 2
    assert "greet" not in CliRunner().invoke(main, ["--help"]).output


def test_a_command_of_another_package_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint(name="theirs", value="tel_ros.app.config_argument:configs", group="tel_ros.commands")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point])
    assert CliRunner().invoke(main, ["theirs", "--json"]).exit_code == 0
