"""Tolerances of a goal."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.serving.tolerances import exceeded, tolerances

JOINTS = ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("named", "position_rad", "expected", "wrong"),
    [
        ((), (), [0.5, 0.5], ""),
        (("elbow",), (0.1,), [0.5, 0.1], ""),
        (("elbow", "shoulder"), (0.0, -1.0), [np.inf, 0.5], ""),
        (("elbow", "wrist"), (0.1, 0.1), [0.5, 0.5], "'wrist'"),
        (("elbow", "shoulder"), (0.1, -2.0), [0.5, 0.5], "-2.0"),
        (("elbow",), (np.nan,), [0.5, 0.5], "nan"),
    ],
)
def test_tolerances_are_taken_as_joint_trajectory_controller_takes_them(
    named, position_rad, expected, wrong
) -> None:  # noqa: ANN001, E501
    found, said = tolerances(JOINTS, named, position_rad, 0.5)
    np.testing.assert_array_equal(found, expected)
    assert (wrong in said) if wrong else said == ""


def test_the_joint_that_is_furthest_beyond_its_tolerance_is_named() -> None:
    tolerance = np.array([0.1, np.inf])
    assert exceeded(JOINTS, np.array([-0.1, 5.0]), tolerance) == ""
    assert (
        exceeded(JOINTS, np.array([-0.11, 5.0]), tolerance)
        == "shoulder is 0.1100 rad off (tolerance 0.1 rad)"
    )
