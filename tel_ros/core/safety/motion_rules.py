"""Safety rules about motion: soft joint limits, velocity limits and the distance that braking takes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, SafetyConfig
from tel_ros.core.safety.rules import ANY_EFFORT, EffortRange, LastEffort, QuietBounds, SafetyRule
from tel_ros.core.types import NS_PER_S, FloatArray

LEAST_DAMPING_S = 0.05
"""Default k_velocity as a share of K, for joints with little damping of their own."""
DAMPING_FACTOR = 2.0
"""Default k_velocity as a multiple of B."""
WALL_STIFFNESS = 4.0
"""Default k_position · k_velocity, the stiffness of a soft limit, as a share of K."""
BEYOND_FACTOR = 2.0
"""How many times k_position counts beyond a soft limit."""
LARGEST_MARGIN_RAD = 0.1
MARGIN_SHARE = 0.025
"""Default distance of soft from hard limit: this share of the range, at most the largest margin."""
LEADING_SHARE = 0.05
"""How fast a soft limit goes back to its place: this share of the joint's velocity limit."""
LEAST_DAMPING_RATIO = 0.3
"""Of the springs with the arm stretched out, as docs/real-arm.md asks for: it bounds the inertia to brake."""
BRAKING_SHARE = 0.5
"""Default deceleration: what this share of the effort limit gives that inertia."""
CREEP_SHARE = 0.1
"""Up to this share of its velocity limit the soft walls alone stop a joint."""
BRAKING_GAIN = 10.0
"""A joint that is too fast is braked with this many times the soft walls' damping."""
BRAKING_BAND = 0.15
"""This share above the speed that can still be braked, no effort is left towards the limit."""
_FAR_RAD = 1e9


def largest_inertia(arm: ArmConfig) -> FloatArray:
    """Return the largest inertia in kg·m² that each joint can have, as its springs tell. Shape (n_joints,).

    K and B damp an inertia I with the ratio ζ = B / (2 √(K I)): with ζ of at least 0.3 it is B² / (0.36 K).
    """
    stiffness = np.array(arm.stiffness_nm_per_rad)
    damping = np.maximum(np.array(arm.damping_nms_per_rad), LEAST_DAMPING_S * stiffness)
    inertia: FloatArray = damping**2 / ((2.0 * LEAST_DAMPING_RATIO) ** 2 * stiffness)
    return inertia


def soft_range(arm: ArmConfig, safety: SafetyConfig) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper soft limits in rad. Shapes (n_joints,)."""
    low, high = np.array(arm.position_min_rad), np.array(arm.position_max_rad)
    margin = np.minimum(MARGIN_SHARE * (high - low), LARGEST_MARGIN_RAD)
    if safety.soft_margin_rad:
        margin = np.array(safety.soft_margin_rad)
    return low + margin, high - margin


@dataclass
class SoftLimits:
    """Soft joint limits: stiff, damped walls, and the speed that no effort may exceed.

    On an arm that fell while nobody commanded it, and now leans against the end of its range, a wall would
    act at once with all that it is compressed by: up to 300 N·m on a joint of the simulated iiwa, which was
    thrown inside with 2.6 rad/s. So a limit acts where the joint is found, and leads it back from there;
    while the motors do not act it waits (:meth:`find` again). Limits may be infinite. Shapes (n_joints,).
    """

    low_rad: FloatArray
    high_rad: FloatArray
    k_position_per_s: FloatArray
    k_velocity_nms_per_rad: FloatArray
    top_speed_rad_s: FloatArray
    """Above the speed at which a trial is aborted: a joint that moves at nearly that still needs effort."""
    leading_rad_s: FloatArray
    """Speed at which a limit goes back to its place."""
    _shift_rad: FloatArray | None = field(default=None, init=False)
    _since_ns: int = field(default=0, init=False)

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig) -> SoftLimits:
        """Return the soft limits of an arm whose empty fields have been filled from its URDF."""
        stiffness, damping = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)
        k_velocity = np.maximum(DAMPING_FACTOR * damping, LEAST_DAMPING_S * stiffness)
        if safety.k_velocity_nms_per_rad:
            k_velocity = np.array(safety.k_velocity_nms_per_rad)
        k_position = np.array(safety.k_position_per_s or WALL_STIFFNESS * stiffness / k_velocity)
        velocity = np.array(arm.velocity_limit_rad_s)
        top_speed = (1.0 + safety.velocity_margin) * velocity
        return cls(*soft_range(arm, safety), k_position, k_velocity, top_speed, LEADING_SHARE * velocity)

    @property
    def reach_rad(self) -> FloatArray:
        """Distance from which on the wall slows a joint, whatever its speed within the limit."""
        return self.top_speed_rad_s / self.k_position_per_s

    @property
    def lead(self) -> bool:
        """Whether a soft limit is not in its place."""
        return self._shift_rad is not None

    def find(self, time_ns: int, position_rad: FloatArray) -> None:
        """Take in where an arm is that its motors have not held until now. Shape (n_joints,)."""
        shift_rad = position_rad - np.clip(position_rad, self.low_rad, self.high_rad)
        self._shift_rad, self._since_ns = (shift_rad if shift_rad.any() else None), time_ns

    def seen(self, state: ArmState) -> FloatArray:
        """Return the position to compare with the limits in their places. Shape (n_joints,)."""
        if self._shift_rad is None:
            return state.position_rad
        step_rad = self.leading_rad_s * max(0.0, (state.time_ns - self._since_ns) / NS_PER_S)
        shift_rad = np.sign(self._shift_rad) * np.maximum(np.abs(self._shift_rad) - step_rad, 0.0)
        if not shift_rad.any():
            self._shift_rad = None
        seen_rad: FloatArray = state.position_rad - shift_rad
        return seen_rad


@dataclass(frozen=True)
class BrakingDistance(SafetyRule):
    """Takes the effort away from a joint that comes too fast to a soft limit, and brakes it.

    Within a distance d of a soft limit, a joint that can be braked with the deceleration a may be as fast as
    √(2 a d). Up to that speed its effort is free. Above it there is less and less effort towards the limit,
    and then effort away from it, up to all that there is.

    The default of a takes the springs' word for the inertia (:func:`largest_inertia`).
    """

    limits: SoftLimits
    creep_rad_s: FloatArray
    """Speed that is always allowed."""
    deceleration_rad_s2: FloatArray
    """a."""
    gain_nms_per_rad: FloatArray
    """Effort against each rad/s that a joint is too fast."""
    effort_limit_nm: FloatArray
    """What there is to brake with."""

    @classmethod
    def of(cls, arm: ArmConfig, safety: SafetyConfig, limits: SoftLimits) -> BrakingDistance:
        """Return the rule for a configured arm whose empty fields have been filled from its URDF."""
        effort = np.array(arm.effort_limit_nm)
        deceleration = np.array(safety.deceleration_rad_s2 or BRAKING_SHARE * effort / largest_inertia(arm))
        creep = CREEP_SHARE * np.array(arm.velocity_limit_rad_s)
        gain = BRAKING_GAIN * limits.k_velocity_nms_per_rad
        return cls(limits, creep, deceleration, gain, effort)

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return the efforts that a measured state permits; infinite where there is nothing to brake."""
        velocity_rad_s = state.velocity_rad_s
        speed = np.abs(velocity_rad_s)
        # Most ticks end here or below: this is in the control loop.
        if (speed <= self.creep_rad_s).all():
            return ANY_EFFORT
        position_rad = self.limits.seen(state)
        upward = velocity_rad_s > 0.0
        room = np.where(upward, self.limits.high_rad - position_rad, position_rad - self.limits.low_rad)
        fastest = self.fastest(np.minimum(np.maximum(room, 0.0), _FAR_RAD))
        too_fast = speed > fastest
        if not too_fast.any():
            return ANY_EFFORT
        gain, limit = self.gain_nms_per_rad, self.effort_limit_nm
        braking = gain * (fastest - speed) + np.minimum(limit, gain * BRAKING_BAND * fastest)
        outward = np.where(too_fast, np.maximum(braking, -limit), np.inf)
        return EffortRange(np.where(upward, -np.inf, -outward), np.where(upward, outward, np.inf))

    def quiet(self) -> QuietBounds:
        """Return the speed that can be braked from where the walls begin to act."""
        low, high, room = self.limits.low_rad, self.limits.high_rad, self.limits.reach_rad
        return QuietBounds(low_rad=low + room, high_rad=high - room, speed_rad_s=self.fastest(room))

    def fastest(self, room_rad: FloatArray) -> FloatArray:
        """Return how fast a joint may be so far from a soft limit. Shapes (…, n_joints)."""
        fastest: FloatArray = np.sqrt(2.0 * self.deceleration_rad_s2 * room_rad) + self.creep_rad_s
        return fastest


@dataclass(frozen=True)
class MotionLimits(SafetyRule):
    """Bounds the effort so that joints stay within soft limits and below a speed.

    The rule is that of the PR2's safety controller and of ros2_control's soft joint limits. A joint may move
    outward at v_max = k_position (q_soft − q) at most, and at v_limit at most, and the effort that may drive
    it outward is k_velocity (v_max − v); the same the other way round for the lower limit. Where that is
    negative it has to brake or to push back, whatever the command is. Two things are ours: beyond a soft
    limit k_position counts :data:`BEYOND_FACTOR` times, so that a weight cannot press far into it; and
    v_limit is above the speed at which a trial is aborted.

    By default k_position · k_velocity = 4 K and k_velocity = 2 B: no command can pull harder than springs
    would that are four times as stiff, have twice the damping and their equilibrium point at the soft limit.
    Gains that follow those of the arm's own springs suit heavy and light joints alike. Such a wall stops what
    is slow; what is fast is braked before (:class:`BrakingDistance`).

    Sources: wiki.ros.org/pr2_controller_manager/safety_limits; urdf::JointSafety;
    joint_limits/src/joint_soft_limiter.cpp of ros2_control.
    """

    limits: SoftLimits

    def permitted(self, state: ArmState, last: LastEffort) -> EffortRange:
        """Return the efforts that a measured state permits; not bounded by what the motors can do."""
        position_rad = self.limits.seen(state)
        up = self.fastest_outward(self.limits.high_rad - position_rad)
        down = self.fastest_outward(position_rad - self.limits.low_rad)
        k = self.limits.k_velocity_nms_per_rad
        return EffortRange(k * (-down - state.velocity_rad_s), k * (up - state.velocity_rad_s))

    def quiet(self) -> QuietBounds:
        """Return where all of v_limit is free, so that the rule asks for abs(τ + k v) ≤ k v_limit alone."""
        limits, k = self.limits, self.limits.k_velocity_nms_per_rad
        return QuietBounds(
            low_rad=limits.low_rad + limits.reach_rad,
            high_rad=limits.high_rad - limits.reach_rad,
            damping_nms_per_rad=k,
            damped_nm=k * limits.top_speed_rad_s,
        )

    def fastest_outward(self, room_rad: FloatArray) -> FloatArray:
        """Return v_max so far from a soft limit. Shapes (…, n_joints)."""
        top_speed = self.limits.top_speed_rad_s
        speed = self.limits.k_position_per_s * np.minimum(room_rad, BEYOND_FACTOR * room_rad)
        return np.minimum(np.maximum(speed, -top_speed), top_speed)
