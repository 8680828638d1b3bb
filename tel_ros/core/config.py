"""What a practice run is made of, as frozen records that are right once they exist.

Each record checks itself when it is made, so that code that holds one need not ask again. Reading
them from YAML is the business of :mod:`tel_ros.recording.config_file`. Units are part of the field
names; defaults are the paper's where the paper gives a number, and ours elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args, get_origin, get_type_hints

from tel_ros.core.errors import ConfigError

JointValues = tuple[float, ...]


def _require(condition: bool, key: str, value: object, expected: str) -> None:
    # Written by the callers so that NaN makes the condition false.
    if not condition:
        raise ConfigError(key, value, expected)


def _require_positive(record: object, *keys: str) -> None:
    for key in keys:
        value = getattr(record, key)
        _require(0.0 < value < math.inf, key, value, "a finite number above 0")


def _require_at_least_zero(record: object, *keys: str) -> None:
    for key in keys:
        value = getattr(record, key)
        _require(0.0 <= value < math.inf, key, value, "a finite number of at least 0")


def _require_choices(record: object) -> None:
    for key, hint in get_type_hints(type(record)).items():
        choices = get_args(hint) if get_origin(hint) is Literal else (getattr(record, key),)
        _require(getattr(record, key) in choices, key, getattr(record, key), " or ".join(map(repr, choices)))


def _require_per_joint(record: object, key: str, joints: Sequence[str], low: float, meaning: str) -> None:
    values = getattr(record, key)
    _require(
        len(values) == len(joints) and all(low < v < math.inf for v in values),
        key,
        list(values),
        f"{len(joints)} {meaning}, one for each of the joints {', '.join(joints)}",
    )


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Where a run takes place."""

    arm: Literal["sim", "external"] = "sim"
    """``sim`` starts the simulated arm; ``external`` waits for an arm that somebody else has started."""
    arm_timeout_s: float = 10.0
    """How long to wait for joint states and nodes before giving up (wall clock)."""

    def __post_init__(self) -> None:
        _require_choices(self)
        _require_positive(self, "arm_timeout_s")


@dataclass(frozen=True, kw_only=True)
class ArmConfig:
    """An arm and the virtual springs that drive it."""

    name: str
    urdf: str
    """File with the kinematics and limits (the simulated arm takes its dynamics from it, too)."""
    joints: tuple[str, ...]
    """Names of the joints to move, in the order of every array and of the effort command."""
    hand_link: str
    """Link whose path is drawn in reports."""
    stiffness_nm_per_rad: JointValues
    """K of the EP control law ([Practice] Sec. 3: 15)."""
    damping_nms_per_rad: JointValues
    """B of the EP control law ([Practice] Sec. 3: 1.5)."""
    effort_limit_nm: JointValues
    """Commands are clipped to it."""
    position_min_rad: JointValues = ()
    """Empty: from the URDF."""
    position_max_rad: JointValues = ()
    """Empty: from the URDF."""
    velocity_limit_rad_s: JointValues = ()
    """A faster joint aborts the trial. Empty: from the URDF."""
    command_interface: Literal["effort", "position"] = "effort"
    """``effort``: the arm takes efforts. ``position``: its drives are the springs and dampers, with the
    stiffness and damping above, and take equilibrium points."""
    set_point_speed_rad_s: JointValues = ()
    """``position``: how fast the equilibrium points that are sent may move. Empty: as
    ``velocity_limit_rad_s``."""

    def __post_init__(self) -> None:
        _require_choices(self)
        _require(len(self.joints) > 0, "joints", list(self.joints), "at least one joint name")
        _require(len(set(self.joints)) == len(self.joints), "joints", list(self.joints), "each joint once")
        _require_per_joint(self, "stiffness_nm_per_rad", self.joints, 0.0, "finite numbers above 0")
        _require_per_joint(self, "damping_nms_per_rad", self.joints, -1e-300, "finite numbers of at least 0")
        _require_per_joint(self, "effort_limit_nm", self.joints, 0.0, "finite numbers above 0")
        for key in ("position_min_rad", "position_max_rad"):
            if getattr(self, key):
                _require_per_joint(self, key, self.joints, -math.inf, "finite numbers")
        for key in ("velocity_limit_rad_s", "set_point_speed_rad_s"):
            if getattr(self, key):
                _require_per_joint(self, key, self.joints, 0.0, "finite numbers above 0")
        if self.position_min_rad and self.position_max_rad:
            ordered = all(
                low < high for low, high in zip(self.position_min_rad, self.position_max_rad, strict=True)
            )
            _require(
                ordered,
                "position_max_rad",
                list(self.position_max_rad),
                f"above {list(self.position_min_rad)}",
            )


@dataclass(frozen=True, kw_only=True)
class PathConfig:
    """The shape of the movement: a built-in path by name, or waypoints from a file."""

    name: str = ""
    file: str = ""
    """CSV with a header line of joint names and one row of joint angles in rad a waypoint."""
    known_name: str = ""
    """``practice.vary`` with ``shape``: the path to begin with, built in..."""
    known_file: str = ""
    """... or from a CSV like ``file``. It may start and end elsewhere."""

    def __post_init__(self) -> None:
        _require(
            bool(self.name) != bool(self.file),
            "name",
            self.name,
            f"either a name or a file (file is {self.file!r}), and not both",
        )
        _require(
            not (self.known_name and self.known_file),
            "known_name",
            self.known_name,
            f"a name or a file (known_file is {self.known_file!r}), and not both",
        )


@dataclass(frozen=True, kw_only=True)
class PracticeConfig:
    """The practice strategy ([Practice] Sec. 3: 15 trials from 11.5 s to 4.5 s)."""

    strategy: Literal["trajectory_extension", "adaptive_extension", "subtasks", "direct"] = (
        "trajectory_extension"
    )
    """``adaptive_extension`` chooses its own steps. ``subtasks``: first the whole path slowly, then its parts
    one by one, then the whole ([Practice] Sec. 1.2). ``direct`` runs every trial at the goal speed: the
    paper's control condition."""
    trials: int = 15
    """How many trials; for ``adaptive_extension`` and ``subtasks`` at most."""
    vary: tuple[Literal["speed", "amplitude", "shape", "stiffness"], ...] = ("speed",)
    """What goes from its first value to that of the goal, one after the other (``trajectory_extension`` and
    ``adaptive_extension``). What is not named is as in the goal from the start."""
    first_duration_s: float = 11.5
    goal_duration_s: float = 4.5
    first_amplitude: float = 0.3
    """Of the path about its first posture, as a share of that of the goal."""
    first_stiffness: float = 4.0
    """Factor on K; B goes with its root."""
    parts: int = 4
    """``subtasks``: into how many pieces of equal duration the path is cut."""
    spacing: Literal["duration", "speed", "torque"] = "duration"
    """``trajectory_extension``: what goes up in even steps: duration T (the paper), speed 1/T or torque
    1/T²."""
    durations_s: tuple[float, ...] = ()
    """``trajectory_extension``: durations of all trials, instead of ``trials`` and even steps."""
    tolerance_rad: float = 5e-3
    """``adaptive_extension``: RMS error at the goal speed at which practice is over."""
    step_tolerance_rad: float = 0.02
    """``adaptive_extension``: RMS error that may be expected of a step on the way there."""
    on_abort: Literal["stop", "continue"] = "stop"
    """``continue`` learns from what was recorded before the abort and goes on with the next trial.
    ``adaptive_extension`` always goes on, from the network of the last good trial."""

    def __post_init__(self) -> None:
        _require_choices(self)
        _require(self.trials >= 1, "trials", self.trials, "a whole number of at least 1")
        _require_positive(self, "goal_duration_s", "tolerance_rad")
        self._check_vary()
        _require(
            0.0 < self.first_amplitude <= 1.0, "first_amplitude", self.first_amplitude, "above 0, up to 1"
        )
        _require(
            1.0 <= self.first_stiffness < math.inf,
            "first_stiffness",
            self.first_stiffness,
            "a finite factor of at least 1",
        )
        _require(self.parts >= 2, "parts", self.parts, "a whole number of at least 2")
        _require(
            all(self.goal_duration_s <= t < math.inf for t in self.durations_s),
            "durations_s",
            list(self.durations_s),
            f"finite times of at least goal_duration_s = {self.goal_duration_s} s",
        )
        _require(
            self.tolerance_rad <= self.step_tolerance_rad < math.inf,
            "step_tolerance_rad",
            self.step_tolerance_rad,
            f"a finite angle of at least tolerance_rad = {self.tolerance_rad} rad",
        )
        _require(
            self.goal_duration_s <= self.first_duration_s < math.inf,
            "first_duration_s",
            self.first_duration_s,
            f"a finite time of at least goal_duration_s = {self.goal_duration_s} s",
        )

    def _check_vary(self) -> None:
        choices = ("speed", "amplitude", "shape", "stiffness")
        _require(
            0 < len(self.vary) == len(set(self.vary)) and set(self.vary) <= set(choices),
            "vary",
            list(self.vary),
            f"one or more of {', '.join(choices)}, each once",
        )
        only_speed = self.vary == ("speed",)
        _require(
            only_speed or not self.durations_s,
            "vary",
            list(self.vary),
            "only speed, because durations_s is given",
        )
        _require(
            only_speed or self.strategy != "subtasks",
            "vary",
            list(self.vary),
            "only speed, because strategy is 'subtasks'",
        )
        if self.strategy == "trajectory_extension" and not only_speed:
            _require(
                self.trials > len(self.vary),
                "trials",
                self.trials,
                f"more than the {len(self.vary)} things that vary",
            )


@dataclass(frozen=True, kw_only=True)
class LearningConfig:
    """The network and how it learns ([Practice] Sec. 2.1 and 3)."""

    name: str = "lms_tree"
    """``lms_tree``, ``rigid_body``, ``rigid_body+lms_tree``, or a learner that another package offers."""
    weights: Literal["lms", "least_squares"] = "lms"
    """How a tree finds its weights: sample by sample (the paper), or solved for all trials at once."""
    start_from: str = ""
    """Network file of an earlier run to go on from (it brings its learner and input ranges along). Empty: a
    new one."""
    training: Literal["actual", "desired"] = "actual"
    """Where the command error is applied: at the actual or at the desired trajectory."""
    gaussians_per_input: int = 10
    max_subtrees: int = 15
    """Limit of subtrees grown for each joint ([Practice] Sec. 3: 15)."""
    growth_per_trial: int = 1
    rate: float = 0.5
    """γ of the normalised LMS rule, 0 < γ <= 1."""
    passes: int = 2
    """How often a trial's samples are gone through."""
    gaussian_width: float = 1.0
    """Standard deviation of a Gaussian in units of the distance between neighbouring centres."""
    gaussians: Literal["auto", "raw", "normalised"] = "auto"
    """``normalised``: those of one input add up to 1. ``auto``: raw for ``lms``, else normalised."""
    forgetting: float = 1.0
    """``least_squares``: what a trial counts after the next one has been learned; 1: as much as before."""
    detect_change: bool = True
    """``least_squares``: when a trial tells of another arm than the earlier ones, these are forgotten."""
    memory_samples: int = 20_000
    """``least_squares``: samples that are kept for growing; the oldest are thinned out beyond that."""
    input_margin: float = 1.3
    """Input ranges cover the goal movement, widened by this factor."""
    filter: Literal["auto", "fixed"] = "auto"
    """``auto``: the cutoff is chosen for each trial, where its motion sinks into its noise."""
    filter_cutoff_hz: float = 15.0
    """Zero-phase low-pass for recorded positions and commands: the cutoff (0: no filter), or the highest to
    choose (0: no limit)."""

    def __post_init__(self) -> None:
        _require_choices(self)
        _require(self.gaussians_per_input >= 2, "gaussians_per_input", self.gaussians_per_input, "at least 2")
        _require(self.max_subtrees >= 0, "max_subtrees", self.max_subtrees, "at least 0")
        _require(self.growth_per_trial >= 0, "growth_per_trial", self.growth_per_trial, "at least 0")
        _require(0.0 < self.rate <= 1.0, "rate", self.rate, "a number above 0 and up to 1")
        _require(self.passes >= 1, "passes", self.passes, "a whole number of at least 1")
        _require_positive(self, "gaussian_width")
        _require(0.0 < self.forgetting <= 1.0, "forgetting", self.forgetting, "a number above 0 and up to 1")
        _require(self.memory_samples >= 1000, "memory_samples", self.memory_samples, "at least 1000")
        _require(1.0 <= self.input_margin < math.inf, "input_margin", self.input_margin, "at least 1")
        _require_at_least_zero(self, "filter_cutoff_hz")


@dataclass(frozen=True, kw_only=True)
class ControlConfig:
    """The control loop and what makes it stop a trial."""

    rate_hz: float = 500.0
    """Rate of joint states and commands, and of the points of trajectories."""
    path_tolerance_rad: float = 1.0
    """A joint further than this from its desired position aborts the trial."""
    approach_speed_rad_s: float = 0.5
    """Peak speed of the fastest joint on the way to the start posture."""
    settle_speed_rad_s: float = 0.05
    """Slower than this counts as at rest."""
    settle_time_s: float = 0.5
    """How long the arm must be at rest before a trial runs, and before a trial counts as finished."""
    settle_timeout_s: float = 10.0
    """Not at rest after this: the trial is aborted."""
    state_timeout_s: float = 0.1
    """No new joint state for this long (wall clock) aborts the trial and commands zero effort."""
    velocity_filter_hz: float = 100.0
    """Low-pass of velocities that are estimated from positions, for joints whose velocity the joint states do
    not tell. Lower for coarse encoders."""
    max_stiffness_factor: float = 10.0
    """A trial with springs more than this many times as stiff or as damped as the arm's, or less than one in
    this many, is refused."""
    realtime_priority: int = 0
    """SCHED_FIFO priority of the controller and the simulated arm, 1 to 98, where permitted; 0: scheduled
    like any other program."""
    lock_memory: bool = False
    """Keep the memory of the same nodes from being swapped out, where permitted."""

    def __post_init__(self) -> None:
        _require_positive(
            self,
            "rate_hz",
            "path_tolerance_rad",
            "approach_speed_rad_s",
            "settle_speed_rad_s",
            "settle_time_s",
            "state_timeout_s",
            "velocity_filter_hz",
        )
        _require(
            1.0 <= self.max_stiffness_factor < math.inf,
            "max_stiffness_factor",
            self.max_stiffness_factor,
            "a finite factor of at least 1",
        )
        _require(
            0 <= self.realtime_priority <= 98,  # 99 is for what the kernel itself cannot wait for
            "realtime_priority",
            self.realtime_priority,
            "a whole number from 0 to 98",
        )
        _require(
            self.settle_time_s < self.settle_timeout_s < math.inf,
            "settle_timeout_s",
            self.settle_timeout_s,
            f"a finite time above settle_time_s = {self.settle_time_s} s",
        )


@dataclass(frozen=True, kw_only=True)
class SafetyConfig:
    """The layer through which every effort goes before it reaches the arm: docs/safety.md."""

    effort_rate_nm_per_s: JointValues = ()
    """How fast an effort may grow. Empty: from one effort limit to the opposite one in 20 ms."""
    soft_margin_rad: JointValues = ()
    """How far inside the position limits a joint is held back. Empty: 2.5 % of its range, at most 0.1 rad."""
    k_position_per_s: JointValues = ()
    """Allowed speed towards a soft limit for each rad of distance. Empty: 4 K / ``k_velocity``."""
    k_velocity_nms_per_rad: JointValues = ()
    """Effort against each rad/s above the allowed speed. Empty: 2 B, and at least 0.05 s times K."""
    deceleration_rad_s2: JointValues = ()
    """With what a joint can be braked: one that comes to a soft limit too fast for it is. Empty: half the
    effort limit on the inertia that K and B damp with a ratio of 0.3."""
    velocity_margin: float = 0.25
    """A joint this share above its velocity limit is braked, whatever the command."""
    final_effort: Literal["zero", "hold"] = "zero"
    """What an arm is left with after an emergency stop, or at the end of the run, once it is at rest."""
    guard: Literal["external", "always", "never"] = "external"
    """When a process of its own watches the commands. ``external``: with ``run.arm: external``."""
    command_timeout_s: float = 0.05
    """Silence of the controller after which the guard brakes the arm."""
    clock_drift: float = 0.001
    """How much slower the clock of the joint states may run than the wall clock, as a share: states that come
    later than that explains get less effort. 1: never, for a simulator that is slower than real time."""
    watch_drives: bool = True
    """Whether a trial is aborted when the efforts that the arm reports say that a motor does not act. False:
    for drives whose reports cannot be trusted."""

    def __post_init__(self) -> None:
        _require_choices(self)
        _require_at_least_zero(self, "velocity_margin")
        _require_positive(self, "command_timeout_s")
        _require(0.0 <= self.clock_drift <= 1.0, "clock_drift", self.clock_drift, "a share from 0 to 1")
        for key in (
            "effort_rate_nm_per_s",
            "k_position_per_s",
            "k_velocity_nms_per_rad",
            "deceleration_rad_s2",
        ):
            values = getattr(self, key)
            _require(all(0.0 < v < math.inf for v in values), key, list(values), "finite numbers above 0")
        margin = self.soft_margin_rad
        _require(
            all(0.0 <= v < math.inf for v in margin),
            "soft_margin_rad",
            list(margin),
            "finite numbers of at least 0",
        )

    def require_fits(self, arm: ArmConfig) -> None:
        """Refuse values that do not fit an arm whose empty limits have been filled from its URDF.

        Raises:
            ConfigError: another number of values than joints, or soft limits that leave no range.
        """
        for key in (
            "effort_rate_nm_per_s",
            "soft_margin_rad",
            "k_position_per_s",
            "k_velocity_nms_per_rad",
            "deceleration_rad_s2",
        ):
            values = getattr(self, key)
            _require(
                len(values) in (0, len(arm.joints)),
                f"safety.{key}",
                list(values),
                f"nothing, or one value for each of the joints {', '.join(arm.joints)}",
            )
        if not (self.soft_margin_rad and arm.position_min_rad and arm.position_max_rad):
            return
        room = [high - low for low, high in zip(arm.position_min_rad, arm.position_max_rad, strict=True)]
        _require(
            all(2.0 * margin < r for margin, r in zip(self.soft_margin_rad, room, strict=True)),
            "safety.soft_margin_rad",
            list(self.soft_margin_rad),
            f"less than half of each joint's range of {room} rad",
        )


@dataclass(frozen=True, kw_only=True)
class SimConfig:
    """The simulated arm. Nothing here reaches a real one."""

    clock: Literal["lockstep", "realtime"] = "lockstep"
    """``lockstep`` waits for each command and runs as fast as the graph can; ``realtime`` is paced."""
    physics_rate_hz: float = 4000.0
    encoder_bits: int = 16
    """Positions are read in steps of 2π / 2^bits; 0: exact."""
    position_noise_rad: float = 0.0
    """Standard deviation of white noise on each position reading."""
    velocity_filter_hz: float = 100.0
    """Low-pass of the velocity that is made from successive position readings; 0: none."""
    command_delay_s: float = 0.0
    drive_stiffness_scale: float = 1.0
    """``arm.command_interface: position``: factor on K of the simulated drives, which then are not what the
    arm is described as."""
    payload_kg: float = 0.0
    """Point mass at the hand link."""
    inertia_scale: float = 1.0
    """Factor on all masses and inertias."""
    viscous_friction_nms_per_rad: JointValues = ()
    """Empty: the damping in the URDF."""
    coulomb_friction_nm: JointValues = ()
    """Empty: the friction in the URDF."""
    initial_position_rad: JointValues = ()
    """Empty: the middle of each joint's range."""
    watchdog_s: float = 0.1
    """Silence on the command topic after which the effort goes to zero (arm time). Position drives hold their
    last set point instead."""
    command_age_limit_s: float = 0.0
    """Commands that answer a state this much older than the newest are not applied (real time); 0: all are.
    Late commands are what a driver alone can tell: docs/arm-contract.md."""
    lockstep_timeout_s: float = 2.0
    """How long (wall clock) lockstep waits for the command to a moving arm before it counts as silence."""
    gui: bool = False

    def __post_init__(self) -> None:
        _require_choices(self)
        _require_positive(
            self, "physics_rate_hz", "inertia_scale", "drive_stiffness_scale", "lockstep_timeout_s"
        )
        _require(0.0 < self.watchdog_s <= 0.1, "watchdog_s", self.watchdog_s, "above 0 and up to 0.1 s")
        _require(
            self.encoder_bits == 0 or 8 <= self.encoder_bits <= 32,
            "encoder_bits",
            self.encoder_bits,
            "0 (exact), or 8 to 32",
        )
        _require_at_least_zero(
            self,
            *("position_noise_rad", "velocity_filter_hz", "command_delay_s", "command_age_limit_s"),
            "payload_kg",
        )
        for key in ("viscous_friction_nms_per_rad", "coulomb_friction_nm"):
            values = getattr(self, key)
            _require(
                all(0.0 <= v < math.inf for v in values), key, list(values), "finite numbers of at least 0"
            )
        position = self.initial_position_rad
        _require(all(map(math.isfinite, position)), "initial_position_rad", list(position), "finite numbers")


@dataclass(frozen=True, kw_only=True)
class RecordingConfig:
    """How trials are recorded: docs/bags.md."""

    storage: Literal["mcap", "sqlite3"] = "mcap"
    """Format of the bags; both are rosbag2's."""
    chunk_s: float = 0.5
    """A bag is brought to the disk this often (arm time): the most that a crash can cost it."""

    def __post_init__(self) -> None:
        _require_choices(self)
        _require_positive(self, "chunk_s")


@dataclass(frozen=True, kw_only=True)
class Config:
    """Everything that defines a practice run."""

    arm: ArmConfig
    path: PathConfig
    run: RunConfig = field(default_factory=RunConfig)
    practice: PracticeConfig = field(default_factory=PracticeConfig)
    learning: LearningConfig = field(default_factory=LearningConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    sim: SimConfig = field(default_factory=SimConfig)
    recording: RecordingConfig = field(default_factory=RecordingConfig)
    seed: int = 1
    """Of everything random (at present the sensor noise of the simulated arm)."""
    versions: dict[str, str] = field(default_factory=dict)
    """What a run was made with; written into ``run.yaml``, not read."""

    @property
    def is_guarded(self) -> bool:
        """Whether a run of this configuration starts the guard; position drives hold by themselves."""
        if self.arm.command_interface == "position":
            return False
        if self.safety.guard == "external":
            return self.run.arm == "external"
        return self.safety.guard == "always"

    @property
    def arm_waits_for_commands(self) -> bool:
        """Whether the arm's time stands still while nobody commands it: no silence can hurt it then."""
        return self.run.arm == "sim" and self.sim.clock == "lockstep"

    def __post_init__(self) -> None:
        _require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        substeps = self.sim.physics_rate_hz / self.control.rate_hz
        _require(
            substeps >= 1.0 and abs(substeps - round(substeps)) < 1e-9,
            "sim.physics_rate_hz",
            self.sim.physics_rate_hz,
            f"a whole multiple of control.rate_hz = {self.control.rate_hz}",
        )
        periods = self.sim.command_delay_s * self.control.rate_hz
        _require(
            abs(periods - round(periods)) < 1e-6,
            "sim.command_delay_s",
            self.sim.command_delay_s,
            f"a whole multiple of the control period {1.0 / self.control.rate_hz:g} s",
        )
        _require(
            self.safety.guard != "always" or not self.arm_waits_for_commands,
            "safety.guard",
            self.safety.guard,
            "'external' or 'never' with sim.clock lockstep: its arm waits for each command",
        )
        _require(
            self.safety.guard != "always" or self.arm.command_interface == "effort",
            "safety.guard",
            self.safety.guard,
            "'external' or 'never' with arm.command_interface position: the drives hold in silence",
        )
        self._check_varied()
        self.safety.require_fits(self.arm)
        for key in ("viscous_friction_nms_per_rad", "coulomb_friction_nm", "initial_position_rad"):
            values = getattr(self.sim, key)
            _require(
                len(values) in (0, len(self.arm.joints)),
                f"sim.{key}",
                list(values),
                f"nothing, or one value for each of the joints {', '.join(self.arm.joints)}",
            )

    def _check_varied(self) -> None:
        practice, known = self.practice, self.path.known_name or self.path.known_file
        varies_shape = "shape" in practice.vary
        _require(
            bool(known) == varies_shape,
            "path.known_name",
            known,
            "a path to begin with (known_name or known_file), because practice.vary has shape"
            if varies_shape
            else "nothing, because practice.vary has no shape",
        )
        _require(
            "stiffness" not in practice.vary or self.arm.command_interface == "effort",
            "practice.vary",
            list(practice.vary),
            "no stiffness, because arm.command_interface is 'position': it is the drive's, and stays",
        )
        _require(
            "stiffness" not in practice.vary or practice.first_stiffness <= self.control.max_stiffness_factor,
            "practice.first_stiffness",
            practice.first_stiffness,
            f"at most control.max_stiffness_factor = {self.control.max_stiffness_factor}",
        )
