"""Which ticks of a trial are learned from."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm, loops, make_bench
from two_link_trials import truth_rad

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import rms
from tel_ros.core.learning.signals import TrialSignals, learning_record, training_samples
from tel_ros.core.trial import Outcome, Phase, Trial, TrialReport
from tel_ros.core.types import FloatArray, IntArray

Record = Callable[..., TrialSignals]
PERIOD_NS = 2_000_000
REPORT = TrialReport(
    index=1,
    alpha=1.0,
    duration_s=2.0,
    outcome=Outcome.COMPLETED,
    message="",
    rms_error_rad=0.01,
    rms_error_per_joint_rad=np.full(2, 0.01),
    max_error_rad=0.03,
    max_effort_nm=np.ones(2),
    saturated_ratio=0.0,
)
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
        Trial(
            report=REPORT,
            joints=("shoulder", "elbow"),
            time_ns=time_ns,
            phase=phase,
            desired=np.hstack([POSITION_RAD, W * POSITION_RAD, -(W**2) * POSITION_RAD]),
            equilibrium_rad=equilibrium_rad,
            position_rad=POSITION_RAD,
            velocity_rad_s=W * POSITION_RAD,
            effort_nm=np.zeros(POSITION_RAD.shape),
            saturated=np.zeros(POSITION_RAD.shape, dtype=bool),
        )
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


@pytest.mark.parametrize(("cutoff_hz", "reach"), [(0.0, 1), (15.0, 17), (5.0, 50)])
@pytest.mark.parametrize("joint", [0, 1])
def test_ticks_with_a_clipped_effort_and_their_neighbours_are_left_out(
    loops_trial: Bench, recorded: Record, joint: int, cutoff_hz: float, reach: int
) -> None:
    trial = recorded(loops_trial)
    first = int(np.argmax(trial.run))
    saturated = np.zeros_like(trial.saturated)
    saturated[first + 700 : first + 720, joint] = True
    saturated[first + 1500, joint] = True
    whole = training_samples(trial, cutoff_hz)
    samples = training_samples(dataclasses.replace(trial, saturated=saturated), cutoff_hz)
    gone = np.r_[700 - reach : 720 + reach, 1500 - reach : 1501 + reach]
    np.testing.assert_array_equal(samples.desired, np.delete(whole.desired, gone, axis=0))
    np.testing.assert_array_equal(samples.actual, np.delete(whole.actual, gone, axis=0))
    assert len(samples.offset_rad) == len(samples.actual)


def test_saturation_next_to_run_reaches_into_it(loops_trial: Bench, recorded: Record) -> None:
    trial = recorded(loops_trial)
    saturated = np.zeros_like(trial.saturated)
    saturated[int(np.argmax(trial.run)) - 5] = True
    samples = training_samples(dataclasses.replace(trial, saturated=saturated), 15.0)
    assert len(samples.actual) == 2251 - (17 - 4)


@pytest.mark.parametrize("cutoff_hz", [None, 0.0, 3.0, 15.0])
@pytest.mark.parametrize("n_clipped", [1, 20, 100])
def test_a_command_that_did_not_act_does_not_falsify_the_pairs(
    loops_trial: Bench, recorded: Record, n_clipped: int, cutoff_hz: float | None
) -> None:
    trial = recorded(loops_trial)
    clipped = np.flatnonzero(trial.run)[700:][:n_clipped]
    saturated, equilibrium = trial.saturated.copy(), trial.equilibrium_rad.copy()
    saturated[clipped, 0] = True
    equilibrium[clipped, 0] += 0.5
    unnoticed = dataclasses.replace(trial, equilibrium_rad=equilibrium)
    noticed = dataclasses.replace(unnoticed, saturated=saturated)
    whole = training_samples(trial, cutoff_hz)
    seen = training_samples(noticed, cutoff_hz)
    left = np.isin(whole.desired, seen.desired).all(axis=1)
    # A straight line in place of what acted for 0.2 s is off by 40 mrad in the middle; a tenth of that is
    # what the longest filter carries over.
    assert np.abs(seen.offset_rad - whole.offset_rad[left]).max() < 6e-3
    assert rms(seen.offset_rad - whole.offset_rad[left]) < 1e-3
    np.testing.assert_array_equal(seen.offset_rad[:, 1], whole.offset_rad[left][:, 1])
    missed = np.abs(training_samples(unnoticed, cutoff_hz).offset_rad - whole.offset_rad).max()
    assert missed > 5.0 * np.abs(seen.offset_rad - whole.offset_rad[left]).max()


@pytest.mark.parametrize("cutoff_hz", [None, 0.0, 6.0, 15.0])
def test_a_weak_motor_teaches_nothing_wrong(
    plant: TwoLinkArm, recorded: Record, cutoff_hz: float | None
) -> None:
    bench = make_bench(description={"effort_limit_nm": (5.0, 5.0)})
    assert bench.run(loops(4.5)).outcome == Outcome.COMPLETED
    trial = recorded(bench)
    assert np.count_nonzero(trial.saturated[trial.run]) > 300
    unnoticed = dataclasses.replace(trial, saturated=np.zeros_like(trial.saturated))
    errors = [
        rms(samples.offset_rad - truth_rad(samples.actual, plant))
        for samples in (training_samples(t, cutoff_hz) for t in (trial, unnoticed))
    ]
    assert errors[0] < 1e-3
    assert errors[1] > 0.05


@pytest.mark.parametrize("cutoff_hz", [None, 0.0, 15.0])
def test_a_trial_that_was_saturated_throughout_is_refused(
    loops_trial: Bench, recorded: Record, cutoff_hz: float | None
) -> None:
    trial = recorded(loops_trial)
    saturated = np.ones_like(trial.saturated)
    said = (
        "^the effort was clipped, .* in 2251 of the 2251 ticks of RUN, which leaves 0 to learn from; "
        r"expected at least 50\. Move slower"
    )
    with pytest.raises(TrainingError, match=said):
        training_samples(dataclasses.replace(trial, saturated=saturated), cutoff_hz)


def test_a_trial_with_too_little_between_saturated_ticks_is_refused(
    loops_trial: Bench, recorded: Record
) -> None:
    trial = recorded(loops_trial)
    saturated = np.zeros_like(trial.saturated)
    saturated[np.flatnonzero(trial.run)[::30], 1] = True
    said = "^the effort was clipped, .* in 76 of the 2251 ticks of RUN, which leaves 0 to learn from"
    with pytest.raises(TrainingError, match=said):
        training_samples(dataclasses.replace(trial, saturated=saturated), 15.0)
    unfiltered = training_samples(dataclasses.replace(trial, saturated=saturated), 0.0)
    # Three ticks for each but the first, which has no neighbour in RUN before it, and the last.
    assert len(unfiltered.actual) == 2251 - 3 * 76 + 2
