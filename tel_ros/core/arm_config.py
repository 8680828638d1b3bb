"""The part of the configuration that belongs to an arm: what it is, its control, safety and simulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tel_ros.core.config_fields import (
    Checked,
    Factor,
    Finite,
    NonNegative,
    Positive,
    Range,
    TextFile,
)
from tel_ros.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ArmConfig(Checked):
    """An arm and the virtual springs that drive it."""

    name: str
    """For people to read."""
    urdf: TextFile = ""
    """File with the kinematics and limits; the simulated arm takes its dynamics from it as well. Empty: from
    the topic ``robot_description``."""
    joints: tuple[str, ...]
    """Names of the joints to move, in the order of every array and of the effort command."""
    hand_link: str
    """Link whose path is drawn in reports."""
    held: dict[str, float] = field(default_factory=dict)
    """Where joints of the URDF that ``joints`` does not name are held, rad or m. Others: as near to 0 as they
    can be, and those that mimic a joint follow it. Not a ROS parameter."""
    stiffness_nm_per_rad: tuple[Positive, ...]
    """K of the EP control law ([Practice] Sec. 3: 15)."""
    damping_nms_per_rad: tuple[NonNegative, ...]
    """B of the EP control law ([Practice] Sec. 3: 1.5)."""
    effort_limit_nm: tuple[Positive, ...]
    """Commands are clipped to it."""
    position_min_rad: tuple[Finite, ...] = ()
    """Empty: from the URDF."""
    position_max_rad: tuple[Finite, ...] = ()
    """Empty: from the URDF."""
    velocity_limit_rad_s: tuple[Positive, ...] = ()
    """A faster joint aborts the trial. Empty: from the URDF."""
    command_interface: Literal["effort", "position", "trajectory"] = "effort"
    """``effort``: the arm takes efforts. ``position``: its drives are the springs and dampers, with the
    stiffness and damping above, and take equilibrium points. ``trajectory``: they are the gains p and d of a
    ``joint_trajectory_controller``, which takes whole trials as trajectories with efforts."""
    trajectory_controller: str = "joint_trajectory_controller"
    """``trajectory``: name of that controller; relative to the namespace."""
    controller_rate_hz: NonNegative = 0.0
    """``trajectory``: update rate of its controller_manager. 0: ``control.rate_hz``."""
    set_point_speed_rad_s: tuple[Positive, ...] = ()
    """``position``: speed limit of the equilibrium points that are sent. Empty: ``velocity_limit_rad_s``."""

    def __post_init__(self) -> None:
        self.require(len(self.joints) > 0, "joints", "at least one joint name")
        self.require(len(set(self.joints)) == len(self.joints), "joints", "each joint once")
        super().__post_init__()
        self.require_one_per_joint(self.joints)
        if self.position_min_rad and self.position_max_rad:
            ends = zip(self.position_min_rad, self.position_max_rad, strict=True)
            expected = f"above {list(self.position_min_rad)}"
            self.require(all(low < high for low, high in ends), "position_max_rad", expected)


@dataclass(frozen=True, kw_only=True)
class ControlConfig(Checked):
    """The control loop and what makes it stop a trial."""

    rate_hz: Positive = 500.0
    """Rate of joint states and commands, and of the points of trajectories."""
    path_tolerance_rad: Positive = 1.0
    """A joint further than this from its desired position aborts the trial."""
    approach_speed_rad_s: Positive = 0.5
    """Peak speed of the fastest joint on the way to the start posture."""
    settle_speed_rad_s: Positive = 0.05
    """Slower than this counts as at rest."""
    settle_time_s: Positive = 0.5
    """How long the arm must be at rest before a trial runs, and before a trial counts as finished."""
    settle_timeout_s: Positive = 10.0
    """Not at rest after this: the trial is aborted."""
    state_timeout_s: Positive = 0.1
    """No new joint state for this long (wall clock) aborts the trial and commands zero effort."""
    velocity_filter_hz: Positive = 100.0
    """Low-pass of velocities that are estimated from positions, for joints whose joint states carry no
    velocity. Lower for coarse encoders."""
    max_stiffness_factor: Factor = 10.0
    """A trial is refused if its springs are more than this many times as stiff or as damped as the arm's, or
    less than one in this many."""
    realtime_priority: Annotated[int, Range(0, 98)] = 0  # 99 is for what the kernel itself cannot wait for
    """SCHED_FIFO priority of the controller and the simulated arm, where permitted; 0: not used."""
    lock_memory: bool = False
    """Keep the memory of the same nodes from being swapped out, where permitted."""

    def __post_init__(self) -> None:
        super().__post_init__()
        expected = f"a finite time above settle_time_s = {self.settle_time_s} s"
        self.require(self.settle_time_s < self.settle_timeout_s, "settle_timeout_s", expected)


@dataclass(frozen=True, kw_only=True)
class SafetyConfig(Checked):
    """The layer through which every effort goes before it reaches the arm: docs/safety.md."""

    effort_rate_nm_per_s: tuple[Positive, ...] = ()
    """How fast an effort may grow. Empty: from one effort limit to the opposite one in 20 ms."""
    soft_margin_rad: tuple[NonNegative, ...] = ()
    """How far inside the position limits a joint is held back. Empty: 2.5 % of its range, at most 0.1 rad."""
    k_position_per_s: tuple[Positive, ...] = ()
    """Allowed speed towards a soft limit for each rad of distance. Empty: 4 K / ``k_velocity``."""
    k_velocity_nms_per_rad: tuple[Positive, ...] = ()
    """Effort against each rad/s above the allowed speed. Empty: 2 B, and at least 0.05 s times K."""
    deceleration_rad_s2: tuple[Positive, ...] = ()
    """Deceleration at which a joint can be braked: one that comes to a soft limit too fast for it is braked.
    Empty: half the effort limit on the inertia that K and B damp with a ratio of 0.3."""
    velocity_margin: NonNegative = 0.25
    """A joint this share above its velocity limit is braked, whatever the command."""
    final_effort: Literal["zero", "hold"] = "zero"
    """What an arm gets after an emergency stop, or at the end of the run, once it is at rest."""
    guard: Literal["external", "always", "never"] = "external"
    """When a process of its own watches the commands. ``external``: with ``run.arm: external``."""
    command_timeout_s: Positive = 0.05
    """Silence of the controller after which the guard brakes the arm."""
    clock_drift: Annotated[float, Range(0.0, 1.0)] = 0.001
    """How much slower than the wall clock the clock of the joint states may run, as a share: states that come
    later than that explains get less effort. 1: never, for a simulator that is slower than real time."""
    watch_drives: bool = True
    """Whether a trial is aborted when the efforts that the arm reports show a motor that does not act. False:
    for drives whose reports cannot be trusted."""
    stiction_nm: tuple[Positive, ...] = ()
    """Effort under which a joint may stick: readings that stand still beyond it are taken for frozen. Empty:
    5 % of the effort limit, and at least 1.5 times the dry friction in the URDF, or of the simulated arm."""

    def require_fits(self, arm: ArmConfig) -> None:
        """Refuse values that do not fit an arm whose empty limits have been filled from its URDF.

        Raises ConfigError: another number of values than joints, or soft limits that leave no range.
        """
        self.require_one_per_joint(arm.joints, "safety.")
        if not (self.soft_margin_rad and arm.position_min_rad and arm.position_max_rad):
            return
        room = [high - low for low, high in zip(arm.position_min_rad, arm.position_max_rad, strict=True)]
        if not all(2.0 * margin < r for margin, r in zip(self.soft_margin_rad, room, strict=True)):
            expected = f"less than half of each joint's range of {room} rad"
            raise ConfigError("safety.soft_margin_rad", list(self.soft_margin_rad), expected)


@dataclass(frozen=True, kw_only=True)
class SimConfig(Checked):
    """The simulated arm. Nothing here reaches a real one."""

    clock: Literal["lockstep", "realtime"] = "lockstep"
    """``lockstep`` waits for each command and runs as fast as the graph can; ``realtime`` is paced."""
    physics_rate_hz: Positive = 4000.0
    """Rate of the simulation's own steps, a whole multiple of ``control.rate_hz``."""
    encoder_bits: Annotated[int, Range(0, 32)] = 16
    """Positions are read in steps of 2π / 2^bits, 8 bits or more; 0: exact."""
    position_noise_rad: NonNegative = 0.0
    """Standard deviation of white noise on each position reading."""
    velocity_filter_hz: NonNegative = 100.0
    """Low-pass of the velocity that is made from successive position readings; 0: none."""
    command_delay_s: NonNegative = 0.0
    """Time from a command to its effect, a whole multiple of the control period."""
    drive_stiffness_scale: Positive = 1.0
    """``arm.command_interface: position``: factor on K of the simulated drives, to make them differ from the
    description of the arm."""
    payload_kg: NonNegative = 0.0
    """Point mass at the hand link."""
    inertia_scale: Positive = 1.0
    """Factor on all masses and inertias."""
    viscous_friction_nms_per_rad: tuple[NonNegative, ...] = ()
    """Empty: the damping in the URDF."""
    coulomb_friction_nm: tuple[NonNegative, ...] = ()
    """Empty: the friction in the URDF."""
    initial_position_rad: tuple[Finite, ...] = ()
    """Empty: the middle of each joint's range."""
    watchdog_s: Annotated[float, Range(0.0, 0.1, above=True)] = 0.1
    """Silence on the command topic after which the effort goes to zero (arm time). Position drives hold their
    last set point instead."""
    command_age_limit_s: NonNegative = 0.0
    """Commands that answer a state this much older than the newest are not applied (real time); 0: all are.
    Only a driver can tell late commands: docs/arm-contract.md."""
    lockstep_timeout_s: Positive = 2.0
    """How long (wall clock) lockstep waits for the command to a moving arm before it counts as silence."""
    publish_clock: bool = False
    """Whether to publish the arm's time on ``/clock``, for nodes with ``use_sim_time``."""
    gui: bool = False
    """Whether to show the arm in a window."""

    def __post_init__(self) -> None:
        super().__post_init__()
        bits = self.encoder_bits
        self.require(bits == 0 or bits >= 8, "encoder_bits", "0 (exact), or 8 to 32")
