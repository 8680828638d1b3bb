"""What a practice run is made of, as frozen records that check themselves.

:mod:`tel_ros.recording.config_file` reads them from YAML; :mod:`tel_ros.core.config_fields` explains how
fields declare what they take. Field names carry the units. Defaults are the paper's where the paper gives a
number, and ours elsewhere. What belongs to the arm is in :mod:`tel_ros.core.arm_config`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tel_ros.core.arm_config import ArmConfig as ArmConfig
from tel_ros.core.arm_config import ControlConfig as ControlConfig
from tel_ros.core.arm_config import SafetyConfig as SafetyConfig
from tel_ros.core.arm_config import SimConfig as SimConfig
from tel_ros.core.config_fields import (
    BinaryFile,
    Checked,
    Count,
    Factor,
    FileRole,
    NonNegative,
    Positive,
    Range,
    Share,
    TextFile,
    declared,
)
from tel_ros.core.config_fields import JointValues as JointValues
from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.paths import NAMED_PATHS


@dataclass(frozen=True, kw_only=True)
class RunConfig(Checked):
    """Where a run takes place."""

    arm: Literal["sim", "external"] = "sim"
    """``sim`` starts the simulated arm; ``external`` waits for an arm that is already running."""
    arm_timeout_s: Positive = 10.0
    """How long to wait for joint states and nodes before giving up (wall clock)."""


@dataclass(frozen=True, kw_only=True)
class PathConfig(Checked):
    """The shape of the movement, or of several: a built-in path by name, or waypoints from a file."""

    name: str = ""
    """Built-in path."""
    file: TextFile = ""
    """CSV with a header line of joint names and one row of joint angles in rad per waypoint."""
    files: tuple[TextFile, ...] = ()
    """Several paths that one network learns: each a CSV like ``file``, or the name of a built-in path. A path
    is called like its file, without the ending; ``practice.trials`` is for each."""
    known_name: str = ""
    """``practice.vary`` with ``shape``: the built-in path to begin with..."""
    known_file: TextFile = ""
    """... or a CSV like ``file``. It may start and end elsewhere."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.files:
            neither = not (self.name or self.file)
            self.require(neither, "file" if self.file else "name", "nothing, because path.files is given")
            once = all(self.names) and len(set(self.names)) == len(self.names)
            self.require(once, "files", "files whose names differ, also without their endings")
        else:
            expected = f"either a name or a file (file is {self.file!r}), and not both; or files"
            self.require(bool(self.name) != bool(self.file), "name", expected)
        expected = f"a name or a file (known_file is {self.known_file!r}), and not both"
        self.require(not (self.known_name and self.known_file), "known_name", expected)

    @property
    def names(self) -> tuple[str, ...]:
        """What several paths are called; empty: there is one."""
        return tuple(Path(file).stem for file in self.files)

    def one(self, name: str) -> PathConfig:
        """Return the path of a name alone, of several; with one path, which has none, itself.

        ConfigError: there is no such path, or there are several and no name.
        """
        names = self.names or ("",)
        if name not in names:
            expected = f"one of {', '.join(names)}" if self.files else "nothing: there is one path"
            raise ConfigError("--path", name, expected)
        if not self.files:
            return self
        file = self.files[names.index(name)]
        key = "name" if is_built_in("path.files", file) else "file"
        return dataclasses.replace(self, files=(), **{key: file})


@dataclass(frozen=True, kw_only=True)
class PracticeConfig(Checked):
    """The practice strategy ([Practice] Sec. 3: 15 trials from 11.5 s to 4.5 s)."""

    strategy: str = "trajectory_extension"
    """``trajectory_extension`` (the paper), ``adaptive_extension``, which chooses its own steps, ``subtasks``
    (first the whole path slowly, then its parts one by one, then the whole, [Practice] Sec. 1.2), ``direct``
    (every trial at the goal speed: the paper's control condition), or one that another package offers."""
    trials: Count = 15
    """How many trials; for ``adaptive_extension`` and ``subtasks`` at most."""
    vary: tuple[Literal["speed", "amplitude", "shape", "stiffness"], ...] = ("speed",)
    """What goes from its first value to the goal's, one after the other (``trajectory_extension`` and
    ``adaptive_extension``). Everything else is as in the goal from the start."""
    first_duration_s: Positive = 11.5
    """Duration of the movement in the first trial."""
    goal: Literal["duration", "fastest"] = "duration"
    """``duration``: the movement in ``goal_duration_s``. ``fastest``: as fast as ``effort_share`` of the
    effort limits allows, which practice finds out (docs/fastest.md); with ``adaptive_extension``."""
    goal_duration_s: Positive = 4.5
    """Duration of the movement that is to be learned; not used by ``goal: fastest``."""
    timing: Literal["auto", "minimum_jerk", "time_optimal"] = "auto"
    """How the arm goes along the path. ``time_optimal``: as fast everywhere as efforts, their rates and
    velocities allow by what has been learned so far. ``auto``: that for ``goal: fastest``, else minimum
    jerk."""
    effort_share: Share = 0.9
    """``goal: fastest``: how much of the effort limits the movement may use; the rest is for the springs."""
    first_amplitude: Share = 0.3
    """Size of the first path about its first posture, as a share of the goal's."""
    first_stiffness: Factor = 4.0
    """Factor on K in the first trial; B goes with its root."""
    parts: Annotated[int, Range(2)] = 4
    """``subtasks``: number of pieces of equal duration that the path is cut into."""
    spacing: Literal["duration", "speed", "torque"] = "duration"
    """``trajectory_extension``: what goes in even steps: duration T (the paper), speed 1/T or torque 1/T²."""
    durations_s: tuple[float, ...] = ()
    """``trajectory_extension``: durations of all trials, instead of ``trials`` and even steps."""
    tolerance_rad: Positive = 5e-3
    """``adaptive_extension``: RMS error at the goal speed at which practice ends."""
    step_tolerance_rad: Positive = 0.02
    """``adaptive_extension``: RMS error that a step on the way may be expected to have."""
    on_abort: Literal["stop", "continue"] = "stop"
    """``continue`` learns from what was recorded before the abort and goes on with the next trial.
    ``adaptive_extension`` always goes on, from the network of the last good trial."""

    def __post_init__(self) -> None:
        super().__post_init__()
        choices = ("speed", "amplitude", "shape", "stiffness")
        known_once = 0 < len(self.vary) == len(set(self.vary)) and set(self.vary) <= set(choices)
        self.require(known_once, "vary", f"one or more of {', '.join(choices)}, each once")
        is_allowed = self.vary == ("speed",) or not self.durations_s
        self.require(is_allowed, "vary", "only speed, because durations_s is given")
        least = f"of at least goal_duration_s = {self.goal_duration_s} s"
        finite = all(self.goal_duration_s <= t < math.inf for t in self.durations_s)
        self.require(finite, "durations_s", f"finite times {least}")
        expected = f"a finite angle of at least tolerance_rad = {self.tolerance_rad} rad"
        self.require(self.tolerance_rad <= self.step_tolerance_rad, "step_tolerance_rad", expected)
        is_slower = self.goal_duration_s <= self.first_duration_s
        self.require(is_slower or self.is_fastest, "first_duration_s", f"a finite time {least}")
        if self.is_fastest:
            self.require(self.vary == ("speed",), "vary", "only speed, because goal is 'fastest'")
        else:
            expected = "'auto' or 'minimum_jerk', because goal is 'duration'"
            self.require(self.timing != "time_optimal", "timing", expected)

    @property
    def is_fastest(self) -> bool:
        """Whether the goal is to be as fast as the arm can."""
        return self.goal == "fastest"


@dataclass(frozen=True, kw_only=True)
class LearningConfig(Checked):
    """The network and how it learns ([Practice] Sec. 2.1 and 3)."""

    name: str = "lms_tree"
    """``lms_tree``, ``polynomial``, ``rigid_body``, ``rigid_body+lms_tree``, or one of another package."""
    weights: Literal["lms", "least_squares"] = "lms"
    """How a tree finds its weights: sample by sample (the paper), or solved for all trials at once."""
    start_from: BinaryFile = ""
    """Network file of an earlier run to continue from, with its learner and input ranges. Empty: a new
    network."""
    training: Literal["actual", "desired"] = "actual"
    """Where the command error is applied: at the actual or at the desired trajectory."""
    gaussians_per_input: Annotated[int, Range(2)] = 10
    """Gaussians along each input of a tree."""
    max_subtrees: Annotated[int, Range(0)] = 15
    """Most subtrees that are grown for each joint ([Practice] Sec. 3: 15)."""
    growth_per_trial: Annotated[int, Range(0)] = 1
    """Subtrees that are grown for each joint after each trial."""
    rate: Share = 0.5
    """γ of the normalised LMS rule, 0 < γ <= 1."""
    passes: Count = 2
    """How often a trial's samples are gone through."""
    gaussian_width: Positive = 1.0
    """Standard deviation of a Gaussian in units of the distance between neighbouring centres."""
    gaussians: Literal["auto", "raw", "normalised"] = "auto"
    """``normalised``: those of one input add up to 1. ``auto``: raw for ``lms``, else normalised."""
    forgetting: Share = 1.0
    """``least_squares``: weight of a trial once the next one has been learned; 1: unchanged."""
    detect_change: bool = True
    """``least_squares``: forget the earlier trials when a new one shows that the arm has changed."""
    memory_samples: Annotated[int, Range(1000)] = 20_000
    """``least_squares``: samples that are kept for growing; the oldest are thinned out beyond that."""
    input_margin: Factor = 1.3
    """Input ranges cover the goal movement, widened by this factor."""
    filter: Literal["auto", "fixed"] = "auto"
    """``auto``: the cutoff is chosen for each trial, where its motion sinks into its noise."""
    filter_cutoff_hz: NonNegative = 15.0
    """Zero-phase low-pass of recorded positions and commands: the cutoff (0: no filter), or with ``filter:
    auto`` the highest to choose (0: no limit)."""


@dataclass(frozen=True, kw_only=True)
class RecordingConfig(Checked):
    """How trials are recorded: docs/bags.md."""

    storage: Literal["mcap", "sqlite3"] = "mcap"
    """Format of the bags; rosbag2 reads both."""
    chunk_s: Positive = 0.5
    """How often a bag is brought to the disk (arm time): the most that a crash can cost it."""


@dataclass(frozen=True, kw_only=True)
class ServeConfig(Checked):
    """Trajectories of others, executed by ``feedforward_controller``: docs/how-to/serve.md."""

    tolerance_rad: Positive = 5e-3
    """A trajectory is run as requested if an RMS error up to this is expected."""
    may_slow_down: bool = True
    """Whether others are run slower, by what it takes to be sure of that error; false: they are refused."""
    most_slowdown: Factor = 4.0
    """How many times slower than requested at most; so slow is what nothing is known of."""
    start_tolerance_rad: Positive = 0.05
    """How far the first point of a trajectory may be from where a joint is."""
    bags: Count = 100
    """How many recordings of executions are kept; the oldest are deleted."""


@dataclass(frozen=True, kw_only=True)
class Config(Checked):
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
    serve: ServeConfig = field(default_factory=ServeConfig)
    seed: Annotated[int, Range(0)] = 1
    """Of everything random (at present the sensor noise of the simulated arm)."""
    versions: dict[str, str] = field(default_factory=dict)
    """What a run was made with; written into ``run.yaml``, not read."""

    @property
    def is_guarded(self) -> bool:
        """Whether a run of this configuration starts the guard; what takes no efforts holds by itself."""
        if self.arm.command_interface != "effort":
            return False
        if self.safety.guard == "external":
            return self.run.arm == "external"
        return self.safety.guard == "always"

    @property
    def arm_waits_for_commands(self) -> bool:
        """Whether the arm's time stands still without commands: silence cannot hurt such an arm."""
        return self.run.arm == "sim" and self.sim.clock == "lockstep"

    def __post_init__(self) -> None:
        super().__post_init__()
        rate_hz, sim, guard = self.control.rate_hz, self.sim, self.safety.guard
        substeps = sim.physics_rate_hz / rate_hz
        is_whole = substeps >= 1.0 and abs(substeps - round(substeps)) < 1e-9
        self.require(is_whole, "sim.physics_rate_hz", f"a whole multiple of control.rate_hz = {rate_hz}")
        periods = sim.command_delay_s * rate_hz
        expected = f"a whole multiple of the control period {1.0 / rate_hz:g} s"
        self.require(abs(periods - round(periods)) < 1e-6, "sim.command_delay_s", expected)
        expected = "'external' or 'never' with sim.clock lockstep: its arm waits for each command"
        self.require(guard != "always" or not self.arm_waits_for_commands, "safety.guard", expected)
        interface = self.arm.command_interface
        expected = f"'external' or 'never' with arm.command_interface {interface}: it holds in silence"
        self.require(guard != "always" or interface == "effort", "safety.guard", expected)
        self.safety.require_fits(self.arm)
        sim.require_one_per_joint(self.arm.joints, "sim.")
        practice, path = self.practice, self.path
        known = path.known_name or path.known_file
        key = "path.known_file" if path.known_file else "path.known_name"
        if "shape" in practice.vary:
            expected = "a path to begin with (known_name or known_file), because practice.vary has shape"
            self.require(bool(known), key, expected)
        else:
            self.require(not known, key, "nothing, because practice.vary has no shape")
        if "stiffness" in practice.vary:
            whose = "the drive's" if interface == "position" else "the controller's"
            expected = f"no stiffness, because arm.command_interface is '{interface}': it is {whose}"
            self.require(interface == "effort", "practice.vary", expected)
            most = self.control.max_stiffness_factor
            expected = f"at most control.max_stiffness_factor = {most}"
            self.require(practice.first_stiffness <= most, "practice.first_stiffness", expected)


def file_keys() -> Mapping[str, FileRole]:
    """Return the dotted keys that name files, in the order of the sections."""
    return {
        f"{section}.{name}": key.file
        for section, part in declared(Config).items()
        if dataclasses.is_dataclass(part.hint)
        for name, key in declared(part.hint).items()
        if key.file is not None
    }


def file_values(config: Config) -> dict[str, Path]:
    """Return the files that a configuration names, by dotted key; keys without a file are left out.

    Those of a list have their place behind its key: ``path.files.0``.
    """
    named: dict[str, str] = {}
    for key in file_keys():
        section, name = key.split(".")
        value = getattr(getattr(config, section), name)
        named |= {key: value} if isinstance(value, str) else {f"{key}.{i}": v for i, v in enumerate(value)}
    return {key: Path(name) for key, name in named.items() if name and not is_built_in(key, name)}


def is_built_in(key: str, name: str) -> bool:
    """Return whether an element of a list of paths names one that is built in, and no file."""
    return key.startswith("path.files") and name in NAMED_PATHS


def is_binary(key: str) -> bool:
    """Return whether the file of a key, or of a place in its list, is stored with the first trial only."""
    return file_keys()[".".join(key.split(".")[:2])].binary


def with_files(config: Config, files: Mapping[str, str]) -> Config:
    """Return a configuration with other names for some of its files, by the keys of :func:`file_values`."""
    for key, name in files.items():
        section, field_name, *place = key.split(".")
        part = getattr(config, section)
        value: Any = name
        if place:
            value = list(getattr(part, field_name))
            value[int(place[0])] = name
            value = tuple(value)
        config = dataclasses.replace(config, **{section: dataclasses.replace(part, **{field_name: value})})
    return config
