"""What a desired trajectory may not be."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory

FIELDS = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")


def trajectory(time_ns: object = (0, 10, 20), **values: np.ndarray) -> DesiredTrajectory:
    return DesiredTrajectory(
        time_ns=np.array(time_ns, dtype=np.int64),
        **({name: np.zeros((3, 2)) for name in FIELDS} | values),
    )


def test_a_trajectory_knows_its_joints_and_its_times() -> None:
    desired = trajectory((0, 250_000_000, 1_500_000_000))
    assert desired.n_joints == 2
    assert desired.duration_s == 1.5
    np.testing.assert_array_equal(desired.time_s, [0.0, 0.25, 1.5])


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_with_its_place(name: str, bad: float) -> None:
    values = np.zeros((3, 2))
    values[1, 1] = bad
    with pytest.raises(
        TrajectoryError, match=f"^{name} is {bad} for joint 2 at point 1; expected finite numbers$"
    ):
        trajectory(**{name: values})


@pytest.mark.parametrize("name", FIELDS)
def test_points_that_do_not_fit_the_times_are_refused(name: str) -> None:
    with pytest.raises(TrajectoryError, match=rf"^{name} has shape \(2, 2\); expected \(3, 2\)"):
        trajectory(**(dict.fromkeys(FIELDS, np.zeros((3, 2))) | {name: np.zeros((2, 2))}))


@pytest.mark.parametrize("name", FIELDS[1:])
def test_another_number_of_joints_than_in_the_positions_is_refused(name: str) -> None:
    with pytest.raises(TrajectoryError, match=rf"^{name} has shape \(3, 1\); expected \(3, 2\)"):
        trajectory(**{name: np.zeros((3, 1))})


def test_a_trajectory_without_joints_is_refused() -> None:
    with pytest.raises(TrajectoryError, match=r"position_rad has shape \(3, 0\)"):
        trajectory(**dict.fromkeys(FIELDS, np.zeros((3, 0))))


def test_positions_in_one_dimension_are_refused() -> None:
    with pytest.raises(TrajectoryError, match=r"position_rad has shape \(3,\)"):
        trajectory(position_rad=np.zeros(3))


def test_times_that_do_not_start_at_zero_are_refused() -> None:
    with pytest.raises(TrajectoryError, match=r"starts at 0.5 s; expected 0"):
        trajectory((500_000_000, 600_000_000, 700_000_000))


@pytest.mark.parametrize("times_s", [(0.0, 0.5, 0.5), (0.0, 0.5, 0.25)], ids=["standing", "back"])
def test_times_that_do_not_increase_are_refused_with_their_place(times_s: tuple[float, ...]) -> None:
    with pytest.raises(
        TrajectoryError, match=f"goes from 0.5 s to {times_s[2]} s at point 2; expected strictly"
    ):
        trajectory([round(t * 1e9) for t in times_s])


@pytest.mark.parametrize("n", [0, 1])
def test_a_trajectory_of_fewer_than_two_points_is_refused(n: int) -> None:
    with pytest.raises(TrajectoryError, match=f"has {n} points; expected at least 2"):
        trajectory(range(n), **dict.fromkeys(FIELDS, np.zeros((n, 2))))
