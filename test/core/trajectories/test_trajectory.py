"""What a desired trajectory may not be."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.errors import TrajectoryError, counted
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample

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
    with pytest.raises(TrajectoryError, match=f"has {counted(n, 'point')}; expected at least 2"):
        trajectory(range(n), **dict.fromkeys(FIELDS, np.zeros((n, 2))))


LOOPS = NAMED_PATHS["planar_loops"]


def test_the_movement_starts_and_ends_at_rest_where_the_path_does() -> None:
    desired = sample(LOOPS, 4.5, 500.0)
    np.testing.assert_allclose(desired.position_rad[[0, -1]], [[0.6, 1.3]] * 2, atol=1e-12)
    np.testing.assert_array_equal(desired.velocity_rad_s[[0, -1]], 0.0)
    np.testing.assert_array_equal(desired.acceleration_rad_s2[[0, -1]], 0.0)


def test_velocities_and_accelerations_are_the_derivatives_of_the_positions() -> None:
    desired = sample(LOOPS, 2.0, 5000.0)
    dt_s = 1 / 5000.0
    speed = np.gradient(desired.position_rad, dt_s, axis=0)[1:-1]
    acceleration = np.gradient(desired.velocity_rad_s, dt_s, axis=0)[1:-1]
    # Central differences are off by dt² / 6 times the next but one derivative. With the fastest harmonic,
    # 0.5 rad at 6π 1.875 / 2 s = 17.7 rad/s, that is below 5e3 rad/s³ for the velocity and 1e5 rad/s⁴ for the
    # acceleration; the values themselves go up to 11 rad/s and 200 rad/s².
    np.testing.assert_allclose(desired.velocity_rad_s[1:-1], speed, rtol=0, atol=5e3 * dt_s**2 / 6)
    np.testing.assert_allclose(
        desired.acceleration_rad_s2[1:-1], acceleration, rtol=0, atol=1e5 * dt_s**2 / 6
    )


@pytest.mark.parametrize(
    ("duration_s", "rate_hz", "points"),
    [
        (4.5, 500.0, 2251),
        (11.5, 500.0, 5751),
        (0.7, 10.0, 8),
        (0.07, 100.0, 8),  # a product that is 7 and a rounding error
        (0.3, 10.0, 4),
        (0.25, 10.0, 4),
        (0.01, 10.0, 2),
    ],
)
def test_points_lie_on_ticks_up_to_the_first_that_is_not_too_early(
    duration_s: float, rate_hz: float, points: int
) -> None:
    desired = sample(LOOPS, duration_s, rate_hz)
    assert len(desired.time_ns) == points
    np.testing.assert_array_equal(desired.time_ns, np.round(np.arange(points) * 1e9 / rate_hz))


def test_a_duration_that_is_no_whole_number_of_ticks_is_kept_and_the_end_is_held() -> None:
    desired = sample(LOOPS, 1.0053, 100.0)
    assert desired.duration_s == 1.01
    fine = sample(LOOPS, 1.0053, 10000.0)
    np.testing.assert_allclose(desired.position_rad[50], fine.position_rad[5000], atol=1e-12)
    np.testing.assert_allclose(desired.position_rad[-1], LOOPS.evaluate(np.array([1.0]))[0][0], atol=1e-12)
    np.testing.assert_array_equal(desired.velocity_rad_s[-1], 0.0)


def test_a_rate_whose_period_is_no_whole_number_of_nanoseconds_does_not_drift() -> None:
    desired = sample(LOOPS, 3.0, 300.0)
    assert desired.time_ns[-1] == 3_000_000_000
    assert set(np.diff(desired.time_ns)) == {3_333_333, 3_333_334}


def test_speed_goes_with_the_inverse_and_acceleration_with_the_inverse_square_of_the_duration() -> None:
    slow, fast = sample(LOOPS, 8.0, 100.0), sample(LOOPS, 4.0, 200.0)
    np.testing.assert_allclose(fast.position_rad, slow.position_rad, atol=1e-12)
    np.testing.assert_allclose(fast.velocity_rad_s, 2.0 * slow.velocity_rad_s, atol=1e-12)
    np.testing.assert_allclose(fast.acceleration_rad_s2, 4.0 * slow.acceleration_rad_s2, atol=1e-11)
