"""Where a trial's command error is applied, and what is said of a training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from two_link_trials import rms, trial

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import outcome, training_pair
from tel_ros.core.types import FloatArray

TRIAL = trial(step=50, shift_rad=0.2)


@dataclass
class Says:
    """All that an outcome needs of a learner."""

    predict: Callable[[FloatArray], FloatArray]


def test_actual_trajectory_training_asks_for_the_sent_offset_where_the_arm_was() -> None:
    inputs, targets = training_pair("actual", TRIAL, lambda x: x[:, :2] * 7.0)
    np.testing.assert_array_equal(inputs, TRIAL.actual)
    np.testing.assert_array_equal(targets, TRIAL.offset_rad)


def test_desired_trajectory_training_changes_the_output_at_the_desired_trajectory_by_the_same_error() -> None:
    inputs, targets = training_pair("desired", TRIAL, lambda x: x[:, :2] * 7.0)
    np.testing.assert_array_equal(inputs, TRIAL.desired)
    delta = TRIAL.offset_rad - 7.0 * TRIAL.actual[:, :2]
    np.testing.assert_allclose(targets - 7.0 * TRIAL.desired[:, :2], delta, atol=1e-12)  # rounding


def test_where_the_arm_did_what_was_desired_both_modes_ask_for_the_same() -> None:
    exact = trial(step=50)
    (at, wanted), (at_desired, wanted_there) = (
        training_pair(mode, exact, lambda x: np.sin(x[:, :2])) for mode in ("actual", "desired")
    )
    np.testing.assert_array_equal(at, at_desired)
    np.testing.assert_allclose(wanted, wanted_there, atol=1e-12)  # rounding


def test_the_outcome_is_the_error_before_and_after_and_the_change_of_the_command() -> None:
    before, after = Says(lambda x: 0.1 * x[:, :2]), Says(lambda x: 0.1 * x[:, :2] + [0.03, 0.04])
    told = outcome(before, after, TRIAL, ("grew",))
    wanted = TRIAL.offset_rad - 0.1 * TRIAL.actual[:, :2]
    assert told.rms_before_rad == pytest.approx(rms(wanted))
    assert told.rms_after_rad == pytest.approx(rms(wanted - [0.03, 0.04]))
    assert told.rms_command_change_rad == pytest.approx(0.05 / np.sqrt(2.0))
    assert told.grown == ("grew",)


def test_the_change_of_the_command_is_that_at_the_desired_trajectory() -> None:
    apart = trial(step=50, shift_rad=100.0)
    before, after = Says(lambda x: 0.0 * x[:, :2]), Says(lambda x: np.where(x[:, :2] > 50.0, 0.5, 0.0))
    assert outcome(before, after, apart, ()).rms_command_change_rad == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("which", ["before", "after"])
def test_an_answer_that_is_not_finite_is_refused(which: str, bad: float) -> None:
    good, broken = Says(lambda x: 0.0 * x[:, :2]), Says(lambda x: np.full((len(x), 2), bad))
    pair = (broken, good) if which == "before" else (good, broken)
    with pytest.raises(TrainingError, match=r"not finite; the network is unchanged"):
        outcome(*pair, TRIAL, ())
