"""How wrong a learner was where it had to guess: the scale of its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tel_ros.core.types import FloatArray

_MEMORY = 0.5
"""What a test counts after the next one."""
_LEAST_LEVERAGE = 1e-12


@dataclass(frozen=True)
class Calibration:
    """Standard deviation of predictions from their leverage: std² = σ² + s² h(x), per joint.

    The leverage h = ψᵀ A⁻¹ ψ says where data are missing, but not how wrong the form of the model is. So s²
    is measured: each new trial is predicted before it is learned from, and s² is what its errors were in
    proportion to its leverage. σ² is what remains after fitting.

    Args:
        residual_rad2: σ². Shape (n_joints,).
        scale_rad2: s². Shape (n_joints,).
    """

    residual_rad2: FloatArray
    scale_rad2: FloatArray

    @classmethod
    def unknown(cls, n_joints: int) -> Self:
        """Return that of a learner without any experience: its errors may be anything."""
        return cls(np.full(n_joints, np.inf), np.full(n_joints, np.inf))

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray], n_joints: int) -> Self:
        """Return a calibration from its arrays.

        Raises:
            ValueError: they have the wrong shape or hold NaN or numbers below 0.
        """
        residual, scale = arrays["calibration_residual"], arrays["calibration_scale"]
        if residual.size == scale.size == 0:
            return cls.unknown(n_joints)
        for values in (residual, scale):
            if values.shape != (n_joints,) or not np.all(values >= 0.0):
                raise ValueError(f"a calibration is {values}; expected {n_joints} numbers of at least 0")
        return cls(residual, scale)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return it as arrays of finite numbers, empty if it is not known."""
        if not self.is_known:
            return {"calibration_residual": np.empty(0), "calibration_scale": np.empty(0)}
        return {"calibration_residual": self.residual_rad2, "calibration_scale": self.scale_rad2}

    @property
    def is_known(self) -> bool:
        """Whether there was a trial to measure it."""
        return bool(np.all(np.isfinite(self.residual_rad2)))

    def std(self, leverage: FloatArray) -> FloatArray:
        """Return standard deviations [rad] for leverages of shape (n, n_joints)."""
        if not self.is_known:
            return np.full(leverage.shape, np.inf)
        result: FloatArray = np.sqrt(self.residual_rad2 + self.scale_rad2 * leverage)
        return result

    def tested(self, error_rad: FloatArray, leverage: FloatArray, trust: FloatArray | None = None) -> Self:
        """Return it after a test: errors at samples that had not been learned from, shape (n, n_joints).

        Args:
            error_rad: shape (n, n_joints).
            leverage: likewise.
            trust: how far each sample is believed, likewise; None: all the same.
        """
        noise = np.where(np.isfinite(self.residual_rad2), self.residual_rad2, 0.0)
        excess = np.maximum(_mean(error_rad**2, trust) - noise, 0.0)
        found = excess / np.maximum(_mean(leverage, trust), _LEAST_LEVERAGE)
        before = np.where(np.isfinite(self.scale_rad2), self.scale_rad2, found)
        return replace(self, scale_rad2=_MEMORY * before + (1.0 - _MEMORY) * found)

    def fitted(self, residual_rad: FloatArray, leverage: FloatArray, trust: FloatArray | None = None) -> Self:
        """Return it after training: errors that remain at the samples that were learned from.

        Args:
            residual_rad: shape (n, n_joints).
            leverage: likewise.
            trust: how far each sample is believed, likewise; None: all the same.
        """
        residual = _mean(residual_rad**2, trust)
        # Before the first test the residual is all there is to go by.
        guess = residual / np.maximum(_mean(leverage, trust), _LEAST_LEVERAGE)
        scale = np.where(np.isfinite(self.scale_rad2), self.scale_rad2, guess)
        return replace(self, residual_rad2=residual, scale_rad2=scale)


def _mean(values: FloatArray, trust: FloatArray | None) -> FloatArray:
    """Return the weighted mean of each column. Shape (n_joints,)."""
    return np.asarray(np.average(values, axis=0, weights=trust), dtype=np.float64)
