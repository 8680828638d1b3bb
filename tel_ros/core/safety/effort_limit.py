"""How strong an effort may be."""

from __future__ import annotations

import numpy as np

from tel_ros.core.config import ArmConfig
from tel_ros.core.safety.effort_range import EffortRange


def effort_limit(arm: ArmConfig) -> EffortRange:
    """Return the range of the configured effort limits."""
    limit_nm = np.array(arm.effort_limit_nm)
    return EffortRange(-limit_nm, limit_nm)
