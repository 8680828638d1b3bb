"""Joint states as arrays, from bags of whatever arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_bags import SQLITE3, STATES, TEXT, joint_state, text, write_bag

from tel_ros.core.errors import BagError
from tel_ros.recording.joint_states import read_joint_states

ROWS = [
    ("/s", STATES, 100, joint_state(1_000_000_000, ["a", "b"], [1.0, 2.0], [0.1, 0.2])),
    ("/s", STATES, 200, joint_state(1_500_000_000, ["b", "a"], [4.0, 3.0], [0.4, 0.3])),
    ("/s", STATES, 300, joint_state(2_500_000_000, ["b"], [5.0])),
    ("/note", TEXT, 300, text("x")),
]


def test_values_follow_their_names_and_what_is_not_told_is_nan(tmp_path: Path) -> None:
    found = read_joint_states(write_bag(tmp_path / "bag", ROWS, SQLITE3))
    assert (found.topic, found.joints) == ("/s", ("a", "b"))
    np.testing.assert_array_equal(found.position_rad, [[1.0, 2.0], [3.0, 4.0], [np.nan, 5.0]])
    np.testing.assert_array_equal(found.effort_nm, [[0.1, 0.2], [0.3, 0.4], [np.nan, np.nan]])
    assert np.isnan(found.velocity_rad_s).all()


def test_time_is_that_of_the_headers_unless_they_do_not_go_forward(tmp_path: Path) -> None:
    found = read_joint_states(write_bag(tmp_path / "bag", ROWS))
    np.testing.assert_allclose(found.time_s, [0.0, 0.5, 1.5])
    still = [("/s", STATES, time_ns, joint_state(0, ["a"], [1.0])) for time_ns in (0, 250_000_000)]
    found = read_joint_states(write_bag(tmp_path / "still", still))
    np.testing.assert_allclose(found.time_s, [0.0, 0.25])


def test_a_topic_is_asked_for_where_there_are_several_or_none(tmp_path: Path) -> None:
    second = ("/t", STATES, 0, joint_state(0, ["c"], [0.0]))
    bag = write_bag(tmp_path / "two", [*ROWS, second])
    with pytest.raises(BagError, match="topics of joint states: /s, /t; expected one"):
        read_joint_states(bag)
    assert read_joint_states(bag, "/t").joints == ("c",)
    with pytest.raises(BagError, match="no joint states on /u; expected one of .*: /s, /t"):
        read_joint_states(bag, "/u")
    with pytest.raises(BagError, match="topics of joint states: none"):
        read_joint_states(write_bag(tmp_path / "none", ROWS[3:]))


def test_states_without_names_are_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [("/s", STATES, 0, joint_state(0, [], []))])
    with pytest.raises(BagError, match="names no joint"):
        read_joint_states(bag)
