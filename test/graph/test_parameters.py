"""The configuration as ROS parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from graph_harness import PAPER
from rclpy.node import Node
from rclpy.parameter import Parameter

from tel_ros.core.errors import TelError
from tel_ros.nodes.parameters import load_parameters
from tel_ros.recording.config_file import flat_values, load_config

SECTIONS = ("arm", "path", "run", "practice", "learning", "control", "safety", "sim")


@pytest.fixture
def make_node(domain: int) -> Iterator[Callable[..., Node]]:
    """Return a function that makes a node with values for parameters."""
    rclpy.init()
    nodes: list[Node] = []

    def make(**given: Any) -> Node:
        values = {"config": str(PAPER), **{key.replace("__", "."): value for key, value in given.items()}}
        overrides = [Parameter(key, value=value) for key, value in values.items()]
        nodes.append(Node("practice_manager", parameter_overrides=overrides))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def test_every_value_can_be_read_back_empty_lists_as_well(make_node: Callable[..., Node]) -> None:
    node = make_node()
    assert load_parameters(node, *SECTIONS) == load_config(PAPER)
    wanted = {key: v for key, v in flat_values(load_config(PAPER)).items() if key.split(".")[0] in SECTIONS}
    assert [] in wanted.values()
    found = node.get_parameters(list(wanted))
    assert {p.name: list(p.value) if isinstance(wanted[p.name], list) else p.value for p in found} == wanted
    assert all(p.type_ != Parameter.Type.NOT_SET for p in found)
    assert all(node.describe_parameter(key).read_only for key in wanted)


def test_lists_that_are_empty_by_default_can_be_given(make_node: Callable[..., Node]) -> None:
    config = load_parameters(make_node(practice__durations_s=[9.0, 4.5], practice__vary=["speed"]), *SECTIONS)
    assert config.practice.durations_s == (9.0, 4.5)


@pytest.mark.parametrize(
    "given",
    [{"control__path_tolerance_rad": 1}, {"practice__durations_s": [10, 5]}, {"practice__vary": "speed"}],
)
def test_a_value_of_the_wrong_type_is_refused_with_the_name_of_the_parameter(
    make_node: Callable[..., Node], given: dict[str, Any]
) -> None:
    (key,) = given
    with pytest.raises(TelError, match=key.replace("__", r"\.")):
        load_parameters(make_node(**given), *SECTIONS)
