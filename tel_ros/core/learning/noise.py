"""Noise of recorded positions, the filter and derivatives that it goes through, and joints that may stick."""

from __future__ import annotations

import math

import numpy as np
import scipy  # loads its parts when they are first used: half a second that most processes do without

from tel_ros.core.types import BoolArray, FloatArray

_SEGMENT_S = 2.0
"""Of the spectra: half a Hz from line to line, and still a few segments to average in one trial."""
_ABOVE_NOISE = 10.0
"""Power over that of the noise from which on it is motion. One line of pure noise, not averaged, gets there
once in e¹⁰ = 22,000."""
_HEADROOM = 1.5
"""Cutoff over the highest frequency of motion: two passes of the filter leave 96 % of the amplitude there."""
_LOWEST_CUTOFF_HZ = 3.0
"""The window smears slow motion over 2 Hz: the data do not support a lower cutoff."""
_FASTEST_MOTION_HZ = 20.0
"""Up to here an arm may move whatever its sampling rate; further up only to a tenth of the rate."""
_HIGHEST_CUTOFF = 0.4
"""Of the sampling rate: above that the filter removes next to nothing."""
_STEEP = 10.0
"""Fall of the power within the octave below half of the rate from which on it is not white noise."""
_NEGLIGIBLE = 0.01
"""Noise of unfiltered accelerations, as a share of the accelerations, that is not worth a filter."""
SLOWEST_SLIDING_RAD_S = 0.05
"""A slower joint may alternate between sticking and slipping, of which a low-pass leaves the mean."""
_CLEAR_OF_NOISE = 3.0
"""Standard deviations of the velocity that count as movement."""


def low_pass(values: FloatArray, cutoff_hz: float, period_s: float) -> FloatArray:
    """Return values filtered without lag: Butterworth of order 4, forwards and backwards.

    ``values`` has at least 50 rows, evenly sampled, and is returned itself if the filter is switched off (see
    :func:`filters`). The cutoff is that of one pass, -3 dB.
    """
    if not filters(cutoff_hz, period_s):
        return values
    sos = scipy.signal.butter(4, cutoff_hz, fs=1.0 / period_s, output="sos")
    return scipy.signal.sosfiltfilt(sos, values, axis=0)


def filters(cutoff_hz: float, period_s: float) -> bool:
    """Whether :func:`low_pass` does anything: 0 and half of the sampling rate or more switch it off."""
    return 0.0 < cutoff_hz < 0.5 / period_s


def derivatives(position_rad: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray]:
    """Return velocities and accelerations of evenly sampled positions, all of shape (n, n_joints).

    Velocities are central differences. The acceleration of row k is the mean one from k to k + 1.
    """
    velocity = np.gradient(position_rad, period_s, axis=0)
    acceleration = np.diff(velocity, axis=0, append=velocity[-1:]) / period_s
    return velocity, acceleration


def sensor_noise(values: FloatArray, period_s: float) -> FloatArray:
    """Return the standard deviation [rad] of the white noise on recorded positions. Shape (n_joints,).

    It is taken from above a quarter of the sampling rate, where a motion that was sampled well enough has no
    power. Rounding by an encoder counts as noise: a step of δ has δ / √12 while the joint turns. A joint that
    stands still on one step seems free of noise. ``values`` are as for :func:`choose_cutoff_hz`.
    """
    _, _, floor = _spectrum(values, period_s)
    return np.sqrt(floor * 0.5 / period_s)


def choose_cutoff_hz(values: FloatArray, period_s: float) -> float:
    """Return the cutoff [Hz] at which low-pass filtering removes the noise and keeps the motion.

    That is 1.5 times the highest frequency at which the power of any joint's motion is ten times that of its
    noise. It is one frequency for all joints: each acts on the others, so all of them and their commands have
    to go through the same filter. It lies between 3 Hz and a tenth of the sampling rate or 20 Hz, whichever
    is more, but never above 0.4 of the rate.

    If the noise does not show (it is negligible even in unfiltered accelerations, or the motion goes on up to
    half of the rate), it is the upper end of that range; at 50 Hz or less, 0: no filter.

    ``values`` are positions in rad while the arm moves, evenly sampled, at least 50 rows of n_joints.
    """
    frequency_hz, power, floor = _spectrum(values, period_s)
    rate_hz = 1.0 / period_s
    highest_hz = max(0.1 * rate_hz, _FASTEST_MOTION_HZ)
    # At a low rate any frequency may be motion; at a higher one, what lies above cannot be.
    if_no_noise_hz = highest_hz if highest_hz < _HIGHEST_CUTOFF * rate_hz else 0.0
    if _falls_to_the_end(frequency_hz, power):
        return if_no_noise_hz
    top_hz = max(_top_of_motion(frequency_hz, p, f) for p, f in zip(power.T, floor, strict=True))
    cutoff_hz = min(max(_HEADROOM * top_hz, _LOWEST_CUTOFF_HZ), highest_hz, _HIGHEST_CUTOFF * rate_hz)
    _, acceleration = derivatives(low_pass(values, cutoff_hz, period_s), period_s)
    noise = derivative_noise(0.0, period_s)[2] * sensor_noise(values, period_s)
    # The joints accelerate each other: the noise of one that hardly moves counts against what the others do.
    negligible = noise.max() <= _NEGLIGIBLE * acceleration.std(axis=0).max()
    return if_no_noise_hz if negligible else cutoff_hz


def filtered_impulse(cutoff_hz: float, period_s: float) -> FloatArray:
    """Return what :func:`low_pass` makes of an impulse of 1, long enough for derivatives. Shape (n, 1)."""
    # Of the slowest pole of the filter, exp(-2.4 · 5) = 6e-6 is left after 5 / cutoff.
    memory = math.ceil(5.0 / (cutoff_hz * period_s)) if filters(cutoff_hz, period_s) else 0
    impulse = np.zeros((2 * memory + 51, 1))
    impulse[memory + 25] = 1.0
    return low_pass(impulse, cutoff_hz, period_s)


def derivative_noise(cutoff_hz: float, period_s: float) -> FloatArray:
    """Return what white noise of unit standard deviation on positions becomes behind filter and derivatives.

    Standard deviations in position [1], velocity [1/s] and acceleration [1/s²]; exact but at the ends of a
    record. Shape (3,).
    """
    position = filtered_impulse(cutoff_hz, period_s)
    responses = (position, *derivatives(position, period_s))
    return np.array([math.sqrt(float(np.sum(response**2))) for response in responses])


def slides_throughout(velocity_rad_s: FloatArray, noise_rad_s: FloatArray, reach: int) -> BoolArray:
    """Return when each joint moves in one direction in all that a sample is made of. Shape (n, n_joints).

    A joint that slides is held back by c sgn(q̇). One that sticks is held by any torque within ±c (the
    set-valued law of Coulomb, f ∈ c Sgn(q̇)); the command then says next to nothing about inertia, gravity or
    c. The low-pass rounds the step that friction takes at a reversal, so samples near a reversal are as
    uncertain as the reversal itself: up to ``reach``, the ticks on either side that the filter mixes in.
    The velocity is filtered and evenly sampled, the noise what is left in it, of shape (n_joints,).
    """
    moves = np.maximum(SLOWEST_SLIDING_RAD_S, _CLEAR_OF_NOISE * noise_rad_s)
    size = 2 * reach + 1
    forwards = scipy.ndimage.minimum_filter1d(velocity_rad_s, size, axis=0, mode="nearest") > moves
    backwards = scipy.ndimage.maximum_filter1d(velocity_rad_s, size, axis=0, mode="nearest") < -moves
    return forwards | backwards


def _spectrum(values: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return frequencies [Hz], power densities [rad²/Hz] and for each joint that of its noise."""
    segment = min(len(values), max(round(_SEGMENT_S / period_s), 16))
    # The motion has 10⁸ times the power of an encoder's noise: few windows keep that from spilling over.
    frequency_hz, power = scipy.signal.welch(
        values - values[0],  # so that a joint that stands still has no rounding errors
        fs=1.0 / period_s,
        window="blackmanharris",
        nperseg=segment,
        noverlap=segment // 2,
        detrend="linear",
        axis=0,
    )
    tail = np.median(power[frequency_hz > 0.25 / period_s], axis=0)
    # A line of the spectrum, averaged over m segments, is chi-square with 2 m degrees of freedom (this window
    # leaves segments that overlap by half next to independent). Its median is less than its mean: 0.69 of it
    # for one segment.
    n_segments = 1 + (len(values) - segment) // (segment - segment // 2)
    floor: FloatArray = tail * (n_segments / float(scipy.special.gammaincinv(n_segments, 0.5)))
    return frequency_hz, power, floor


def _falls_to_the_end(frequency_hz: FloatArray, power: FloatArray) -> bool:
    """Whether the power of some joint still falls steeply towards half of the rate: as motion, not noise."""
    half_hz = frequency_hz[-1]
    lower = np.median(power[(frequency_hz > 0.5 * half_hz) & (frequency_hz <= 0.75 * half_hz)], axis=0)
    upper = np.median(power[frequency_hz > 0.75 * half_hz], axis=0)
    return bool(np.any(lower > _STEEP * upper))


def _top_of_motion(frequency_hz: FloatArray, power: FloatArray, floor: float) -> float:
    """Return the highest frequency of one joint's motion; 0 if it does not move.

    That is the highest loud line within reach of the strongest one, without a gap of more than an octave. A
    motion has gaps between its harmonics; what is loud far above them has another source, such as mains hum.
    """
    strongest_hz = frequency_hz[np.argmax(power)]
    loud_hz = frequency_hz[(power > _ABOVE_NOISE * floor) & (frequency_hz >= strongest_hz)]
    if not len(loud_hz) or strongest_hz > _FASTEST_MOTION_HZ:
        return 0.0
    gaps = np.flatnonzero(loud_hz[1:] > 2.0 * np.maximum(loud_hz[:-1], frequency_hz[1]))
    return float(loud_hz[gaps[0]] if len(gaps) else loud_hz[-1])
