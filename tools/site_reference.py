"""Pages of the reference that are made from the code, so that they say what it does."""

import ast
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from tel_ros.core.config import Config, JointValues
from tel_ros.core.config_fields import Declared, declared

_CONFIGURATION = """\
# Configuration

A run is one YAML file; `tel configs` lists those that come along. Each key below can also be set by
`--set SECTION.KEY=VALUE`, and is a parameter of that name in the nodes that use it
([which ones](interfaces.md#parameters)), read-only apart from how a run ends (`practice.trials`,
`practice.tolerance_rad`, `practice.step_tolerance_rad`, `practice.on_abort`: between runs). Units are in the
names: rad, s, N·m. A key without a default has to be given.
"""
_INTERFACES = """\
# ROS interfaces

What the nodes speak. The arm's side is fixed by [the arm contract](../arm-contract.md).
"""


def configuration_page() -> str:
    """Return the keys of a configuration with types, defaults and meanings, section by section."""
    lines = [_CONFIGURATION]
    top = [field for field in dataclasses.fields(Config) if _record(field.name) is None]
    lines += ["## At the top\n", *_table(Config, top)]
    for field in dataclasses.fields(Config):
        if record := _record(field.name):
            about = " ".join((record.__doc__ or "").split("\n\n")[0].split())
            lines += [f"\n## {field.name}\n", f"{about}\n", *_table(record, dataclasses.fields(record))]
    return "\n".join(lines) + "\n"


def interfaces_page(root: Path) -> str:
    """Return topics, parameters of the nodes, and the definitions of messages, services and actions.

    Args:
        root: of the checkout.
    """
    lines = [_INTERFACES, "## Names\n", "| name | what |", "|---|---|"]
    lines += [
        f"| `{name}` | {_cell(about)} |" for name, about in _names(root / "tel_ros/recording/topics.py")
    ]
    lines += ["\n## Parameters\n"]
    lines += ["Each node has the parameter `config`, the file of the run, and from it:\n"]
    lines += ["| module | sections and keys |", "|---|---|"]
    for folder in ("tel_ros/nodes", "sim_bridge"):
        for file in sorted((root / folder).glob("*.py")):
            if sections := _parameter_sections(file):
                links = ", ".join(f"[`{s}`](configuration.md#{_anchor(s)})" for s in sections)
                lines.append(f"| `{file.relative_to(root)}` | {links} |")
    for kind, title in (("action", "Actions"), ("srv", "Services"), ("msg", "Messages")):
        lines.append(f"\n## {title}\n")
        for file in sorted((root / "interfaces" / kind).glob(f"*.{kind}")):
            lines += [
                f"### tel_interfaces/{kind}/{file.stem}\n",
                "```text",
                file.read_text().strip(),
                "```\n",
            ]
    return "\n".join(lines) + "\n"


def _anchor(section: str) -> str:
    return section if _record(section) else "at-the-top"


def _record(section: str) -> Any:
    """Return the record of a section; None if the key holds a single value."""
    hint = declared(Config)[section].hint
    return hint if dataclasses.is_dataclass(hint) else None


def _table(record: Any, fields: Any) -> Iterator[str]:
    yield "| key | type | default | meaning |"
    yield "|---|---|---|---|"
    for field in fields:
        about = declared(record)[field.name]
        yield f"| `{field.name}` | {_type(about)} | {_default(field)} | {_cell(about.doc)} |"


def _type(field: Declared) -> str:
    if get_origin(field.hint) is Literal:
        return " or ".join(f"`{choice}`" for choice in get_args(field.hint))
    if field.hint == JointValues and field.range:
        return f"{field.expected}, one for each joint"
    return "text, the name of a file" if field.file else field.expected


def _default(field: Any) -> str:
    if field.default_factory is not dataclasses.MISSING:
        return "none" if not field.default_factory() else f"`{field.default_factory()}`"
    if field.default is dataclasses.MISSING:
        return ""
    if field.default in ("", ()):
        return "none"
    value = list(field.default) if isinstance(field.default, tuple) else field.default
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _cell(text: str) -> str:
    """Return a docstring as one cell of a table in Markdown."""
    return " ".join(text.replace("``", "`").replace("|", "\\|").split())


def _names(file: Path) -> Iterator[tuple[str, str]]:
    """Yield each name that a module gives to a single text, with the text below it."""
    body = ast.parse(file.read_text()).body
    for statement, following in zip(body, [*body[1:], None], strict=True):
        if not (isinstance(statement, ast.Assign) and isinstance(statement.value, ast.Constant)):
            continue
        text = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
        yield str(statement.value.value), str(following.value.value) if text else ""


def _parameter_sections(file: Path) -> list[str]:
    """Return what a node declares as parameters: the arguments of its call of load_parameters."""
    return [
        argument.value
        for call in ast.walk(ast.parse(file.read_text()))
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "load_parameters"
        for argument in call.args[1:]
        if isinstance(argument, ast.Constant)
    ]
