"""The range of efforts of which several rules have the say, one value a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tel_ros.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class EffortRange:
    """What a rule permits. Shapes (n_joints,); ``low_nm`` is never above ``high_nm``."""

    low_nm: FloatArray
    high_nm: FloatArray

    def nearest(self, effort_nm: FloatArray) -> FloatArray:
        """Return the permitted effort next to a wanted one: the same to the last bit if it is permitted."""
        return np.minimum(np.maximum(effort_nm, self.low_nm), self.high_nm)
