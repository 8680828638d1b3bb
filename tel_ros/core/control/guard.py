"""What takes over from a controller that died or hangs: pure, fed with what it hears and a clock."""

from __future__ import annotations

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig, SafetyConfig
from tel_ros.core.control.holding import Hold, RestDetector
from tel_ros.core.errors import EffortError
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.springs import Springs
from tel_ros.core.types import FloatArray


class AwakeClock:
    """A clock that does not count the time in which its process stood still.

    A process that waits for a message cannot tell whether the sender is gone or it stood still itself (or the
    whole machine) with the message waiting outside. So a gap between two looks counts as one step at most.

    Times are those of a clock that only runs forward.
    """

    def __init__(self, longest_step_s: float, now_s: float) -> None:
        self._longest_step_s, self._looked_at_s = longest_step_s, now_s
        self.time_s = 0.0
        """Time spent awake."""

    def look(self, now_s: float) -> float:
        """Return the time spent awake."""
        self.time_s += min(max(now_s - self._looked_at_s, 0.0), self._longest_step_s)
        self._looked_at_s = now_s
        return self.time_s


class CommandGuard:
    """Listens, and brakes the arm when the commands stop although the last one was not zero.

    It is silent while commands come, before the first one, and after a command of zero effort, with which a
    controller ends in good order. After ``safety.command_timeout_s`` of silence it answers every new state:
    the same springs, brake and safety layer as the controller's bring the arm to rest, and then hold or
    release it (``safety.final_effort``). It yields to the first command that it hears. A command that is not
    finite or has another length counts as none.

    While it listens it learns from commands and states which effort holds the arm at rest. The arm's empty
    limits must have been filled from the URDF. Raises ConfigError: a value does not fit the arm.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig, safety: SafetyConfig) -> None:
        self._timeout_s = safety.command_timeout_s
        self._releases = safety.final_effort == "zero"
        self._n_joints = len(arm.joints)
        self._springs = Springs.of(arm)
        self.safety = SafetyLayer(arm, safety, control.rate_hz)
        """What every effort of the guard goes through."""
        self._hold = Hold()
        self._rest = RestDetector.of(control)
        self._heard_nm: FloatArray | None = None
        self._heard_at_s = 0.0
        self._last_ns: int | None = None
        self.active = False
        """Whether the guard has taken over."""
        self._releasing = False

    @property
    def at_final_effort(self) -> bool:
        """Whether nothing is left to do: the arm has its final effort, from here or from elsewhere."""
        if not self.active:
            return self._heard_nm is None or not self._heard_nm.any()
        if self._releases:
            return self._releasing and not self.safety.last_nm.any()
        return self._rest.is_over(self._last_ns or 0)

    def on_command(self, effort_nm: FloatArray, now_s: float) -> None:
        """Take in a command from another node, at a time of a monotonic clock; not the guard's own."""
        if effort_nm.shape == (self._n_joints,) and np.isfinite(effort_nm).all():
            self._heard_nm, self._heard_at_s = effort_nm.copy(), now_s
            self.active = False

    def on_state(self, state: ArmState, now_s: float) -> FloatArray | None:
        """Take in a measured state and return the effort to command in N·m; None: nothing is to be commanded.

        A state with the stamp of the last one is passed over.
        """
        if self._last_ns is not None and state.time_ns <= self._last_ns:
            if state.time_ns == self._last_ns:
                return None
            self._rest.begin(state.time_ns)
            if self.active:
                self._take_over(state)
        self._last_ns = state.time_ns
        self._rest.at_rest(state.time_ns, state.position_rad)
        if self._heard_nm is None:
            return None
        if not self.active:
            if now_s - self._heard_at_s < self._timeout_s:
                self._hold.load.add(state.time_ns, self._heard_nm)
                if self._rest.still:
                    self._hold.load.keep()
                return None
            if not self._heard_nm.any():
                return None
            self._take_over(state)
        return self._effort(state)

    def _take_over(self, state: ArmState) -> None:
        self._hold.begin()
        self._rest.begin(state.time_ns)
        self.active, self._releasing = True, False
        self.safety.none()

    def _effort(self, state: ArmState) -> FloatArray:
        self._releasing |= self._releases and self._rest.is_over(state.time_ns)
        if self._releasing:
            wanted = self.safety.fading(state.time_ns)
        else:
            equilibrium = self._hold.equilibrium(state, self._springs, self._rest.still)
            wanted = self._springs.effort(equilibrium, state.position_rad, state.velocity_rad_s)
        try:
            return self.safety.permit(state, wanted).effort_nm
        except EffortError:
            return self.safety.none().effort_nm
