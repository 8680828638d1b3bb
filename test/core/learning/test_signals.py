"""From a recorded trial to pairs of motion and command, on an arm whose dynamics are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm
from two_link_trials import truth_rad

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.learner import rms
from tel_ros.core.learning.signals import TrialSignals, configured_samples, training_samples

Record = Callable[..., TrialSignals]
DT_S = 0.002


def cut_to_run(trial: TrialSignals) -> TrialSignals:
    return TrialSignals(
        **{f.name: getattr(trial, f.name)[trial.run] for f in dataclasses.fields(TrialSignals)}
    )


def swing(time_ns: np.ndarray, hz: float = 0.7) -> TrialSignals:
    """Return a smooth motion in formulas: two seconds of rest at each end are not part of RUN."""
    t = time_ns / 1e9
    w = 2 * np.pi * hz
    q = np.column_stack([0.5 * np.sin(w * t), 0.3 * np.cos(w * t)])
    run = (t > 2.0) & (t < t[-1] - 2.0)
    return TrialSignals(
        time_ns=time_ns,
        run=run,
        desired=np.hstack([q, w * q, w**2 * q]),
        position_rad=q,
        equilibrium_rad=q + 0.1 * np.cos(w * t)[:, None],
        saturated=np.zeros(q.shape, dtype=bool),
    )


@pytest.mark.parametrize("cutoff_hz", [0.0, 15.0], ids=["raw", "filtered"])
def test_the_pairs_are_those_of_the_arms_inverse_dynamics(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record, cutoff_hz: float
) -> None:
    samples = training_samples(recorded(loops_trial), cutoff_hz)
    error = samples.offset_rad - truth_rad(samples.actual, plant)
    # What is left comes from positions and velocities of the beginning of each interval beside the mean
    # acceleration: 0.26 mrad RMS of 230, and twice that is allowed. Half a sample's lag would make 1 mrad.
    assert rms(samples.offset_rad) > 0.2
    assert rms(error) < 0.5e-3
    assert np.abs(error).max() < 3e-3


@pytest.mark.parametrize("cutoff_hz", [0.0, 15.0], ids=["raw", "filtered"])
def test_motion_and_command_are_not_half_a_sample_apart(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record, cutoff_hz: float
) -> None:
    samples = training_samples(recorded(loops_trial), cutoff_hz)
    samples_t, shifts = np.arange(len(samples.actual)), (-1.0, -0.5, 0.0, 0.5, 1.0)
    inner = slice(5, -5)  # where a shift by a sample still finds one

    def shifted(shift: float) -> np.ndarray:
        moved = samples.actual.copy()
        for j in (4, 5):
            moved[:, j] = np.interp(samples_t + shift, samples_t, samples.actual[:, j])
        return moved

    errors = [rms((samples.offset_rad - truth_rad(shifted(s), plant))[inner]) for s in shifts]
    assert int(np.argmin(errors)) == 2, dict(zip(shifts, errors, strict=True))
    assert min(errors[1], errors[3]) > 3.0 * errors[2]


def test_velocities_and_accelerations_are_those_of_the_motion() -> None:
    time_ns = np.arange(0, 8_000_000_000, 2_000_000)
    trial = swing(time_ns)
    q, v, a = np.split(training_samples(trial, 15.0).actual, 3, axis=1)
    t, w = trial.time_ns[trial.run] / 1e9, 2 * np.pi * 0.7
    # The filter of order 4, twice, takes (0.7 / 15)^8 = 2e-11 off; central differences (w dt)² / 6 = 1.3e-5.
    np.testing.assert_allclose(q[:, 0], 0.5 * np.sin(w * t), atol=1e-6)
    np.testing.assert_allclose(v[:, 0], 0.5 * w * np.cos(w * t), atol=1e-4)
    middle = t + DT_S / 2
    np.testing.assert_allclose(a[:, 0], -0.5 * w**2 * np.sin(w * middle), atol=1e-3)
    np.testing.assert_allclose(a[:, 1], -0.3 * w**2 * np.cos(w * middle), atol=1e-3)


def test_the_filter_shifts_nothing_in_time() -> None:
    time_ns = np.arange(0, 8_000_000_000, 2_000_000)
    trial = swing(time_ns, hz=4.0)
    raw, filtered = training_samples(trial, 0.0).actual[:, 0], training_samples(trial, 15.0).actual[:, 0]
    fine = np.linspace(-1.0, 1.0, 201)  # samples
    at = np.arange(10, len(raw) - 10)
    match = [np.dot(np.interp(at + s, np.arange(len(raw)), raw), filtered[at]) for s in fine]
    assert abs(fine[int(np.argmax(match))]) <= 0.02


def test_the_filter_keeps_the_noise_of_an_encoder_out_of_the_acceleration(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record
) -> None:
    trial = recorded(loops_trial, encoder_bits=16)
    exact = training_samples(recorded(loops_trial), 15.0)
    raw, filtered = training_samples(trial, 0.0), training_samples(trial, 15.0)
    noise = [rms((samples.actual - exact.actual)[:, 4:]) for samples in (raw, filtered)]
    # A step is 0.1 mrad, its noise 28 µrad: differentiated twice raw, 28 µrad √4 / (2 (2 ms)²) = 7 rad/s².
    # What the filter leaves below 15 Hz has (2π 15 Hz)² √(15 / (5 · 250)) 28 µrad = 0.03 rad/s²; twice that
    # is allowed, for quantised positions are not quite white.
    assert noise[0] > 3.0
    assert noise[1] < 0.06
    assert rms(filtered.offset_rad - truth_rad(filtered.actual, plant)) < 1e-3


def test_the_ends_of_run_are_as_good_as_its_middle(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record
) -> None:
    """The arm still moves when RUN ends: a filter that began or ended there would leave a transient."""
    trial = recorded(loops_trial)
    whole, cut = training_samples(trial, 15.0), training_samples(cut_to_run(trial), 15.0)
    ends = np.r_[0:25, -25:0]
    errors = [rms((s.offset_rad - truth_rad(s.actual, plant))[ends]) for s in (whole, cut)]
    assert errors[0] < 0.5e-3  # as for all of RUN
    assert errors[1] > 0.05, "the record before and after RUN makes no difference"


def test_only_run_is_learned_from(loops_trial: Bench, recorded: Record) -> None:
    trial = recorded(loops_trial)
    samples = training_samples(trial, 15.0)
    assert len(samples.actual) == len(samples.desired) == len(samples.offset_rad) == 2251
    np.testing.assert_array_equal(samples.desired[:, :4], trial.desired[trial.run][:, :4])


def test_the_desired_acceleration_is_the_mean_of_the_interval_as_in_the_prediction(
    loops_trial: Bench, recorded: Record
) -> None:
    trial = recorded(loops_trial)
    kept = trial.desired.copy()
    acceleration = trial.desired[trial.run][:, 4:]
    samples = training_samples(trial, 15.0)
    np.testing.assert_allclose(
        samples.desired[:-1, 4:], 0.5 * (acceleration[:-1] + acceleration[1:]), atol=1e-12
    )
    np.testing.assert_array_equal(trial.desired, kept)


def test_missing_and_irregular_stamps_do_little_harm() -> None:
    rng = np.random.default_rng(4)
    time_ns = np.arange(0, 8_000_000_000, 2_000_000)
    time_ns = time_ns + rng.integers(-400_000, 400_000, len(time_ns))
    time_ns = time_ns[np.sort(rng.choice(len(time_ns), round(0.95 * len(time_ns)), replace=False))]
    time_ns -= time_ns[0]
    trial = swing(time_ns)
    samples = training_samples(trial, 15.0)
    t, w = trial.time_ns[trial.run] / 1e9, 2 * np.pi * 0.7
    assert len(samples.actual) == len(t)
    # The nearest point of an even grid is up to half a period away: at 2.2 rad/s, 10 rad/s² and 43 rad/s³ the
    # first terms. The second are for what interpolation between uneven stamps adds.
    np.testing.assert_allclose(samples.actual[:, 0], 0.5 * np.sin(w * t), atol=2.2e-3 + 1e-4)
    np.testing.assert_allclose(samples.actual[:, 2], 0.5 * w * np.cos(w * t), atol=0.01 + 0.01)
    np.testing.assert_allclose(
        samples.actual[:, 4], -0.5 * w**2 * np.sin(w * (t + DT_S / 2)), atol=0.043 + 0.25
    )


def test_a_cutoff_above_half_of_the_sampling_rate_switches_the_filter_off(
    loops_trial: Bench, recorded: Record
) -> None:
    trial = recorded(loops_trial, encoder_bits=16)
    off = training_samples(trial, 0.0).actual
    np.testing.assert_array_equal(training_samples(trial, 250.0).actual, off)
    assert not np.array_equal(training_samples(trial, 249.0).actual, off)


@pytest.mark.parametrize("n_run", [0, 49])
def test_a_trial_with_too_little_run_is_refused(n_run: int) -> None:
    trial = swing(np.arange(0, 8_000_000_000, 2_000_000))
    run = np.zeros(len(trial.time_ns), dtype=bool)
    run[1000 : 1000 + n_run] = True
    with pytest.raises(TrainingError, match=rf"the trial has {n_run} ticks of RUN; expected at least 50"):
        training_samples(dataclasses.replace(trial, run=run), 15.0)


@pytest.mark.parametrize("name", ["desired", "position_rad", "equilibrium_rad"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_recorded_values_that_are_not_finite_are_refused_by_name(name: str, bad: float) -> None:
    trial = swing(np.arange(0, 8_000_000_000, 2_000_000))
    values = getattr(trial, name).copy()
    values[5, 1] = bad
    with pytest.raises(TrainingError, match=f"^{name} of the trial has values that are not finite$"):
        training_samples(dataclasses.replace(trial, **{name: values}), 15.0)


def test_the_chosen_filter_brings_noisy_pairs_nearest_to_the_truth(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record
) -> None:
    trial = recorded(loops_trial, noise_rad=1e-3)
    samples = {cutoff: training_samples(trial, cutoff) for cutoff in (None, 15.0, 0.0)}
    error = {c: rms(s.offset_rad - truth_rad(s.actual, plant)) for c, s in samples.items()}
    # Measured: 1.9, 17 and 4,280 mrad.
    assert error[None] < 3e-3
    assert error[None] < error[15.0] / 5.0 < error[0.0] / 500.0


@pytest.mark.parametrize("noise", [{}, {"encoder_bits": 16}, {"noise_rad": 1e-4}], ids=str)
def test_the_chosen_filter_does_no_harm_where_there_is_little_noise(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record, noise: dict[str, float]
) -> None:
    samples = training_samples(recorded(loops_trial, **noise), None)
    # 0.3 mrad are left without noise, see above.
    assert rms(samples.offset_rad - truth_rad(samples.actual, plant)) < 0.6e-3


@pytest.mark.parametrize("cutoff_hz", [None, 0.0, 6.0, 15.0])
def test_the_noise_of_the_inputs_is_as_stated(
    loops_trial: Bench, recorded: Record, cutoff_hz: float | None
) -> None:
    noisy = training_samples(recorded(loops_trial, noise_rad=1e-3), cutoff_hz)
    exact = training_samples(recorded(loops_trial), noisy.bandwidth_hz)
    found = np.sqrt(np.mean((noisy.actual - exact.actual) ** 2, axis=0))
    assert noisy.input_noise.shape == (6,)
    # At 6 Hz, 4.5 s hold about 50 independent values: 10 % of scatter beside the 3 % of the estimate.
    np.testing.assert_allclose(noisy.input_noise, found, rtol=0.3)
    assert rms(noisy.input_noise[4:] / found[4:] - 1.0) < 0.2


@pytest.mark.parametrize("cutoff_hz", [None, 0.0, 3.0, 15.0])
def test_command_and_response_go_through_the_same_filter(
    loops_trial: Bench, recorded: Record, cutoff_hz: float | None
) -> None:
    """A command that follows the noisy positions at a distance keeps that distance, whatever the filter."""
    trial = recorded(loops_trial, noise_rad=1e-3)
    follows = dataclasses.replace(trial, equilibrium_rad=trial.position_rad + [0.1, -0.2])
    offset = training_samples(follows, cutoff_hz).offset_rad
    np.testing.assert_allclose(offset, np.tile([0.1, -0.2], (2251, 1)), atol=1e-9)


def test_the_chosen_filter_is_named(loops_trial: Bench, recorded: Record) -> None:
    quiet, noisy = (recorded(loops_trial, noise_rad=noise) for noise in (1e-4, 1e-3))
    chosen = [training_samples(trial, None) for trial in (quiet, noisy)]
    assert 4.0 < chosen[1].bandwidth_hz < chosen[0].bandwidth_hz < 15.0
    for trial, samples in zip((quiet, noisy), chosen, strict=True):
        again = training_samples(trial, samples.bandwidth_hz)
        np.testing.assert_array_equal(again.actual, samples.actual)
        assert samples.period_s == DT_S


def test_rest_before_and_after_the_motion_does_not_hide_an_encoders_noise(
    loops_trial: Bench, recorded: Record
) -> None:
    """An arm at rest stays within a step of its encoder."""
    trial = recorded(loops_trial, encoder_bits=16)
    n = 20_000
    fields = {f.name: getattr(trial, f.name) for f in dataclasses.fields(TrialSignals)}
    longer = TrialSignals(**{k: np.concatenate([np.repeat(v[:1], n, axis=0), v]) for k, v in fields.items()})
    longer.time_ns[:] = trial.time_ns[0] + 2_000_000 * np.arange(len(longer.time_ns))
    samples, expected = training_samples(longer, None), training_samples(trial, None)
    assert samples.bandwidth_hz == expected.bandwidth_hz
    np.testing.assert_allclose(samples.input_noise, expected.input_noise, rtol=1e-3)


def test_at_a_low_rate_a_record_without_noise_is_left_alone(loops_trial: Bench, recorded: Record) -> None:
    trial = recorded(loops_trial)
    slow = TrialSignals(**{f.name: getattr(trial, f.name)[::20] for f in dataclasses.fields(TrialSignals)})
    chosen, unfiltered = training_samples(slow, None), training_samples(slow, 0.0)
    np.testing.assert_array_equal(chosen.actual, unfiltered.actual)
    np.testing.assert_array_equal(chosen.offset_rad, unfiltered.offset_rad)
    assert (chosen.period_s, chosen.bandwidth_hz) == (0.04, 12.5)


@pytest.mark.parametrize(
    ("learning", "bandwidth_hz"),
    [
        (LearningConfig(filter="fixed", filter_cutoff_hz=12.0), 12.0),
        (LearningConfig(filter="auto", filter_cutoff_hz=3.5), 3.5),
        (LearningConfig(filter="fixed", filter_cutoff_hz=0.0), 250.0),
    ],
    ids=["fixed", "highest to choose", "off"],
)
def test_the_configured_cutoff_is_used_or_limits_what_is_chosen(
    loops_trial: Bench, recorded: Record, learning: LearningConfig, bandwidth_hz: float
) -> None:
    assert configured_samples(recorded(loops_trial, 16), learning).bandwidth_hz == pytest.approx(bandwidth_hz)


def test_without_a_limit_the_chosen_cutoff_is_that_of_the_data(loops_trial: Bench, recorded: Record) -> None:
    trial = recorded(loops_trial, 16)
    unlimited = configured_samples(trial, LearningConfig(filter_cutoff_hz=0.0))
    assert unlimited.bandwidth_hz == training_samples(trial, None).bandwidth_hz
