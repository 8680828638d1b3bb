"""What may go into the control loop."""

from __future__ import annotations

import numpy as np
import pytest
from two_link import reach

from tel_ros.core.arm_state import ArmState
from tel_ros.core.errors import StateError, TrajectoryError
from tel_ros.core.trial import TrialGoal


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", ["position", "velocity"])
def test_a_state_that_is_not_finite_is_refused_with_its_values(field: str, bad: float) -> None:
    position, velocity = np.array([0.25, 1.5]), np.array([0.5, -0.5])
    (position if field == "position" else velocity)[1] = bad
    with pytest.raises(StateError) as refusal:
        ArmState(0, position, velocity)
    assert str(position.tolist()) in str(refusal.value)
    assert str(velocity.tolist()) in str(refusal.value)
    assert "expected finite numbers" in str(refusal.value)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_infinities_that_would_cancel_in_a_sum_are_refused() -> None:
    with pytest.raises(StateError, match="expected finite numbers"):
        ArmState(0, np.array([np.inf, -np.inf]), np.zeros(2))


def test_a_command_that_does_not_fit_the_desired_trajectory_is_refused() -> None:
    desired = reach().desired
    with pytest.raises(
        TrajectoryError, match=r"the equilibrium trajectory has shape \(500, 2\); expected \(501, 2\)"
    ):
        TrialGoal(1, 1.0, desired, desired.position_rad[:-1])


def test_a_command_that_is_not_finite_is_refused_with_its_place() -> None:
    desired = reach().desired
    command = desired.position_rad.copy()
    command[7, 0] = np.nan
    with pytest.raises(TrajectoryError, match="the equilibrium trajectory is nan for joint 1 at point 7"):
        TrialGoal(1, 1.0, desired, command)
