"""A node's parameters: the values of the configuration file, each to be overridden on its own.

Every node has a parameter ``config``, the file of the practice run (default: the paper's protocol). The
values in it become the defaults of the node's other parameters, which carry the same names as the keys of
the file: ``-p control.path_tolerance_rad:=0.5``. All are read-only: a run is one configuration.
"""

from __future__ import annotations

import dataclasses
from array import array
from typing import Any, get_type_hints

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter

from tel_ros.core import config as records
from tel_ros.core.config import Config
from tel_ros.core.config_docs import field_docs
from tel_ros.core.errors import TelError
from tel_ros.recording.config_file import default_config_file, flat_values, load_config, with_values


def load_parameters(node: Node, *sections: str) -> Config:
    """Declare a node's parameters and return the configuration that they make.

    Args:
        node: the node.
        sections: the parts of the configuration that it uses, e.g. ``control``, or single keys.

    Raises:
        InputFileError: the configuration file, or one that it names, cannot be used.
        ConfigError: a value is wrong.
        TelError: a value has the wrong type, e.g. 1 instead of 1.0.
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
        value = _declare(node, key, default)
        if value != default:
            overridden[key] = value
    return with_values(config, overridden, f"parameter of {node.get_name()}") if overridden else config


def _declare(node: Node, key: str, default: Any) -> Any:
    """Declare a parameter and return its value.

    Raises:
        TelError: the value that was given for it has another type.
    """
    about = ParameterDescriptor(description=_description(key), read_only=True)
    try:
        if default == []:
            return _declare_empty(node, key, about)
        value = node.declare_parameter(key, default, about).value
    except InvalidParameterTypeException as error:
        raise TelError(f"parameter of {node.get_name()}: {error}") from None
    return list(value) if isinstance(value, array) else value


def _declare_empty(node: Node, key: str, about: ParameterDescriptor) -> list[Any]:
    """Declare a parameter whose default is an empty list, and return its value.

    rclpy cannot tell the type of an empty list. Declared by type alone the parameter would have no value, and
    one without makes rclpy's service give none of a node's values (``ros2 param dump``). So it is
    set before it becomes read-only.
    """
    kind = _array_type(key)
    value = node.declare_parameter(key, kind, ParameterDescriptor(description=about.description)).value
    if value is None:
        node.set_parameters([Parameter(key, kind, [])])
    about.type = kind.value
    node.set_descriptor(key, about)
    return list(value) if value is not None else []


def _array_type(key: str) -> Parameter.Type:
    section, name = key.split(".")
    hint = get_type_hints(get_type_hints(Config)[section])[name]
    return Parameter.Type.STRING_ARRAY if "str" in str(hint) else Parameter.Type.DOUBLE_ARRAY


def _description(key: str) -> str:
    section, _, name = key.rpartition(".")
    record = get_type_hints(Config)[section] if section else records.Config
    if not dataclasses.is_dataclass(record):
        return ""
    return field_docs(record).get(name, "")  # type: ignore[arg-type]
