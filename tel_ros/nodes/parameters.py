"""A node's parameters: the values of the configuration file, each to be overridden on its own.

Every node has a parameter ``config``, the file of the practice run (default: the paper's protocol). The
values in it become the defaults of the node's other parameters, which carry the same names as the keys of
the file: ``-p control.corridor_rad:=0.5``. All are read-only: a run is one configuration.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
from array import array
from functools import cache
from typing import Any, get_type_hints

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from tel_ros.core import config as records
from tel_ros.core.config import Config
from tel_ros.recording.config_file import default_config_file, flat_values, load_config, with_values


def load_parameters(node: Node, *sections: str) -> Config:
    """Declare a node's parameters and return the configuration that they make.

    Args:
        node: the node.
        sections: the parts of the configuration that it uses, e.g. ``control``, or single keys.

    Raises:
        InputFileError: the configuration file, or one that it names, cannot be used.
        ConfigError: a value is wrong.
    """
    about_file = ParameterDescriptor(
        description="YAML file of the practice run; its values are the defaults of the other parameters",
        read_only=True,
    )
    file = node.declare_parameter("config", str(default_config_file()), about_file).value
    config = load_config(file)
    overridden = {}
    for key, default in flat_values(config).items():
        if key.split(".")[0] not in sections:
            continue
        descriptor = ParameterDescriptor(description=_description(key), read_only=True)
        value = node.declare_parameter(key, _typed(key, default), descriptor).value
        value = list(value) if isinstance(value, array) else value
        if value is not None and value != default:
            overridden[key] = value
    return with_values(config, overridden, f"parameter of {node.get_name()}") if overridden else config


def _typed(key: str, value: Any) -> Any:
    """Return a value, or for an empty list its type: rclpy could not tell, and has no empty defaults."""
    if value == []:
        section, name = key.split(".")
        hint = get_type_hints(get_type_hints(Config)[section])[name]
        return Parameter.Type.STRING_ARRAY if "str" in str(hint) else Parameter.Type.DOUBLE_ARRAY
    return value


@cache
def _field_docs(record: type) -> dict[str, str]:
    """Return the text below each field of a record: the one place where a value is explained."""
    body = ast.parse(inspect.getsource(record)).body[0].body  # type: ignore[attr-defined]
    docs = {}
    for field, text in zip(body, body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            docs[ast.unparse(field.target)] = " ".join(str(ast.literal_eval(text.value)).split())
    return docs


def _description(key: str) -> str:
    section, _, name = key.rpartition(".")
    record = get_type_hints(Config)[section] if section else records.Config
    if not dataclasses.is_dataclass(record):
        return ""
    return _field_docs(record).get(name, "")  # type: ignore[arg-type]
