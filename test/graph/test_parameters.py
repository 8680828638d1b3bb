"""The configuration as ROS parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from tel_process import PAPER

from tel_ros.core.errors import ConfigError, TelError
from tel_ros.nodes.arm_guard import ArmGuardNode
from tel_ros.nodes.parameters import load_parameters, on_set
from tel_ros.nodes.practice_manager import PracticeManagerNode
from tel_ros.recording.config_file import flat_values, load_config, with_values

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


def test_every_parameter_says_what_it_is_for_with_unit_and_range_or_choices(
    make_node: Callable[..., Node],
) -> None:
    node = make_node()
    config = load_parameters(node, *SECTIONS, "recording", "serve", "seed")
    about = {key: node.describe_parameter(key) for key in flat_values(config)}
    assert [k for k, each in about.items() if not (each.description and each.additional_constraints)] == []
    tolerance = about["control.path_tolerance_rad"]
    assert tolerance.description.endswith("[rad]")
    (limits,) = tolerance.floating_point_range
    assert (limits.from_value, limits.to_value) == (0.0, float("inf"))
    assert tolerance.additional_constraints == "a finite number above 0"
    (limits,) = about["control.realtime_priority"].integer_range
    assert (limits.from_value, limits.to_value) == (0, 98)
    assert about["recording.storage"].additional_constraints == "'mcap' or 'sqlite3'"


@pytest.mark.parametrize(
    ("name", "alike"),
    [
        ("control.corridor", "such as control.path_tolerance_rad"),
        ("control.path_tolerance", "such as control.path_tolerance_rad"),
        ("contrl.path_tolerance_rad", "such as control.path_tolerance_rad"),
        ("sim.xyz", "of sim: clock, physics_rate_hz"),
    ],
)
def test_an_unknown_parameter_is_refused_with_what_it_may_have_meant(
    make_node: Callable[..., Node], name: str, alike: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        load_parameters(make_node(**{name: 1.0}), *SECTIONS)
    said = f"parameter of practice_manager: {name} is 1.0; expected a known parameter"
    assert str(refusal.value).startswith(said)
    assert alike in str(refusal.value)


def test_parameters_of_other_nodes_and_of_ros_are_none_of_its_business(
    make_node: Callable[..., Node],
) -> None:
    others = {"sim.payload_kg": 0.5, "qos_overrides./rosout.publisher.depth": 5, "use_sim_time": False}
    config = load_parameters(make_node(**others), "control")
    assert config == load_config(PAPER)


def test_a_value_out_of_range_is_refused_in_the_words_of_the_configuration(
    make_node: Callable[..., Node],
) -> None:
    with pytest.raises(ConfigError) as refusal:
        load_parameters(make_node(control__path_tolerance_rad=-1.0), *SECTIONS)
    said = "control.path_tolerance_rad is -1.0; expected a finite number above 0"
    assert str(refusal.value) == f"parameter of practice_manager: {said}"


def test_a_parameter_of_the_version_before_still_works(make_node: Callable[..., Node]) -> None:
    node = make_node(**{"control.corridor_rad": 0.25})
    assert load_parameters(node, "control").control.path_tolerance_rad == 0.25
    assert node.get_parameter("control.path_tolerance_rad").value == 0.25


def test_a_shipped_configuration_goes_by_its_name_and_without_one_it_is_the_papers(
    make_node: Callable[..., Node],
) -> None:
    shipped = load_config(PAPER.with_name("planar_arm.yaml"))
    assert load_parameters(make_node(config="planar_arm"), *SECTIONS) == shipped
    bare = Node("ep_controller")
    try:
        assert load_parameters(bare, "control") == load_config(PAPER)
    finally:
        bare.destroy_node()


def test_a_node_takes_what_may_be_set_and_refuses_the_rest_with_the_reason(
    make_node: Callable[..., Node],
) -> None:
    node = make_node()
    keys = ("practice.trials",)
    config = load_parameters(node, *SECTIONS, settable=keys)
    taken: list[Any] = []

    def take(values: Mapping[str, Any]) -> None:
        taken.append(with_values(config, values, "ros2 param set").practice.trials)

    on_set(node, keys, take)
    results = node.set_parameters(
        [Parameter("practice.trials", value=3), Parameter("practice.parts", value=3)]
    )
    assert [each.successful for each in results] == [True, False]
    assert taken == [3]
    (result,) = node.set_parameters([Parameter("practice.trials", value=0)])
    assert not result.successful
    assert "practice.trials" in result.reason


def test_the_guard_starts_without_a_configuration_and_has_nothing_to_guard_in_lockstep(domain: int) -> None:
    rclpy.init()
    guard = ArmGuardNode()
    try:
        assert guard.busy_subscriptions == []
        assert guard.stopped
    finally:
        guard.destroy_node()
        rclpy.try_shutdown()


def test_how_a_run_ends_can_be_set_between_runs_and_not_while_one_is_under_way(domain: int) -> None:
    rclpy.init()
    manager = PracticeManagerNode()
    try:
        (taken,) = manager.set_parameters([Parameter("practice.trials", value=3)])
        assert taken.successful and manager._config.practice.trials == 3
        (too_fine,) = manager.set_parameters([Parameter("practice.tolerance_rad", value=1.0)])
        assert not too_fine.successful and "practice.step_tolerance_rad" in too_fine.reason
        manager._busy = True
        (late,) = manager.set_parameters([Parameter("practice.trials", value=4)])
        assert not late.successful and "a practice run is under way" in late.reason
        assert manager._config.practice.trials == 3
    finally:
        manager.destroy_node()
        rclpy.try_shutdown()
