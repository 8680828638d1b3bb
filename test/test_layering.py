"""Imports go one way, and so do commands: out through the command channel alone, behind the safety layer.

The contracts about imports are in pyproject.toml; here are the rules that import-linter cannot say.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tel_ros.recording import topics

ROOT = Path(__file__).parents[1]
PACKAGES = [ROOT / name for name in ("tel_ros", "sim_bridge", "tel_lab")]
CORE, RECORDING, NODES = (ROOT / "tel_ros" / part for part in ("core", "recording", "nodes"))
ARRAY_LIBRARIES = {"numpy", "scipy", "numba"}
ALSO_IN_CORE = {
    CORE / "learning" / "rigid_body.py": {"pinocchio"},
    CORE / "learning" / "least_squares.py": {"threadpoolctl"},
}
"""The two modules of the core that need another library, and which."""
COMMAND_CHANNEL = NODES / "command_channel.py"
BAG_PLAYER = NODES / "bag_player.py"
"""Gets its topics from a bag; that none of them is one of commands is tested where they get their names."""
SAFETY_LAYER = CORE / "safety" / "layer.py"
TOPICS = RECORDING / "topics.py"
COMMAND_TOPICS = {"EFFORT_COMMANDS", "POSITION_COMMANDS"}
"""Names in ``topics`` of what moves an arm."""
PUBLISHERS = {"create_publisher", "create_lifecycle_publisher", "Publisher", "LifecyclePublisher"}


def offences(find: Callable[[ast.Module], set[str]], *places: Path, but: tuple[Path, ...] = ()) -> list[str]:
    """Return what is found in the sources in some places, as ``file: what``."""
    files = [path for place in places for path in sorted(place.rglob("*.py")) if path not in but]
    assert len(files) > 10
    return [f"{path.relative_to(ROOT)}: {text}" for path in files for text in sorted(find(parsed(path)))]


@cache
def parsed(path: Path) -> ast.Module:
    """Return the source of a file, which several rules look at."""
    return ast.parse(path.read_text())


def imported(tree: ast.AST) -> set[str]:
    """Return the names of all modules that a source imports, anywhere; relative ones keep their dots."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level + (node.module or ""))
        elif isinstance(node, ast.Call) and _function(node) in ("import_module", "__import__"):
            names |= {a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)}
    return names


def imported_at_once(tree: ast.Module) -> set[str]:
    """Return what a source imports when it is itself imported: not what only its functions do."""

    class WithoutFunctions(ast.NodeTransformer):
        def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:  # noqa: N802, the name of ast
            return ast.copy_location(ast.Pass(), node)

        visit_AsyncFunctionDef = visit_FunctionDef  # noqa: N815, the name of ast

    return imported(WithoutFunctions().visit(tree))


def outside_core(tree: ast.AST) -> set[str]:
    """Return what is neither of the standard library, nor of the array libraries, nor of the core."""
    allowed = sys.stdlib_module_names | ARRAY_LIBRARIES
    names = {name for name in imported(tree) if name.split(".")[0] not in allowed}
    return {name for name in names if not f"{name}.".startswith("tel_ros.core.")}


def strings(tree: ast.Module) -> set[str]:
    """Return the texts in a source that are not documentation."""
    documentation = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation
    }


def publishers_of_commands(tree: ast.AST) -> set[str]:
    """Return calls that make a publisher of a command topic, or of a topic not written as ``topics.NAME``."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _function(node) in PUBLISHERS:
            named = [*node.args, *(keyword.value for keyword in node.keywords)]
            parts = [part for argument in named for part in ast.walk(argument)]  # also topics.private(…)
            names = {a.attr for a in parts if isinstance(a, ast.Attribute) and _base(a) == "topics"}
            if not names or names & {*COMMAND_TOPICS, "COMMANDS"}:
                found.add(ast.unparse(node))
    return found


def grants(tree: ast.AST) -> set[str]:
    """Return where a source says that an effort is permitted, or changes which one was."""
    made = {ast.unparse(n) for n in ast.walk(tree) if isinstance(n, ast.Call) and _function(n) == "Permitted"}
    return made | {
        ast.unparse(n)
        for n in ast.walk(tree)
        if isinstance(n, ast.Attribute) and n.attr == "last_nm" and not isinstance(n.ctx, ast.Load)
    }


def timers_on_ros_time(tree: ast.AST) -> set[str]:
    """Return calls that make a timer on a node's own clock, which stands still if nobody publishes time."""
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call) and _function(n) == "create_timer"]
    return {ast.unparse(n) for n in calls if not any(keyword.arg == "clock" for keyword in n.keywords)}


def _function(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _base(attribute: ast.Attribute) -> str:
    return attribute.value.id if isinstance(attribute.value, ast.Name) else ""


def test_imports_keep_the_contracts_of_pyproject_toml() -> None:
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports as l; exit(l(no_cache=True))"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_core_imports_only_array_libraries_and_the_standard_library() -> None:
    assert offences(outside_core, CORE, but=tuple(ALSO_IN_CORE)) == []
    assert {path: outside_core(parsed(path)) for path in ALSO_IN_CORE} == ALSO_IN_CORE


def test_pinocchio_is_imported_only_inside_a_function() -> None:
    """It is optional: without it everything but the learners of rigid links has to work."""
    for path in ALSO_IN_CORE:
        assert "pinocchio" not in imported_at_once(parsed(path))


def test_only_the_command_line_names_the_simulated_arm() -> None:
    def named(tree: ast.Module) -> set[str]:
        return {text for text in strings(tree) if "sim_bridge" in text}

    assert offences(named, CORE, RECORDING, NODES) == []


def test_timers_run_on_the_steady_clock() -> None:
    assert offences(timers_on_ros_time, *PACKAGES[:2]) == []


def test_commands_leave_through_the_command_channel_alone() -> None:
    values = {getattr(topics, name) for name in COMMAND_TOPICS}
    # The laboratory's studies play both sides, on domains of their own.
    assert offences(publishers_of_commands, *PACKAGES[:2], but=(COMMAND_CHANNEL, BAG_PLAYER)) == []
    assert offences(lambda tree: strings(tree) & values, *PACKAGES, but=(TOPICS,)) == []
    for path in (COMMAND_CHANNEL, BAG_PLAYER):
        assert len(publishers_of_commands(parsed(path))) == 1


def test_efforts_are_permitted_by_the_safety_layer_alone() -> None:
    assert offences(grants, *PACKAGES, but=(SAFETY_LAYER,)) == []
    assert grants(parsed(SAFETY_LAYER)) != set()


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("self.create_publisher(Float64MultiArray, topics.EFFORT_COMMANDS, 1)", True),
        ("node.create_publisher(msg_type=Float64MultiArray, topic=topics.EFFORT_COMMANDS)", True),
        ("self.create_lifecycle_publisher(Float64MultiArray, topics.EFFORT_COMMANDS, 1)", True),
        ("Publisher(handle, Float64MultiArray, topics.EFFORT_COMMANDS)", True),
        ("self.create_publisher(Float64MultiArray, topics.COMMANDS[interface], 1)", True),
        ("for topic in names:\n    node.create_publisher(kind, topic, 1)", True),
        ("node.create_publisher(kind, '/effort_' + 'controller/commands', 1)", True),
        ("self.create_publisher(Float64MultiArray, topics.private(topics.EFFORT_COMMANDS), 1)", True),
        ("self.create_publisher(Bool, topics.READY, qos.LATCHED)", False),
        ("self.create_publisher(Bool, topics.private(topics.READY), qos.LATCHED)", False),
        ("self.create_subscription(Float64MultiArray, topics.EFFORT_COMMANDS, hear, 1)", False),
    ],
)
def test_a_publisher_of_commands_is_found(source: str, found: bool) -> None:
    assert bool(publishers_of_commands(ast.parse(source))) is found


def test_what_the_core_must_not_import_is_found_wherever_it_hides() -> None:
    for source in (
        "import os, yaml",
        "from tel_ros.recording import topics",
        "from tel_ros.core_helpers import x",
        "from . import errors",
        "def late():\n    import yaml",
        "import importlib\nimportlib.import_module('pybullet')",
    ):
        assert outside_core(ast.parse(source)) != set(), source
    allowed = (
        "import math\nimport scipy.signal\nfrom tel_ros.core.types import FloatArray\n'not sim_bridge'\n"
    )
    assert outside_core(ast.parse(allowed)) == set()
    assert strings(ast.parse(allowed)) == set()
    assert strings(ast.parse("MODULE = 'sim_bridge.node'")) == {"sim_bridge.node"}


def test_what_is_imported_at_once_is_told_from_what_a_function_imports() -> None:
    for source in (
        "try:\n    from pinocchio import Model\nexcept ImportError:\n    pass",
        "class A:\n    import pinocchio",
    ):
        assert "pinocchio" in imported_at_once(ast.parse(source)), source
    for source in (
        "class A:\n    def late(self):\n        import pinocchio",
        "async def late():\n    import pinocchio",
    ):
        assert imported_at_once(ast.parse(source)) == set(), source


@pytest.mark.parametrize(
    "module", ["tel_ros.app.cli", "tel_ros.nodes.ep_controller", "tel_ros.nodes.practice_manager"]
)
def test_what_does_not_learn_starts_without_the_libraries_that_learning_needs(module: str) -> None:
    heavy = "{'numba', 'scipy.linalg', 'scipy.signal', 'scipy.stats', 'matplotlib'} & set(sys.modules)"
    command = [sys.executable, "-c", f"import sys, {module}; print(*sorted({heavy}))"]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert loaded == []
