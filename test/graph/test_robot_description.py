"""An arm whose configuration names no URDF: its description comes from the latched topic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import String
from tel_process import PAPER, QUICK, TelProcess, summary_of

from tel_ros.core.errors import ConfigError, TelError
from tel_ros.nodes import qos, robot_description
from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config
from tel_ros.recording.provenance import stored_urdf
from tel_ros.recording.run_folder import trial_bags
from tel_ros.recording.trial_bag import read_trial

NO_FILE = "arm.urdf=''"


@pytest.fixture
def described(domain: int) -> Iterator[str]:
    """Publish the description of the paper's arm in a namespace, as robot_state_publisher does."""
    text = Path(load_config(PAPER).arm.urdf).read_text()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    publisher = Node("somebody", namespace="left", context=context)
    publisher.create_publisher(String, topics.ROBOT_DESCRIPTION, qos.LATCHED).publish(String(data=text))
    yield text
    publisher.destroy_node()
    context.try_shutdown()


def test_practice_takes_the_description_from_the_topic_and_stores_it_like_a_file(
    described: str, tel: Callable[..., TelProcess]
) -> None:
    run = tel(*QUICK, "practice.trials=1", NO_FILE, more=("--namespace", "left"))
    code, out, err = run.finish()
    assert code == 0, err
    assert summary_of(out)["outcome"] == "completed"
    assert (run.folder / "robot_description.urdf").read_text() == described
    (bag,) = trial_bags(run.folder)
    assert stored_urdf(bag, read_trial(bag).metadata).decode() == described


def test_a_node_waits_for_the_description_under_its_own_names(described: str) -> None:
    rclpy.init()
    node = Node("controller", namespace="left")
    try:
        assert robot_description.description_for(node).read_text() == described
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_without_a_description_one_line_says_what_is_missing(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_description, "TIMEOUT_S", 0.3)
    with pytest.raises(TelError, match="no robot description on /right/robot_description within 0.3 s"):
        robot_description.description_in("/right")
    with pytest.raises(ConfigError, match=r"arm\.urdf is ''; expected a URDF file"):
        load_config(PAPER, [NO_FILE])
