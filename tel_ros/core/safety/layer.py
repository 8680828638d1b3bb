"""The layer through which every effort goes before it may reach an arm, whoever computed it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.errors import EffortError
from tel_ros.core.safety.braking_distance import BrakingDistance
from tel_ros.core.safety.drive_response import DriveResponse
from tel_ros.core.safety.effort_limit import effort_limit
from tel_ros.core.safety.effort_rate import EffortRate
from tel_ros.core.safety.finite import require_finite
from tel_ros.core.safety.free_zone import FreeZone
from tel_ros.core.safety.late_states import AGE_COUNTS, LEAST_SHARE, punctual_s, share_of_effort
from tel_ros.core.safety.led_back import LedBack
from tel_ros.core.safety.motion_limits import MotionLimits
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

LONGEST_GAP_S = 0.1
"""After this long without a command an arm has no effort (docs/arm-contract.md, Silence)."""
_MOST_PERIODS = 2.0


class Permitted(NamedTuple):
    """What the layer made of a wanted effort. Shapes (n_joints,)."""

    effort_nm: FloatArray
    changed: BoolArray


class SafetyLayer:
    """Makes a wanted effort one that the arm may get: at once, from the measured state and the last effort.

    The rules, each of which wins over those before it: how fast efforts grow
    (:class:`~tel_ros.core.safety.effort_rate.EffortRate`), the speed at which joints may come to their limits
    (:class:`~tel_ros.core.safety.braking_distance.BrakingDistance`), soft joint limits and velocity limits
    (:class:`~tel_ros.core.safety.motion_limits.MotionLimits`), effort limits, less effort when states come
    late (:func:`~tel_ros.core.safety.late_states.share_of_effort`). An effort that no rule
    objects to passes unchanged, to the last bit.

    Args:
        arm: joints, springs and limits; its empty limits must have been filled from the URDF.
        safety: the rules' numbers; what is empty is derived from the arm.
        rate_hz: of states and commands.

    Raises:
        ConfigError: a value does not fit the arm.
    """

    def __init__(self, arm: ArmConfig, safety: SafetyConfig, rate_hz: float) -> None:
        safety.require_fits(arm)
        self.rate = EffortRate.of(arm, safety)
        self.braking = BrakingDistance.of(arm, safety)
        self.motion = MotionLimits.of(arm, safety)
        self._led_back = LedBack.of(arm, self.motion)
        self.limit = effort_limit(arm)
        self.response = DriveResponse.of(arm, safety)
        """Whether the motors exert what is permitted."""
        self._period_s = 1.0 / rate_hz
        self._free = FreeZone.of(self.rate, self.braking, self.motion, self.limit, self._period_s)
        self._punctual_ns = round(min(punctual_s(self._period_s), LONGEST_GAP_S) * NS_PER_S) - 1
        self._n_joints = len(arm.joints)
        self._last_ns: int | None = None
        self.last_nm = np.zeros(self._n_joints)
        """What the arm was last permitted. Shape (n_joints,)."""
        self._nothing_changed = np.zeros(self._n_joints, dtype=bool)
        self._nothing_changed.flags.writeable = False

    @property
    def last_command(self) -> FloatArray:
        """What an arm that takes efforts is to get."""
        return self.last_nm

    def _elapsed_s(self, time_ns: int) -> float:
        """Return for how long efforts may have grown since the last one: two periods at most."""
        if self._last_ns is None:
            return self._period_s
        return min((time_ns - self._last_ns) / NS_PER_S, _MOST_PERIODS * self._period_s)

    def permit(self, state: ArmState, wanted_nm: FloatArray) -> Permitted:
        """Return the effort that may be commanded in answer to a state.

        After a gap, or stamps that went back, nobody knows what has acted on the arm; and while a motor does
        not act (:attr:`response`), it is known that nothing has. Efforts grow from zero then, and a joint
        that is beyond a soft limit is led back (:class:`~tel_ros.core.safety.led_back.LedBack`).

        Args:
            state: as measured.
            wanted_nm: shape (n_joints,).

        Raises:
            EffortError: the effort is not finite. The last one is zero from then on, and that is what is to
                be commanded: :meth:`none`.
        """
        self.response.look(state.time_ns, self.last_nm, state.effort_nm)
        if self._is_free(state, wanted_nm):
            self._last_ns, self.last_nm = state.time_ns, wanted_nm
            return Permitted(wanted_nm, self._nothing_changed)
        try:
            require_finite(wanted_nm, self._n_joints)
        except EffortError:
            self.none()
            raise
        gap = self._last_ns is not None and not 0 < state.time_ns - self._last_ns <= LONGEST_GAP_S * NS_PER_S
        if gap or self.response.fault:
            self.none()
        if self._last_ns is None or (self._led_back.leads and self._motors_wait(state)):
            self._led_back.find(state.time_ns, state.position_rad)
        position_rad = self._led_back.seen_from_limits(state.time_ns, state.position_rad)
        effort_nm = self.rate.permitted(self.last_nm, self._elapsed_s(state.time_ns)).nearest(wanted_nm)
        effort_nm = self.braking.permitted(position_rad, state.velocity_rad_s).nearest(effort_nm)
        effort_nm = self.motion.permitted(position_rad, state.velocity_rad_s).nearest(effort_nm)
        effort_nm = self.limit.nearest(effort_nm)
        effort_nm = self.share_for(state) * effort_nm
        self._last_ns, self.last_nm = state.time_ns, effort_nm
        return Permitted(effort_nm, effort_nm != wanted_nm)

    def share_for(self, state: ArmState) -> float:
        """Return which share of an effort may act in answer to a state, for its being late."""
        last_ns = self._last_ns
        since_last_s = self._period_s if last_ns is None else (state.time_ns - last_ns) / NS_PER_S
        return share_of_effort(since_last_s, self._period_s, state.age_s)

    def _motors_wait(self, state: ArmState) -> bool:
        """Return whether what is permitted hardly reaches the arm: late states, or a driver that refuses."""
        return self.share_for(state) < LEAST_SHARE or self.response.is_overdue(state.time_ns)

    def _is_free(self, state: ArmState, wanted_nm: FloatArray) -> bool:
        """Return whether no rule has anything to say about an effort, as far as one test tells."""
        if self._last_ns is None or wanted_nm.shape != self.last_nm.shape or self.response.fault:
            return False
        since_last_ns = state.time_ns - self._last_ns
        if since_last_ns < self._free.shortest_ns:
            return False
        if since_last_ns + AGE_COUNTS * state.age_s * NS_PER_S > self._punctual_ns:
            return False
        return self._free.has(state, wanted_nm, self.last_nm)

    def fading(self, time_ns: int) -> FloatArray:
        """Return the effort to want for the last one to fade to zero. Shape (n_joints,)."""
        return self.rate.towards_zero(self.last_nm, self._elapsed_s(time_ns))

    def permit_pulse(self, wanted_nm: FloatArray) -> Permitted:
        """Return the effort of a pulse, within the effort limits.

        The rules about motion would soften it, and what an arm does then would be judged wrongly. Narrower
        bounds hold it: :mod:`tel_ros.core.check.pulses`.

        Args:
            wanted_nm: shape (n_joints,).

        Raises:
            EffortError: it is not finite, as for :meth:`permit`.
        """
        self.none()
        require_finite(wanted_nm, self._n_joints)
        self.last_nm = self.limit.nearest(wanted_nm)
        return Permitted(self.last_nm, self.last_nm != wanted_nm)

    def none(self) -> Permitted:
        """Return no effort, and remember that there is none; zero is always permitted."""
        self._last_ns, self.last_nm = None, np.zeros(self._n_joints)
        return Permitted(self.last_nm, np.ones(self._n_joints, dtype=bool))
