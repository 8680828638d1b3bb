"""Array types shared by the core."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

NS_PER_S = 1_000_000_000


def evenly_spaced(n: int, most: int) -> IntArray:
    """Return which of n items to take for at most ``most`` of them, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int))
