"""Whether a recording can be what it says: rate, other publishers, positions and speeds of the URDF.

What cannot be is refused with its likely cause: such a recording is learned without an error, and wrongly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from tel_ros.core.arm_description import MOVABLE
from tel_ros.core.errors import InputFileError
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.types import FloatArray
from tel_ros.core.urdf import Joint, Urdf

LOWEST_HZ, HIGHEST_HZ = 30.0, 1000.0
"""Documented: docs/imported-bags.md."""
_HOPELESS_HZ, _TOO_FAST_HZ = 3.0, 20_000.0
_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_MIXED_SHARE, _MIXED_CHANGES, _JUMP_RAD = 0.02, 6, 0.02
_OUTSIDE = 0.1
"""Of a joint's range, and in rad: another zero of an encoder, or a limit of software."""
_TOO_FAST, _FAST_SHARE = 1.5, 0.02
"""Times the velocity limit; share of the samples."""
_SPEED_S = 0.02
_MANY_TURNS_RAD = 4.0 * np.pi


@dataclass(frozen=True)
class JointRange:
    """Within which position and below which speed a joint of a URDF stays; inf where it does not say."""

    low: float
    high: float
    velocity: float


_ANYWHERE = JointRange(-np.inf, np.inf, np.inf)


def joint_ranges(urdf: Urdf) -> dict[str, JointRange]:
    """Return the ranges of all movable joints, as far as the file tells them."""
    return {name: _range(urdf, joint) for name, joint in urdf.joints.items() if joint.kind in MOVABLE}


def _range(urdf: Urdf, joint: Joint) -> JointRange:
    try:
        names = ("lower", "upper", "velocity")
        low, high, speed = (urdf.numbers(joint.element, "limit", name, (0.0,))[0] for name in names)
    except InputFileError:  # whoever needs the limits refuses them
        low = high = speed = 0.0
    ends = (low, high) if low < high and joint.kind != "continuous" else (-np.inf, np.inf)
    return JointRange(*ends, speed or np.inf)


def require_plausible(recording: JointRecording, ranges: Mapping[str, JointRange]) -> list[str]:
    """Return what is to be doubted about a recording; InputFileError if it cannot be that of the arm."""
    _require_rate(recording)
    _require_one_publisher(recording)
    return [f"{recording.source}: {doubt}" for doubt in _doubts(recording, ranges)]


def _require_rate(recording: JointRecording) -> None:
    period = recording.median_period_s
    expected = f"{LOWEST_HZ:g} Hz to {HIGHEST_HZ / 1e3:g} kHz"
    if period == 0.0:
        raise InputFileError(recording.source, "has the same time in all samples", expected)
    rate_hz = 1.0 / period
    if _HOPELESS_HZ <= rate_hz <= _TOO_FAST_HZ:
        return
    unit = next((u for u, k in _UNITS.items() if 0.9 * LOWEST_HZ <= rate_hz * k <= 2.0 * HIGHEST_HZ), "")
    cause = f"are its times in {unit}? they have to be in s" if unit else "its times have to be in s"
    raise InputFileError(recording.source, f"has {rate_hz:.3g} samples a second", f"{expected}: {cause}")


def _require_one_publisher(recording: JointRecording) -> None:
    """Refuse positions that jump to one and the same value and back, time and again."""
    for joint, position in zip(recording.joints, recording.position_rad.T, strict=True):
        values, counts = np.unique(position, return_counts=True)
        if not len(values):
            continue
        constant = values[np.argmax(counts)]
        at = position == constant
        changes = np.flatnonzero(np.diff(at.astype(int)))
        if len(changes) < _MIXED_CHANGES or at.mean() <= _MIXED_SHARE:
            continue
        jumps, others = np.abs(np.diff(position))[changes], np.abs(np.diff(position[~at]))
        usual = float(np.median(others)) if len(others) else 0.0
        if np.median(jumps) > max(_JUMP_RAD, 10.0 * usual):
            found = f"{joint} is at {constant:g} in {at.sum()} of {len(at)} samples, between others"
            expected = "one source of joint states: does another node (joint_state_publisher?) publish there?"
            raise InputFileError(recording.source, found, expected)


def _doubts(recording: JointRecording, ranges: Mapping[str, JointRange]) -> Iterator[str]:
    rate_hz = 1.0 / recording.median_period_s
    if rate_hz < 0.95 * LOWEST_HZ:
        yield f"{rate_hz:.3g} samples a second are fewer than the {LOWEST_HZ:g} that it takes"
    degrees, outside = list[str](), list[str]()
    for joint, position in zip(recording.joints, recording.position_rad.T, strict=True):
        known = ranges.get(joint, _ANYWHERE)
        said = f"{joint} from {position.min():.3g} to {position.max():.3g}"
        if _is_outside(position, known):
            fits = not _is_outside(np.deg2rad(position), known)
            fits = fits and np.abs(position).max() > 2.0 * max(abs(known.low), abs(known.high))
            (degrees if fits else outside).append(f"{said}, the URDF has {known.low:.3g} to {known.high:.3g}")
        elif np.isinf(known.high) and np.abs(position).max() > _MANY_TURNS_RAD:
            yield f"{said} rad are many turns: are they degrees?"
    if degrees and not outside:
        found = f"has positions that are no rad ({'; '.join(degrees)})"
        raise InputFileError(recording.source, found, "rad: are they in degrees?")
    if outside:
        said = "; ".join(outside + degrees)
        yield f"positions outside of the URDF's range ({said}): another arm, or another zero?"
    for joint in recording.joints:
        allowed = ranges.get(joint, _ANYWHERE).velocity
        if speed := _too_fast(recording, joint, allowed):
            found = f"{joint} moves at {speed:.3g} rad/s, the URDF allows {allowed:.3g}"
            sought = "positions in rad and times in s of one arm: are they, and is there only one publisher?"
            raise InputFileError(recording.source, found, sought)


def _is_outside(position: FloatArray, known: JointRange) -> bool:
    spare = max(_OUTSIDE, _OUTSIDE * (known.high - known.low)) if np.isfinite(known.high) else 0.0
    return bool(position.min() < known.low - spare or position.max() > known.high + spare)


def _too_fast(recording: JointRecording, joint: str, allowed: float) -> float:
    """Return a speed that too many samples have, or 0."""
    position = recording.position_rad[:, recording.joints.index(joint)]
    period_s = recording.median_period_s
    # Across some time, because of noise; an odd number of samples, because two publishers may take turns.
    n = 2 * round(_SPEED_S / period_s / 2.0) + 1
    step_s = np.maximum(recording.time_s[n:] - recording.time_s[:-n], 0.5 * n * period_s)
    speed = np.abs(position[n:] - position[:-n]) / step_s
    if len(speed) and np.mean(speed > _TOO_FAST * allowed) > _FAST_SHARE:
        return float(np.quantile(speed, 1.0 - _FAST_SHARE))
    return 0.0
