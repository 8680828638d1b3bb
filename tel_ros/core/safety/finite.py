"""An effort that is not a number is a fault, and never a command."""

from __future__ import annotations

import numpy as np

from tel_ros.core.errors import EffortError
from tel_ros.core.types import FloatArray


def require_finite(effort_nm: FloatArray, n_joints: int) -> None:
    """Refuse efforts of another number, or that are not finite.

    Raises:
        EffortError: so it is. There is no permitted effort next to such a one.
    """
    if effort_nm.shape != (n_joints,) or not np.isfinite(effort_nm).all():
        raise EffortError(
            f"the wanted effort is {effort_nm.tolist()} N·m; expected {n_joints} finite numbers"
        )
