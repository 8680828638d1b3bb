"""Messages in the form that bags hold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

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
