"""Which part of a trial is learned from."""

from __future__ import annotations

import numpy as np
import pytest

from tel_ros.core.learning.signals import TrialSignals, learning_record, training_samples
from tel_ros.core.trial import Phase
from tel_ros.core.types import FloatArray, IntArray

PERIOD_NS = 2_000_000
TIME_NS = np.arange(0, 5_000_000_000, PERIOD_NS)
TIME_S = TIME_NS / 1e9
W = 2 * np.pi * 0.7
POSITION_RAD = np.column_stack([0.5 * np.sin(W * TIME_S), 0.3 * np.cos(W * TIME_S)])
EQUILIBRIUM_RAD = POSITION_RAD + 0.1 * np.cos(W * TIME_S)[:, None]


def phases(end: Phase) -> IntArray:
    """Return two seconds of rest, two of RUN, and one of a last phase."""
    return np.select([TIME_S < 2.0, TIME_S <= 4.0], [Phase.SETTLE, Phase.RUN], end).astype(np.int64)


def record(
    phase: IntArray, *, time_ns: IntArray = TIME_NS, equilibrium_rad: FloatArray = EQUILIBRIUM_RAD
) -> TrialSignals:
    """Return the record of a smooth motion in formulas, which goes on in all phases."""
    return learning_record(
        time_ns=time_ns,
        phase=phase,
        desired=np.hstack([POSITION_RAD, W * POSITION_RAD, -(W**2) * POSITION_RAD]),
        position_rad=POSITION_RAD,
        equilibrium_rad=equilibrium_rad,
        saturated=np.zeros(POSITION_RAD.shape, dtype=bool),
    )


def test_the_way_to_the_start_is_left_out() -> None:
    phase = phases(Phase.HOLD)
    phase[:500] = Phase.APPROACH
    found = record(phase)
    np.testing.assert_array_equal(found.time_ns, TIME_NS[500:])
    np.testing.assert_array_equal(found.position_rad, POSITION_RAD[500:])
    np.testing.assert_array_equal(found.equilibrium_rad, EQUILIBRIUM_RAD[500:])
    np.testing.assert_array_equal(found.run, phase[500:] == Phase.RUN)
    assert (len(found.desired), len(found.saturated)) == (2000, 2000)


@pytest.mark.parametrize("end", [Phase.HOLD, Phase.STOP], ids=lambda phase: phase.name)
def test_the_last_ticks_of_run_are_learned_as_well_as_the_others(end: Phase) -> None:
    """A record that breaks off in mid-motion would leave the transient of its filter there."""
    phase = phases(end)
    samples = training_samples(record(phase), 15.0)
    t = TIME_S[phase == Phase.RUN]
    expected = -0.5 * W**2 * np.sin(W * (t + 0.001))
    # Accelerations are up to 9.7 rad/s²; a twentieth of that is a hundred times what is usual in mid-record.
    np.testing.assert_allclose(samples.actual[-30:, 4], expected[-30:], atol=0.5)


def test_the_command_of_the_brake_does_not_reach_into_what_is_learned() -> None:
    phase = phases(Phase.STOP)
    braked = EQUILIBRIUM_RAD - 0.5 * (phase == Phase.STOP)[:, None]
    samples = training_samples(record(phase, equilibrium_rad=braked), 15.0)
    expected = (EQUILIBRIUM_RAD - POSITION_RAD)[phase == Phase.RUN]
    # A hundredth of a radian is what the filter makes of û coming to a sudden rest.
    np.testing.assert_allclose(samples.offset_rad[-30:], expected[-30:], atol=0.01)


def test_the_recorded_command_itself_stays_as_it_was() -> None:
    before = EQUILIBRIUM_RAD.copy()
    record(phases(Phase.STOP))
    np.testing.assert_array_equal(EQUILIBRIUM_RAD, before)


@pytest.mark.parametrize("jump_ns", [-10_000_000, -5_000_000_000, 1_700_000_000_000_000_000])
def test_a_stop_behind_a_jump_in_time_is_no_part_of_the_record(jump_ns: int) -> None:
    """The clock of an arm that was started anew would stretch the record to years."""
    phase = phases(Phase.STOP)
    stop = phase == Phase.STOP
    jumped = record(phase, time_ns=TIME_NS + jump_ns * stop)
    np.testing.assert_array_equal(jumped.time_ns, TIME_NS[~stop])
    np.testing.assert_array_equal(record(phase).time_ns, TIME_NS)


def test_a_trial_that_never_left_the_approach_has_nothing_to_learn_from() -> None:
    phase = phases(Phase.STOP)
    phase[phase != Phase.STOP] = Phase.APPROACH
    assert len(record(phase).time_ns) == 0
