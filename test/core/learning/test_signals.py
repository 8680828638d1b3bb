"""From a recorded trial to pairs of motion and command, on an arm whose dynamics are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from two_link import Bench, TwoLinkArm

from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.signals import TrialSignals, training_samples

Record = Callable[..., TrialSignals]
DT_S = 0.002


def true_offset_rad(plant: TwoLinkArm, inputs: np.ndarray) -> np.ndarray:
    """Return u - q = K⁻¹ (B q̇ + M q̈ + C q̇ + f) of the arm."""
    q, v, a = np.split(inputs, 3, axis=1)
    return (1.5 * v + plant.inverse_dynamics(q, v, a)) / 15.0


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
    return TrialSignals(time_ns, run, np.hstack([q, w * q, w**2 * q]), q, q + 0.1 * np.cos(w * t)[:, None])


@pytest.mark.parametrize("cutoff_hz", [0.0, 15.0], ids=["raw", "filtered"])
def test_the_pairs_are_those_of_the_arms_inverse_dynamics(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record, cutoff_hz: float
) -> None:
    samples = training_samples(recorded(loops_trial), cutoff_hz)
    error = samples.offset_rad - true_offset_rad(plant, samples.actual)
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

    errors = [rms((samples.offset_rad - true_offset_rad(plant, shifted(s)))[inner]) for s in shifts]
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
    assert rms(filtered.offset_rad - true_offset_rad(plant, filtered.actual)) < 1e-3


def test_the_ends_of_run_are_as_good_as_its_middle(
    loops_trial: Bench, plant: TwoLinkArm, recorded: Record
) -> None:
    """The arm still moves when RUN ends: a filter that began or ended there would leave a transient."""
    trial = recorded(loops_trial)
    whole, cut = training_samples(trial, 15.0), training_samples(cut_to_run(trial), 15.0)
    ends = np.r_[0:25, -25:0]
    errors = [rms((s.offset_rad - true_offset_rad(plant, s.actual))[ends]) for s in (whole, cut)]
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
