"""Joints that come in messages of their own, of several publishers and topics, or under other names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from made_up_recording import made_up
from small_bags import STATES, joint_state, write_bag

from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.foreign.plausible import JointRange
from tel_ros.recording.foreign.recordings import Wanted, read_bag, read_sources
from tel_ros.recording.foreign.renaming import advice, renaming

RECORDING = made_up(4.0, 100.0).recording
SHOULDER, ELBOW = RECORDING.joints
N = len(RECORDING.time_s)
TIME_NS = np.round(1e9 * RECORDING.time_s).astype(np.int64) + 10**9
URDF = {joint: JointRange(-4.0, 4.0, 10.0) for joint in RECORDING.joints}

Row = tuple[str, str, int, bytes]


def rows(
    joints: Sequence[str],
    topic: str = "/joint_states",
    every: int = 1,
    shift_ns: int = 0,
    names: Sequence[str] = (),
    scale: float = 1.0,
) -> list[Row]:
    """Return messages of some joints of the recording, at other times if these are shifted."""
    found = []
    time_s = RECORDING.time_s + shift_ns / 1e9
    for k in range(0, N, every):
        columns = [RECORDING.joints.index(joint) for joint in joints]
        position, effort = (
            [float(np.interp(time_s[k], RECORDING.time_s, values[:, c])) for c in columns]
            for values in (RECORDING.position_rad, RECORDING.effort_nm)
        )
        moment_ns = int(TIME_NS[k]) + shift_ns
        raw = joint_state(moment_ns, names or joints, scale * np.array(position), effort)
        found.append((topic, STATES, moment_ns, raw))
    return found


def gripper(topic: str = "/joint_states", every_ns: int = 10**6) -> list[Row]:
    moments = range(int(TIME_NS[0]), int(TIME_NS[-1]), every_ns)
    return [
        (
            topic,
            STATES,
            moment,
            joint_state(moment, ["finger"], [0.02 + 1e-4 * (moment % 7)], [0.1 * (moment % 5)]),
        )
        for moment in moments
    ]


def bag(folder: Path, *of: list[Row]) -> Path:
    return write_bag(folder / "bag", sorted((row for each in of for row in each), key=lambda row: row[2]))


def assert_is_the_recording(found: Path, wanted: Wanted, atol: float) -> None:
    (recording,), _, _ = read_sources([found], wanted)
    assert set(recording.joints) == set(RECORDING.joints)
    recording = recording.of(RECORDING.joints)
    start_s = 0.01 * round(recording.time_s[0] / 0.01)
    assert len(recording.time_s) > 0.45 * N
    for values, truth in (
        (recording.position_rad, RECORDING.position_rad),
        (recording.effort_nm, RECORDING.effort_nm),
    ):
        first = np.argmin(np.abs(truth[: N // 2, 0] - values[0, 0])) if start_s == 0.0 else 0
        moments = recording.time_s + RECORDING.time_s[first]
        expected = np.column_stack([np.interp(moments, RECORDING.time_s, column) for column in truth.T])
        np.testing.assert_allclose(values, expected, atol=atol)


@pytest.mark.parametrize("wanted", [Wanted(), Wanted(urdf=URDF), Wanted(joints=(ELBOW, SHOULDER))])
def test_a_message_a_joint_with_the_same_stamp_is_merged_exactly(tmp_path: Path, wanted: Wanted) -> None:
    assert_is_the_recording(bag(tmp_path, rows([SHOULDER]), rows([ELBOW])), wanted, atol=1e-6)


def test_joints_at_other_times_and_rates_come_on_one_time_base(tmp_path: Path) -> None:
    mixed = bag(tmp_path, rows([SHOULDER], every=2), rows([ELBOW], shift_ns=3 * 10**6))
    (found,) = read_bag(mixed)
    assert len(found.time_s) == pytest.approx(N / 2, abs=2)
    assert_is_the_recording(mixed, Wanted(), atol=0.1)


def test_joints_on_topics_of_their_own_are_merged_where_the_urdf_or_the_user_names_them(
    tmp_path: Path,
) -> None:
    both = bag(tmp_path, rows([SHOULDER], "/shoulder/state"), rows([ELBOW], "/elbow/state"))
    assert_is_the_recording(both, Wanted(urdf=URDF), atol=1e-6)
    assert_is_the_recording(both, Wanted(joints=(SHOULDER, ELBOW)), atol=1e-6)
    with pytest.raises(InputFileError, match="one of them as --topic"):
        read_bag(both)


def test_a_time_without_one_of_the_joints_is_left_out(tmp_path: Path) -> None:
    gap = [row for k, row in enumerate(rows([ELBOW])) if not 100 <= k < 200]
    (found,) = read_bag(bag(tmp_path, rows([SHOULDER], shift_ns=10**6), gap))
    assert np.diff(found.time_s).max() == pytest.approx(1.01, abs=0.02)


@pytest.mark.parametrize("topic", ["/joint_states", "/gripper/joint_states"])
def test_a_faster_gripper_does_not_push_the_arm_aside(tmp_path: Path, topic: str) -> None:
    with_gripper = bag(tmp_path, rows([SHOULDER, ELBOW]), gripper(topic))
    assert_is_the_recording(with_gripper, Wanted(urdf=URDF), atol=1e-6)


def test_the_topic_with_most_joints_of_the_urdf_is_read(tmp_path: Path) -> None:
    two = bag(tmp_path, rows([SHOULDER, ELBOW], "/arm"), rows([ELBOW], "/elbow_again"))
    (found,) = read_bag(two, Wanted(urdf=URDF))
    assert found.source.endswith("/arm")


def test_joints_that_never_meet_are_refused(tmp_path: Path) -> None:
    apart = bag(tmp_path, rows([SHOULDER]), rows([ELBOW], shift_ns=10**12))
    with pytest.raises(InputFileError, match="never tells .* at about the same time"):
        read_bag(apart)


def test_a_joint_twice_in_a_message_is_refused(tmp_path: Path) -> None:
    twice = bag(tmp_path, rows([SHOULDER, ELBOW, ELBOW]))
    with pytest.raises(InputFileError, match="message 1 names elbow twice; expected each joint once"):
        read_bag(twice)


def test_another_publishers_zeros_are_called_that(tmp_path: Path) -> None:
    zeros = [
        (topic, kind, moment + 10**6, joint_state(moment + 10**6, [SHOULDER, ELBOW], [0, 0], [0, 0]))
        for topic, kind, moment, _ in rows([SHOULDER, ELBOW], every=3)
    ]
    mixed = bag(tmp_path, rows([SHOULDER, ELBOW]), zeros)
    with pytest.raises(InputFileError, match="is at 0 in 134 of 534 samples.*joint_state_publisher"):
        read_sources([mixed])


def test_zeros_of_a_publisher_without_efforts_do_not_matter(tmp_path: Path) -> None:
    zeros = [
        (topic, kind, moment + 10**6, joint_state(moment + 10**6, [SHOULDER, ELBOW], [0, 0]))
        for topic, kind, moment, _ in rows([SHOULDER, ELBOW], every=3)
    ]
    assert_is_the_recording(bag(tmp_path, rows([SHOULDER, ELBOW]), zeros), Wanted(), atol=1e-6)


def test_degrees_are_called_that(tmp_path: Path) -> None:
    found = bag(tmp_path, rows([SHOULDER, ELBOW], scale=180.0 / np.pi))
    with pytest.raises(
        InputFileError, match="has positions that are no rad .*expected rad: are they in degrees"
    ):
        read_sources([found], Wanted(urdf=URDF))


def test_speeds_beyond_the_urdfs_limit_are_refused_and_positions_outside_told(tmp_path: Path) -> None:
    found = bag(tmp_path, rows([SHOULDER, ELBOW]))
    slow = {joint: JointRange(-4.0, 4.0, 0.1) for joint in RECORDING.joints}
    with pytest.raises(
        InputFileError, match="rad/s, the URDF allows 0.1; expected positions in rad and times in s"
    ):
        read_sources([found], Wanted(urdf=slow))
    low, high = RECORDING.position_rad[:, 0].min(), RECORDING.position_rad[:, 0].max()
    elsewhere = URDF | {SHOULDER: JointRange(low - 3.0, 0.5 * (low + high), 10.0)}
    _, _, doubts = read_sources([found], Wanted(urdf=elsewhere))
    assert len(doubts) == 1
    assert "another arm, or another zero?" in doubts[0]
    assert read_sources([found], Wanted(urdf=URDF))[2] == []


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1e3, "in milliseconds"), (1e6, "in microseconds"), (1e9, "in nanoseconds"), (200.0, "have to be in s")],
)
def test_times_in_another_unit_are_called_that(tmp_path: Path, factor: float, said: str) -> None:
    file = tmp_path / "recording.csv"
    values = np.column_stack([factor * RECORDING.time_s, RECORDING.position_rad, RECORDING.effort_nm])
    header = f"time_s,q_{SHOULDER},q_{ELBOW},tau_{SHOULDER},tau_{ELBOW}"
    np.savetxt(file, values, delimiter=",", header=header, comments="")
    with pytest.raises(InputFileError, match=f"samples a second; expected 30 Hz to 1 kHz: .*{said}"):
        read_sources([file])


def test_joints_of_another_name_are_renamed_and_the_error_says_how(tmp_path: Path) -> None:
    found = bag(tmp_path, rows([SHOULDER, ELBOW], names=["fer_joint1", "fer_joint2"]))
    urdf = dict(zip(["panda_joint1", "panda_joint2", "panda_finger"], [URDF[SHOULDER]] * 3, strict=True))
    with pytest.raises(InputFileError, match=r"\(--rename fer_=panda_\?\)"):
        read_sources([found], Wanted(urdf=urdf))
    (recording,), _, _ = read_sources([found], Wanted(urdf=urdf, renaming=renaming(["fer_=panda_"])))
    assert recording.joints == ("panda_joint1", "panda_joint2")


def test_a_rule_is_a_prefix_or_a_name_and_its_advice_fits() -> None:
    rename = renaming(["fer_joint7=wrist", "fer_=panda_"])
    assert [rename(name) for name in ("fer_joint7", "fer_joint1", "elbow")] == [
        "wrist",
        "panda_joint1",
        "elbow",
    ]
    assert advice(["joint1", "joint2"], ["left_joint1", "left_joint2"]) == " (--rename =left_?)"
    assert advice(["left/joint1"], ["joint1", "joint2"]) == " (--rename left/=?)"
    assert advice(["alpha"], ["elbow"]) == ""
    for text in ("fer_", "a=b=c", "="):
        with pytest.raises(ConfigError, match="--rename is .*; expected FROM=TO"):
            renaming([text])
