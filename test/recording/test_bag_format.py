"""Messages in the form that bags hold; and metadata with every field that rosbag2 reads in version 9.

They are those that rosbag2's own ``rosbag2_storage/yaml.hpp`` takes out of ``metadata.yaml`` in version 8,
with the profiles of QoS as a list, which is what version 9 changed. One that is missing, or of another kind,
makes ``ros2 bag play`` end with an error.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from tel_ros.recording.bag_format import to_cdr, typestore
from tel_ros.recording.trial_result import timing_fields

GOAL = "tel_interfaces/msg/TrialGoal"
RESULT = "tel_interfaces/msg/TrialResult"


def goal(**values: Any) -> SimpleNamespace:
    fields = {
        "trial": 3,
        "alpha": 0.5,
        "joint_names": ["shoulder", "elbow"],
        "time_ns": [0, 2_000_000],
        **dict.fromkeys(
            ("position_rad", "velocity_rad_s", "acceleration_rad_s2", "equilibrium_rad", "std_rad"),
            [0.1, 0.2, 0.3, 0.4],
        ),
        **dict.fromkeys(("stiffness_nm_per_rad", "damping_nms_per_rad"), [15.0, 1.5]),
    }
    return SimpleNamespace(**(fields | values))


@pytest.mark.parametrize(
    "empty",
    [
        (),
        ("std_rad",),
        ("stiffness_nm_per_rad", "damping_nms_per_rad"),
        ("std_rad", "stiffness_nm_per_rad", "damping_nms_per_rad"),
    ],
)
@pytest.mark.parametrize("names", [["a"], ["ab", "c"], ["shoulder", "elbow"]])
def test_a_goal_comes_back_as_it_was_whatever_is_empty_in_it(
    empty: tuple[str, ...], names: list[str]
) -> None:
    written = goal(joint_names=names, **dict.fromkeys(empty, []))
    read = typestore().deserialize_cdr(to_cdr(GOAL, written), GOAL)
    for key, value in vars(written).items():
        np.testing.assert_array_equal(getattr(read, key), value, err_msg=key)


def test_a_result_comes_back_with_its_stamps() -> None:
    stamps = {
        name: SimpleNamespace(sec=k, nanosec=10 * k)
        for k, name in enumerate(("start_stamp", "run_stamp", "end_stamp"), start=1)
    }
    numbers = {"index": 2, "outcome": 1, "alpha": 0.4, "duration_s": 6.0, "ticks": 7, "rms_error_rad": 0.1}
    more: dict[str, Any] = {
        "max_error_rad": 0.2,
        "saturated_ratio": 0.0,
        "message": "elbow is off",
        "joint_names": ["elbow"],
    }
    more |= timing_fields(None) | {"missed_ticks": 3, "timing_warning": "late"}
    arrays: dict[str, list[float]] = {"rms_error_per_joint_rad": [0.1], "max_effort_nm": []}
    written = SimpleNamespace(**stamps, **numbers, **more, **arrays)
    read = typestore().deserialize_cdr(to_cdr(RESULT, written), RESULT)
    for key, value in (numbers | more | arrays).items():
        np.testing.assert_array_equal(getattr(read, key), value, err_msg=key)
    for name, stamp in stamps.items():
        assert (getattr(read, name).sec, getattr(read, name).nanosec) == (stamp.sec, stamp.nanosec)


COUNT, TEXT = int, str
TIME = {"nanoseconds_since_epoch": COUNT}
DURATION = {"nanoseconds": COUNT}
TOPIC = {
    "message_count": COUNT,
    "topic_metadata": {
        "name": TEXT,
        "type": TEXT,
        "serialization_format": TEXT,
        "offered_qos_profiles": [{}],
        "type_description_hash": TEXT,
    },
}
FILE = {"path": TEXT, "starting_time": TIME, "duration": DURATION, "message_count": COUNT}
BAG = {
    "version": COUNT,
    "storage_identifier": TEXT,
    "duration": DURATION,
    "starting_time": TIME,
    "message_count": COUNT,
    "topics_with_message_count": [TOPIC],
    "relative_file_paths": [TEXT],
    "compression_format": TEXT,
    "compression_mode": TEXT,
    "files": [FILE],
    "custom_data": {},
    "ros_distro": TEXT,
}


def wrong(found: Any, expected: Any, where: str) -> list[str]:
    """Return where a value is not of the kind that is expected."""
    if isinstance(expected, dict):
        if not isinstance(found, dict):
            return [where]
        return [place for key in expected for place in wrong(found.get(key), expected[key], f"{where}.{key}")]
    if isinstance(expected, list):
        if not isinstance(found, list):
            return [where]
        return [place for item in found for place in wrong(item, expected[0], f"{where}[]")]
    right = isinstance(found, expected) and not isinstance(found, bool)
    return [] if right and (expected is str or found >= 0) else [where]


def test_rosbag2_finds_what_it_reads(trial_bag: Path) -> None:
    stored = yaml.safe_load((trial_bag / "metadata.yaml").read_text(encoding="utf-8"))
    information = stored["rosbag2_bagfile_information"]
    assert wrong(information, BAG, "") == []
    assert information["version"] == 9
    assert all(isinstance(text, str) for pair in information["custom_data"].items() for text in pair)
    topics = information["topics_with_message_count"]
    assert information["message_count"] == sum(topic["message_count"] for topic in topics)
    assert all(topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_") for topic in topics)
    for file in information["files"]:
        assert file["path"] in information["relative_file_paths"]
        assert (trial_bag / file["path"]).is_file()


def test_what_is_wrong_is_found() -> None:
    assert wrong({"nanoseconds": 1}, DURATION, "") == []
    assert wrong({"nanoseconds": -1}, DURATION, "") == [".nanoseconds"]
    assert wrong({}, DURATION, "") == [".nanoseconds"]
    assert wrong([{"path": 1}], [{"path": TEXT}], "files") == ["files[].path"]
    assert wrong("x", [TEXT], "paths") == ["paths"]
