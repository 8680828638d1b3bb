"""Learning lock-up: the training error falls and the tracking error does not ([Practice] Sec. 1 and 2.1)."""

from __future__ import annotations

import math
from typing import NamedTuple

from tel_ros.core.errors import ConfigError

_TRIALS = 3
"""At the same α, before anything is said: fewer cannot tell a standstill from chance."""
_HARDLY = 0.9
"""An error above this share of an earlier one has hardly fallen."""
_GROWN = 1.1
"""An error above this multiple of an earlier one has grown."""
_CLEARLY = 0.7
"""A training error below this share of an earlier one has clearly fallen."""
_CONTENT = 0.5
_VERY_CONTENT = 0.25
"""A training error below this share of the tracking error does not see it: in slow movements the springs make
about 1 rad of tracking error out of 1 rad of command error, which is what the training error should tell."""


class _Trial(NamedTuple):
    alpha: float
    error_rad: float
    training_before_rad: float
    training_after_rad: float


class LockUpMonitor:
    """Watches for practice that leads nowhere, and says so in words.

    Two things are told apart, both over three successive trials at the same α whose tracking errors are all
    above the tolerance:

    - *lock-up*: the training error û - N(ŷ) has fallen, or is small, and the tracking error stays. The
      network is right where the arm goes and wrong where it should go; in Theorem 1, k_R is near 1.
    - *divergence*: the tracking error grows from trial to trial: k_R is above 1.

    Silent are: speeds that rise, as they do in Trajectory Extension; errors within the tolerance, however
    they vary; slow progress, of 10 % and more in three trials; and a network that cannot get any better,
    whose training error stays as high as the tracking error.

    ``tolerance_rad`` is the tracking error (RMS) that is good enough; ConfigError unless finite and above 0.
    """

    def __init__(self, tolerance_rad: float) -> None:
        if not 0.0 < tolerance_rad < math.inf:
            raise ConfigError("tolerance_rad", tolerance_rad, "a finite angle above 0 rad")
        self._tolerance_rad = tolerance_rad
        self._trials: list[_Trial] = []

    def after_trial(
        self, alpha: float, rms_error_rad: float, training_before_rad: float, training_after_rad: float
    ) -> str:
        """Take in one trial and return what there is to say; empty: nothing.

        A trial that told nothing, because it did not reach its movement or nothing was learned from it, is
        passed over: give NaN. The training errors are the RMS of û - N(ŷ) before and after training.
        """
        trial = _Trial(alpha, rms_error_rad, training_before_rad, training_after_rad)
        if not all(map(math.isfinite, trial[1:])):
            return ""
        if self._trials and not math.isclose(alpha, self._trials[-1].alpha, rel_tol=1e-9):
            self._trials.clear()
        self._trials = [*self._trials, trial][-_TRIALS:]
        if len(self._trials) < _TRIALS or any(t.error_rad <= self._tolerance_rad for t in self._trials):
            return ""
        return self._lock_up() or self._divergence()

    def _lock_up(self) -> str:
        first, last = self._trials[0], self._trials[-1]
        content = last.training_before_rad <= _CONTENT * last.error_rad
        fell = last.training_before_rad <= _CLEARLY * first.training_before_rad
        small = last.training_before_rad <= _VERY_CONTENT * last.error_rad
        if last.error_rad < _HARDLY * first.error_rad or not content or not (fell or small):
            return ""
        return (
            f"learning lock-up: in {_TRIALS} trials at α = {last.alpha:.3f} the tracking error went from "
            f"{_mrad(first.error_rad)} to {_mrad(last.error_rad)}, the training error from "
            f"{_mrad(first.training_before_rad)} to {_mrad(last.training_before_rad)} (after training "
            f"{_mrad(last.training_after_rad)}). The network is right where the arm goes, but not where it "
            "should go. Go back to a slower movement and take smaller steps, or use wider Gaussians; and see "
            "whether efforts are clipped."
        )

    def _divergence(self) -> str:
        first, *later = self._trials
        last = later[-1]
        grown = all(trial.error_rad >= _GROWN * first.error_rad for trial in later)
        if not grown or last.error_rad < _HARDLY * max(trial.error_rad for trial in later):
            return ""
        return (
            f"learning diverges: in {_TRIALS} trials at α = {last.alpha:.3f} the tracking error went from "
            f"{_mrad(first.error_rad)} to {_mrad(last.error_rad)}. What is learned makes it worse. Go back "
            "to a slower movement and take smaller steps, or use actual trajectory training."
        )


def _mrad(angle_rad: float) -> str:
    return f"{1e3 * angle_rad:.3g} mrad"
