"""Imports go one way: app → nodes → recording → core, and only ``app`` knows the simulated arm."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tel_ros.recording import topics

ROOT = Path(__file__).parents[1]
CORE, RECORDING, NODES, APP = (ROOT / "tel_ros" / part for part in ("core", "recording", "nodes", "app"))
BRIDGE = ROOT / "sim_bridge"
BRIDGE_NODE = BRIDGE / "node.py"
LAB = ROOT / "tel_lab"
ARRAY_LIBRARIES = {"numpy", "scipy", "numba"}
RIGID_BODY = CORE / "learning" / "rigid_body.py"
ONE_THREAD = CORE / "learning" / "one_thread.py"
COMMAND_CHANNEL = NODES / "command_channel.py"
BAG_PLAYER = NODES / "bag_player.py"
"""Gets its topics from a bag; that none of them is one of commands is tested where they get their names."""
SAFETY_LAYER = CORE / "safety" / "layer.py"
TOPICS = RECORDING / "topics.py"
COMMAND_TOPICS = {"EFFORT_COMMANDS", "POSITION_COMMANDS"}
"""Names in ``topics`` of what moves an arm."""


def imported(source: str) -> set[str]:
    """Return the full names of all modules that a source imports, wherever in it.

    A name that is imported from a module may be a module itself: ``from tel_ros import nodes`` counts as
    ``tel_ros`` and ``tel_ros.nodes``. Relative imports keep their dots; the project uses absolute ones.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and _function(node) in ("import_module", "__import__"):
            names |= {a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)}
    return names


def _function(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def strings(source: str) -> set[str]:
    """Return the texts in a source that are not documentation."""
    tree = ast.parse(source)
    documentation = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documentation
    }


def is_inside(name: str, *packages: str) -> bool:
    """Return whether a module is one of these packages or in one of them."""
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def outside_core(source: str, *also: str) -> set[str]:
    allowed = (*(sys.stdlib_module_names | ARRAY_LIBRARIES), "tel_ros.core", *also)
    return {name for name in imported(source) if not is_inside(name, *allowed)}


def imported_at_once(source: str) -> set[str]:
    """Return what a source imports when it is itself imported: not what only its functions do."""
    tree = ast.parse(source)

    class WithoutFunctions(ast.NodeTransformer):
        def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:  # noqa: N802, the name of ast
            return ast.copy_location(ast.Pass(), node)

        visit_AsyncFunctionDef = visit_FunctionDef  # noqa: N815, the name of ast

    return imported(ast.unparse(WithoutFunctions().visit(tree)))


def forbidden(source: str, *packages: str) -> set[str]:
    relative = {name for name in imported(source) if name.startswith(".")}
    return relative | {name for name in imported(source) if is_inside(name, *packages)}


def sources(*places: Path, but: tuple[Path, ...] = ()) -> list[object]:
    """Return the source files in some places as parameters of a test."""
    found = [
        path for place in places for path in (sorted(place.rglob("*.py")) if place.is_dir() else [place])
    ]
    kept = [path for path in found if not any(path.is_relative_to(part) for part in but)]
    assert kept, f"nothing in {places}"
    return [pytest.param(path, id=path.relative_to(ROOT).as_posix()) for path in kept]


@pytest.mark.parametrize("path", sources(CORE, but=(RIGID_BODY, ONE_THREAD)))
def test_core_imports_only_array_libraries_and_the_standard_library(path: Path) -> None:
    assert outside_core(path.read_text(encoding="utf-8")) == set()


def test_rigid_links_alone_import_pinocchio_and_only_inside_a_function() -> None:
    """It is optional: without it everything but these learners has to work."""
    source = RIGID_BODY.read_text(encoding="utf-8")
    assert outside_core(source) == {"pinocchio"}
    assert not [name for name in imported_at_once(source) if is_inside(name, "pinocchio")]


def test_the_number_of_threads_is_set_with_threadpoolctl_in_one_module_alone() -> None:
    assert outside_core(ONE_THREAD.read_text(encoding="utf-8"), "threadpoolctl") == set()


@pytest.mark.parametrize("path", sources(RECORDING))
def test_recording_needs_no_ros_graph_and_nothing_above_it(path: Path) -> None:
    above = ("rclpy", "tel_interfaces", "tel_ros.nodes", "tel_ros.app", "sim_bridge")
    assert forbidden(path.read_text(encoding="utf-8"), *above) == set()


@pytest.mark.parametrize("path", sources(NODES))
def test_nodes_know_neither_the_simulated_arm_nor_the_command_line(path: Path) -> None:
    assert forbidden(path.read_text(encoding="utf-8"), "sim_bridge", "tel_ros.app") == set()


@pytest.mark.parametrize("path", sources(ROOT / "tel_ros", BRIDGE, LAB, but=(NODES, APP, BRIDGE_NODE)))
def test_only_nodes_the_command_line_and_the_bridges_node_import_rclpy(path: Path) -> None:
    assert forbidden(path.read_text(encoding="utf-8"), "rclpy") == set()


@pytest.mark.parametrize("path", sources(CORE, RECORDING, NODES, ROOT / "tel_ros" / "__init__.py"))
def test_only_the_command_line_names_the_simulated_arm(path: Path) -> None:
    assert not [text for text in strings(path.read_text(encoding="utf-8")) if "sim_bridge" in text]


@pytest.mark.parametrize("path", sources(BRIDGE, but=(BRIDGE_NODE,)))
def test_the_simulated_arm_apart_from_its_node_uses_only_the_core(path: Path) -> None:
    above = ("tel_ros.recording", "tel_ros.nodes", "tel_ros.app")
    assert forbidden(path.read_text(encoding="utf-8"), *above) == set()


@pytest.mark.parametrize("path", sources(ROOT / "tel_ros", BRIDGE))
def test_the_product_does_not_know_the_laboratory(path: Path) -> None:
    assert forbidden(path.read_text(encoding="utf-8"), "tel_lab") == set()


def publishers_of_commands(source: str) -> list[str]:
    """Return the calls that make a publisher of a command topic, or of a topic that cannot be told.

    A topic can be told if it is written as ``topics.NAME``, in a call or not.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call) or _function(node) not in PUBLISHERS:
            continue
        named = [*node.args, *(keyword.value for keyword in node.keywords)]
        parts = [part for argument in named for part in ast.walk(argument)]
        names = {a.attr for a in parts if isinstance(a, ast.Attribute) and _base(a) == "topics"}
        if not names or names & {*COMMAND_TOPICS, "COMMANDS"}:
            found.append(ast.unparse(node))
    return found


PUBLISHERS = {"create_publisher", "create_lifecycle_publisher", "Publisher", "LifecyclePublisher"}


def _base(attribute: ast.Attribute) -> str:
    return attribute.value.id if isinstance(attribute.value, ast.Name) else ""


@pytest.mark.parametrize("path", sources(ROOT / "tel_ros", BRIDGE, LAB, but=(COMMAND_CHANNEL,)))
def test_commands_leave_through_the_command_channel_alone(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert len(publishers_of_commands(source)) == (1 if path == BAG_PLAYER else 0)
    values = {getattr(topics, name) for name in COMMAND_TOPICS}
    assert path == TOPICS or not strings(source) & values


@pytest.mark.parametrize("path", sources(ROOT / "tel_ros", BRIDGE, LAB, but=(SAFETY_LAYER,)))
def test_efforts_are_permitted_by_the_safety_layer_alone(path: Path) -> None:
    """Nobody else says that an effort is permitted, or changes which one was."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    made = [ast.unparse(n) for n in ast.walk(tree) if isinstance(n, ast.Call) and _function(n) == "Permitted"]
    written = [
        ast.unparse(n)
        for n in ast.walk(tree)
        if isinstance(n, ast.Attribute) and n.attr == "last_nm" and not isinstance(n.ctx, ast.Load)
    ]
    assert made + written == []


def test_the_command_channel_is_where_commands_leave() -> None:
    assert len(publishers_of_commands(COMMAND_CHANNEL.read_text(encoding="utf-8"))) == 1


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
    assert bool(publishers_of_commands(source)) is found


@pytest.mark.parametrize(
    "source",
    [
        "import rclpy",
        "import os, yaml",
        "from tel_ros import nodes",
        "from tel_ros.recording import topics",
        "from tel_ros.core_helpers import x",
        "from . import errors",
        "from ..nodes import qos",
        "def late():\n    import pydantic",
        "import importlib\nimportlib.import_module('pybullet')",
        "if False:\n    from sim_bridge.arm import SimulatedArm",
    ],
)
def test_an_import_that_core_must_not_have_is_found(source: str) -> None:
    assert outside_core(source) != set()


@pytest.mark.parametrize(
    ("source", "at_once"),
    [
        ("import pinocchio", True),
        ("if True:\n    import pinocchio", True),
        ("try:\n    from pinocchio import Model\nexcept ImportError:\n    pass", True),
        ("class Arm:\n    import pinocchio", True),
        ("def late():\n    import pinocchio", False),
        ("class Arm:\n    def late(self):\n        from pinocchio import Model", False),
        ("async def late():\n    import pinocchio", False),
    ],
)
def test_what_is_imported_at_once_is_told_from_what_a_function_imports(source: str, at_once: bool) -> None:
    assert ("pinocchio" in imported_at_once(source + "\nimport math")) is at_once
    assert "math" in imported_at_once(source + "\nimport math")
    assert "pinocchio" in outside_core(source)


@pytest.mark.parametrize(
    "source",
    [
        "from sim_bridge import arm",
        "import sim_bridge.node as node",
        "def late():\n    from tel_ros.app.cli import main",
        "from tel_ros import app",
        "from ..app import cli",
        "__import__('sim_bridge')",
    ],
)
def test_an_import_that_nodes_must_not_have_is_found(source: str) -> None:
    assert forbidden(source, "sim_bridge", "tel_ros.app") != set()


def test_what_is_allowed_is_not_complained_about() -> None:
    source = (
        '"""Not sim_bridge."""\nimport math\nimport scipy.signal\nfrom tel_ros.core.types import FloatArray\n'
    )
    assert outside_core(source) == set()
    assert forbidden(source, "sim_bridge", "tel_ros.app") == set()
    assert strings(source) == set()
    assert strings("MODULE = 'sim_bridge.node'") == {"sim_bridge.node"}


@pytest.mark.parametrize(
    "module", ["tel_ros.app.cli", "tel_ros.nodes.ep_controller", "tel_ros.nodes.practice_manager"]
)
def test_what_does_not_learn_starts_without_the_libraries_that_learning_needs(module: str) -> None:
    heavy = "{'numba', 'scipy.signal', 'scipy.stats', 'matplotlib'} & set(sys.modules)"
    command = [sys.executable, "-c", f"import sys, {module}; print(*sorted({heavy}))"]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert loaded == []
