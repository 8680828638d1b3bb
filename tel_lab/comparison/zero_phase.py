"""The filter Q of iterative learning: a low-pass without delay, for commands that are held at both ends."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tel_ros.core.types import FloatArray

_PADDING_PERIODS = 3.0
"""How far the command is held beyond both ends, in periods of the cutoff."""


def zero_phase(command_rad: FloatArray, cutoff_hz: float, period_s: float) -> FloatArray:
    """Return a command without its fast parts: Butterworth of order 2, forwards and backwards.

    Beyond both ends the command goes on at its first and last value, as the controller holds it.

    Args:
        command_rad: shape (n, n_joints).
        cutoff_hz: -3 dB of one pass; below half of the sampling rate.
        period_s: from row to row.
    """
    width = round(_PADDING_PERIODS / cutoff_hz / period_s)
    held = np.pad(command_rad, ((width, width), (0, 0)), mode="edge")
    filtered: FloatArray = sosfiltfilt(butter(2, cutoff_hz, fs=1.0 / period_s, output="sos"), held, axis=0)
    return filtered[width : len(filtered) - width]
