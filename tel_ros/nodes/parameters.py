"""A node's parameters: the values of the configuration file, each to be overridden on its own.

Every node has a parameter ``config``: the file of the practice run, or the name of a shipped one (default:
the paper's protocol). The values in it become the defaults of the node's other parameters, which carry the
same names as the keys of the file: ``-p control.path_tolerance_rad:=0.5``. Descriptions, ranges and choices
are those that :mod:`tel_ros.core.config` declares. All are read-only, apart from what a node can change
between runs.
"""

from __future__ import annotations

import sys
from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from tel_ros.core.config import Config
from tel_ros.core.config_fields import Declared, declared
from tel_ros.core.errors import ConfigError, TelError
from tel_ros.nodes.robot_description import description_for
from tel_ros.recording.config_file import RENAMED, flat_values, load_config, with_values
from tel_ros.recording.shared_files import named_config

CONFIG = "config"
RESUME = "resume"


def load_parameters(node: Node, *sections: str, settable: Collection[str] = ()) -> Config:
    """Declare a node's parameters and return the configuration that they make; TelError if it is wrong.

    ``sections``: the parts of the configuration that it uses, e.g. ``control``, or single keys. ``settable``:
    dotted keys that are not read-only; see :func:`on_set`.
    """
    about_file = ParameterDescriptor(
        description="YAML file of a practice run, or a shipped one's name: defaults of the other parameters",
        read_only=True,
    )
    file = named_config(node.declare_parameter(CONFIG, "paper", about_file).value)
    config = load_config(file, description=partial(description_for, node))
    # rclpy has no public way to ask for these.
    given = {name: each.value for name, each in node._parameter_overrides.items()}
    source = f"parameter of {node.get_name()}"
    _refuse_unknown(given, flat_values(config), source)
    old_names = {RENAMED[name]: name for name in given if name in RENAMED and RENAMED[name] not in given}
    for key, old in old_names.items():
        if key.split(".")[0] in sections:
            node.get_logger().warning(f"{source}: {old} is called {key} now")
            config = with_values(config, {key: given[old]}, source)
    overridden = {}
    for key, default in flat_values(config).items():
        if key.split(".")[0] not in sections or key.startswith("arm.held."):
            continue
        try:
            value = _declare(node, key, default, read_only=key not in settable)
        except InvalidParameterTypeException as error:
            raise TelError(f"{source}: {error}") from None
        except InvalidParameterValueException:
            value = given[key]  # out of range: the configuration says it in its own words
        if value != default:
            overridden[key] = value
    return with_values(config, overridden, source) if overridden else config


def declare_resume(node: Node) -> Path | None:
    """Declare ``resume`` and return the folder of the run to go on with, that of ``config``; None: none."""
    what = "whether to go on with the run in whose folder the file of the parameter config lies"
    about = ParameterDescriptor(description=what, read_only=True)
    if not node.declare_parameter(RESUME, False, about).value:
        return None
    return Path(node.get_parameter(CONFIG).value).parent


def on_set(node: Node, keys: Collection[str], change: Callable[[Mapping[str, Any]], None]) -> None:
    """Let somebody set declared parameters while the node runs.

    ``change`` is called with the new values before they are taken; it raises a TelError to refuse them.
    """

    def consider(parameters: Sequence[Parameter]) -> SetParametersResult:
        values = {each.name: each.value for each in parameters if each.name in keys}
        try:
            if values:
                change(values)
        except TelError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(consider)


def _refuse_unknown(given: Mapping[str, Any], known: Mapping[str, Any], source: str) -> None:
    """Refuse parameters in our sections that do not exist, and others that look like ours.

    Those of other nodes, which one file of parameters may hold as well, are known.
    """
    names = {**dict.fromkeys((CONFIG, RESUME, *known)), **RENAMED}
    for name, value in given.items():
        if name in names:
            continue
        section = name.split(".")[0]
        if alike := get_close_matches(name, names, cutoff=0.75):
            expected = " or ".join(dict.fromkeys(names[each] or each for each in alike))
            raise ConfigError(name, value, f"a known parameter, such as {expected}", source)
        if section in declared(Config) and "." in name:
            keys = ", ".join(key.split(".")[1] for key in known if key.startswith(f"{section}."))
            raise ConfigError(name, value, f"a known parameter of {section}: {keys}", source)


def _declare(node: Node, key: str, default: Any, *, read_only: bool) -> Any:
    """Declare a parameter and return its value."""
    about = _descriptor(key, read_only)
    if default != []:
        value = node.declare_parameter(key, default, about).value
        return list(value) if isinstance(value, array) else value
    # rclpy cannot tell the type of an empty list. Declared by type alone the parameter would have no value,
    # and one without makes rclpy's service give none of a node's values (``ros2 param dump``): so it is set,
    # and only then made read-only.
    kind = Parameter.Type.STRING_ARRAY if "str" in str(_field(key).hint) else Parameter.Type.DOUBLE_ARRAY
    value = node.declare_parameter(key, kind, ParameterDescriptor(description=about.description)).value
    if value is None:
        node.set_parameters([Parameter(key, kind, [])])
    about.type = kind.value
    node.set_descriptor(key, about)
    return list(value) if value is not None else []


def _descriptor(key: str, read_only: bool) -> ParameterDescriptor:
    field = _field(key)
    about = ParameterDescriptor(
        description=f"{field.doc} [{field.unit}]" if field.unit else field.doc,
        additional_constraints=field.expected,
        read_only=read_only,
    )
    limits = field.range
    if limits and field.hint is float:
        # Inclusive; the constraints above tell where an end is excluded, and the configuration refuses it.
        about.floating_point_range = [FloatingPointRange(from_value=limits.low, to_value=limits.high)]
    if limits and field.hint is int:
        high = int(min(limits.high, sys.maxsize))
        about.integer_range = [IntegerRange(from_value=int(limits.low), to_value=high, step=1)]
    return about


def _field(key: str) -> Declared:
    section, _, name = key.rpartition(".")
    return declared(declared(Config)[section].hint if section else Config)[name]
