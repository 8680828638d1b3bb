"""The metadata of a trial's bag have every field, of the kind, that rosbag2 reads in version 9.

They are those that rosbag2's own ``rosbag2_storage/yaml.hpp`` takes out of ``metadata.yaml`` in version 8,
with the profiles of QoS as a list, which is what version 9 changed. One that is missing, or of another kind,
makes ``ros2 bag play`` end with an error.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

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
