"""Time-optimal timings: within all bounds, and no slower than they have to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tel_ros.core.errors import TrajectoryError
from tel_ros.core.trajectories.path_dynamics import PathDynamics, middles
from tel_ros.core.trajectories.paths import NAMED_PATHS, Path
from tel_ros.core.trajectories.time_optimal import (
    Bounds,
    EffortBounds,
    fastest_minimum_jerk,
    room,
    time_optimal,
)
from tel_ros.core.trajectories.timing import Timing
from tel_ros.core.types import NS_PER_S, FloatArray

LOOPS = NAMED_PATHS["planar_loops"]
LINE = Path(
    "line", 1, lambda s: (s[:, None], np.ones((len(s), 1)), np.zeros((len(s), 1)))
)  # one joint, 1 rad
LIMIT_NM = np.array([20.0, 12.0])
FAST = np.array([1e6])


def effort_of_a_made_up_arm(inputs: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
    """Return efforts of two coupled joints with inertia, Coriolis forces, gravity and friction."""
    q, v, a = inputs
    coupling = 0.4 * np.cos(q[:, 1])
    first = (1.2 + 2.0 * coupling) * a[:, 0] + (0.3 + coupling) * a[:, 1]
    first -= 0.4 * np.sin(q[:, 1]) * (2.0 * v[:, 0] * v[:, 1] + v[:, 1] ** 2)
    second = (0.3 + coupling) * a[:, 0] + 0.5 * a[:, 1] + 0.4 * np.sin(q[:, 1]) * v[:, 0] ** 2
    gravity = np.column_stack([4.0 * np.cos(q[:, 0]), 1.5 * np.cos(q[:, 0] + q[:, 1])])
    return np.column_stack([first, second]) + gravity + 0.3 * v + 0.2 * np.tanh(v / 0.01)


def dynamics() -> PathDynamics:
    probe = PathDynamics.probe(LOOPS, 1.0)
    inputs = (probe.position_rad, probe.velocity_rad_s, probe.acceleration_rad_s2)
    return PathDynamics.of(LOOPS, 1.0, effort_of_a_made_up_arm(inputs))


def one_joint(inertia: float = 1.0, viscous: float = 0.0) -> PathDynamics:
    ones = np.ones((len(middles()), 1))
    return PathDynamics(ones, inertia * ones, 0.0 * ones, viscous * ones, 0.0 * ones)


def constant_effort(limit_nm: float) -> EffortBounds:
    limit = np.full((len(middles()), 1), limit_nm)
    return EffortBounds(-limit, limit, 0.0 * limit)


def bounds_of(effort: EffortBounds, rate: FloatArray, velocity: FloatArray) -> Bounds:
    return Bounds([effort], rate, np.broadcast_to(velocity, effort.low_nm.shape))


def followed(timing: Timing, path: Path, step_ns: int = 1_000_000) -> tuple[FloatArray, FloatArray]:
    """Return velocities and efforts of the made-up arm along the path."""
    s, ds, dds = timing.at(np.arange(0, round(timing.duration_s * NS_PER_S), step_ns))
    q, dq, ddq = path.evaluate(s)
    v, a = dq * ds[:, None], ddq * (ds**2)[:, None] + dq * dds[:, None]
    return v, effort_of_a_made_up_arm((q, v, a))


def test_the_probe_finds_the_efforts_at_any_speed_along_the_path() -> None:
    found, (s, ds, dds) = dynamics(), (middles()[200:220], np.full(20, 0.37), np.full(20, -1.9))
    q, dq, ddq = LOOPS.evaluate(s)
    v, a = dq * 0.37, ddq * 0.37**2 - 1.9 * dq
    np.testing.assert_allclose(found.effort(s, ds, dds), effort_of_a_made_up_arm((q, v, a)), atol=1e-5)


def test_a_mass_that_may_be_pushed_and_braked_takes_the_time_of_bang_bang() -> None:
    effort = constant_effort(4.0)
    timing = time_optimal(one_joint(), bounds_of(effort, FAST, FAST))
    assert timing.duration_s == pytest.approx(1.0, rel=0.01)  # 2 √(1 rad · 1 kg·m² / 4 N·m)


def test_the_rate_of_the_effort_is_bounded_from_rest_to_rest() -> None:
    effort = constant_effort(4.0)
    timing = time_optimal(one_joint(), bounds_of(effort, np.array([20.0]), FAST))
    _, _, dds = timing.at(np.arange(0, round(timing.duration_s * NS_PER_S), 1_000_000))
    assert abs(dds[0]) <= 1e-9
    assert np.abs(np.diff(dds)).max() / 0.001 <= 20.0 * 1.15  # the window is not as long as each interval
    assert 1.15 < timing.duration_s < 1.25  # 0.2 s of ramps more than without


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_efforts_stay_within_their_share_and_one_joint_is_at_its_bound_nearly_always(share: float) -> None:
    effort = room(dynamics(), LIMIT_NM, share, share, ("a", "b"))
    timing = time_optimal(dynamics(), bounds_of(effort, LIMIT_NM / 0.015, np.full(2, 50.0)))
    _, effort_nm = followed(timing, LOOPS)
    used = np.abs(effort_nm) / (share * LIMIT_NM)
    assert used.max() <= 1.02
    assert np.mean(used.max(axis=1) > 0.95) > 0.7
    assert np.abs(np.diff(effort_nm, axis=0)).max() / 0.001 <= 1.1 * LIMIT_NM.max() / 0.015 + 400.0


def test_velocities_stay_within_their_limits_and_reach_them() -> None:
    limit = np.array([2.0, 3.0])
    effort = room(dynamics(), LIMIT_NM, 1.0, 1.0, ("a", "b"))
    timing = time_optimal(dynamics(), bounds_of(effort, LIMIT_NM / 0.015, limit))
    velocity, _ = followed(timing, LOOPS)
    assert 0.98 <= (np.abs(velocity) / limit).max() <= 1.005


def test_a_share_of_the_room_that_gravity_leaves_takes_the_inverse_root_of_it_in_time() -> None:
    without_drag = replace(dynamics(), viscous=np.zeros_like(dynamics().viscous))

    def duration_s(share: float) -> float:
        effort = room(without_drag, LIMIT_NM, share, 0.9, ("a", "b"))
        return time_optimal(without_drag, bounds_of(effort, np.full(2, 1e6), np.full(2, 1e3))).duration_s

    assert duration_s(0.225) == pytest.approx(2.0 * duration_s(0.9), rel=0.01)


def test_minimum_jerk_within_the_same_bounds_takes_about_twice_the_time() -> None:
    effort = room(dynamics(), LIMIT_NM, 0.9, 0.9, ("a", "b"))
    bounds = bounds_of(effort, LIMIT_NM / 0.015, np.full(2, 50.0))
    slow, fast = fastest_minimum_jerk(dynamics(), bounds), time_optimal(dynamics(), bounds)
    _, effort_nm = followed(slow, LOOPS)
    assert (np.abs(effort_nm) / (0.9 * LIMIT_NM)).max() == pytest.approx(1.0, rel=0.01)
    assert 1.5 < slow.duration_s / fast.duration_s < 2.5


def test_a_joint_whose_gravity_needs_more_than_it_may_use_is_named() -> None:
    with pytest.raises(
        TrajectoryError, match=r"lift needs 4\.\d N·m against gravity and friction at .* may use 3\.6"
    ):
        room(dynamics(), np.array([4.0, 12.0]), 0.3, 0.9, ("lift", "b"))


def test_a_path_that_no_effort_may_hold_has_no_timing() -> None:
    effort = room(dynamics(), LIMIT_NM, 0.9, 0.9, ("a", "b"))
    wall = EffortBounds(effort.low_nm, np.full_like(effort.high_nm, -5.0), np.zeros_like(effort.low_nm))
    with pytest.raises(
        TrajectoryError, match="no timing with which the arm may follow the path, however slow"
    ):
        time_optimal(dynamics(), Bounds([effort, wall], LIMIT_NM / 0.015, np.full_like(effort.low_nm, 50.0)))


def test_damping_in_a_bound_makes_it_narrower_with_speed() -> None:
    n = (len(middles()), 1)
    effort = constant_effort(4.0)
    wall = EffortBounds(np.full(n, -100.0), np.full(n, 4.0), np.full(n, 2.0))  # τ + 2 ṡ <= 4
    velocity = np.full(n, 1e3)
    free = time_optimal(one_joint(), Bounds([effort], FAST, velocity))
    held = time_optimal(one_joint(), Bounds([effort, wall], FAST, velocity))
    time_ns = np.arange(0, round(held.duration_s * NS_PER_S), 1_000_000)
    _, ds, dds = held.at(time_ns)
    assert np.max(dds + 2.0 * ds) <= 4.0 * 1.01
    assert held.duration_s > 1.05 * free.duration_s
