"""What `make setup` builds where there is no control_msgs: to others on the network it is the real one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tel_ros.recording.shared_files import share_folder

DEFINITIONS = Path(__file__).parent.parent / "interfaces" / "control_msgs"

# Computed from the definitions of control_msgs 5.8.0, of its branch jazzy.
MESSAGES = {
    "msg/JointTolerance": "RIHS01_c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648",
    "msg/JointComponentTolerance": "RIHS01_739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4",
    "msg/JointTrajectoryControllerState": (
        "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480"
    ),
}
PARTS = {
    "Goal": "RIHS01_8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205",
    "Result": "RIHS01_8002e99ed2c14c6faa522f2a93c26d744c5982f254f9e98ff9c6f19789bdb220",
    "Feedback": "RIHS01_3fd0aaecf71725121ae1ff7f01098a5e0da581e672be18a6b2c286cb43d96b49",
}


def test_our_definitions_have_the_type_hashes_of_the_real_ones() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in MESSAGES:
        store.register(get_types_from_msg((DEFINITIONS / f"{name}.msg").read_text(), f"control_msgs/{name}"))
    assert {name: store.hash_rihs01(f"control_msgs/{name}") for name in MESSAGES} == MESSAGES
    action = (DEFINITIONS / "action" / "FollowJointTrajectory.action").read_text().split("\n---\n")
    hashes = {}
    for part, text in zip(PARTS, action, strict=True):
        kind = f"control_msgs/action/FollowJointTrajectory_{part}"
        whole = text.replace("\nJoint", "\ncontrol_msgs/msg/Joint")
        store.register(get_types_from_msg(whole, kind))
        hashes[part] = store.hash_rihs01(kind)
    assert hashes == PARTS


def test_the_installed_action_has_the_type_hash_and_the_codes_of_the_real_one() -> None:
    actions = pytest.importorskip("control_msgs.action")
    folder = share_folder("control_msgs") / "action"
    described = json.loads((folder / "FollowJointTrajectory.json").read_text())
    found = {each["type_name"]: each["hash_string"] for each in described["type_hashes"]}
    kind = "control_msgs/action/FollowJointTrajectory"
    assert {part: found[f"{kind}_{part}"] for part in PARTS} == PARTS
    assert found[kind] == "RIHS01_738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6"
    result = actions.FollowJointTrajectory.Result
    codes = result.SUCCESSFUL, result.INVALID_GOAL, result.INVALID_JOINTS, result.OLD_HEADER_TIMESTAMP
    assert codes == (0, -1, -2, -3)
    assert (result.PATH_TOLERANCE_VIOLATED, result.GOAL_TOLERANCE_VIOLATED) == (-4, -5)
