"""Movements of three arms with the torques that they took: what learners of inverse dynamics are compared on.

Made anew each time, bit for bit the same: nothing is downloaded. They need PyBullet, the robot descriptions
that come with it, and pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Self

import numpy as np
import yaml

from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.inverse_dynamics import arm_models
from tel_lab.inverse_dynamics.arm_models import WRITING_ARM, with_wrong_inertias
from tel_lab.offline import OfflineArm
from tel_lab.random_path import sine_path, sines
from tel_lab.study import ROOT
from tel_ros.core.learning.inputs import query_inputs, stack_inputs
from tel_ros.core.learning.signals import learning_record, training_samples
from tel_ros.core.trajectories.paths import Path, waypoint_path
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import Outcome, TrialGoal
from tel_ros.core.types import FloatArray
from tel_ros.recording.config_file import load_config
from tel_ros.recording.waypoint_file import load_path


@dataclass(frozen=True)
class Trial:
    """One movement from rest to rest, and what the motors did.

    Args:
        inputs: q, q̇, q̈ in rad, rad/s, rad/s². Shape (n, 3 * n_joints).
        torque_nm: shape (n, n_joints).
        input_noise: standard deviation of the noise in each column of ``inputs``. Shape (3 * n_joints,).
        bandwidth_hz: what lies above has been filtered away; half of the rate if nothing was filtered.
    """

    name: str
    inputs: FloatArray
    torque_nm: FloatArray
    rate_hz: float
    input_noise: FloatArray
    bandwidth_hz: float

    @classmethod
    def exact(cls, name: str, inputs: FloatArray, torque_nm: FloatArray, rate_hz: float) -> Self:
        return cls(name, inputs, torque_nm, rate_hz, np.zeros(inputs.shape[1]), 0.5 * rate_hz)


@dataclass(frozen=True)
class DataSet:
    """Trials of one arm.

    ``urdf`` is a text with the right kinematics and wrong inertias. K and B are of the EP control law; 1
    and 0 where torque itself is to be learned.
    """

    name: str
    about: str
    joints: tuple[str, ...]
    training: tuple[Trial, ...]
    held_out: tuple[Trial, ...]
    urdf: str
    stiffness_nm_per_rad: tuple[float, ...]
    damping_nms_per_rad: tuple[float, ...]


PRACTICE_S = tuple(float(duration_s) for duration_s in np.linspace(11.5, 4.5, 15))


def planar_practice(
    durations_s: Sequence[float] = PRACTICE_S,
    held_out_s: Sequence[float] = (8.0, 4.5),
    other_paths_s: Sequence[float] = (6.0, 5.0),
) -> DataSet:
    """Return the trials of the paper's protocol as the default arm records them.

    They are simulated with encoders, filtered and differentiated as in practice. The commands come from no
    learner, but from the exact model of an arm a tenth too light: about as good as after some practice.
    As in practice torque follows from the command by the EP law. The velocity that the drive gives this law
    is about 2 ms late, so the torque is that of an arm with slightly less inertia. Held out are two of the
    durations on the practised path, one between the others and the fastest, and the trials on other paths.
    """
    config = load_config(ROOT / "config" / "paper.yaml", [])
    rate_hz, cutoff_hz = config.control.rate_hz, config.learning.filter_cutoff_hz
    stiffness, damping = np.array(config.arm.stiffness_nm_per_rad), np.array(config.arm.damping_nms_per_rad)
    practised = load_path(config.path, config.arm)
    commanding = ExactInverseDynamics(config, replace(config.sim, inertia_scale=0.9))
    rng = np.random.default_rng(1)
    middle_rad = np.array([0.6, 1.05])
    others = [random_loop(f"other path {i + 1}", middle_rad, rng) for i in range(len(other_paths_s))]
    plan = [(practised, t) for t in durations_s] + list(zip(others, other_paths_s, strict=True))
    training: list[Trial] = []
    held_out: list[Trial] = []
    with OfflineArm(config) as arm:
        for index, (path, duration_s) in enumerate(plan, start=1):
            desired = sample(path, duration_s, rate_hz)
            offset_rad = commanding.predict(query_inputs(desired, 1.0 / rate_hz))
            recorded = arm.run_trial(TrialGoal(index, 1.0, desired, desired.position_rad + offset_rad))
            if recorded.report.outcome != Outcome.COMPLETED:
                raise RuntimeError(f"{path.name} in {duration_s} s: {recorded.report}")
            samples = training_samples(learning_record(recorded), cutoff_hz)
            trial = Trial(
                name=f"{path.name}, {duration_s:g} s",
                inputs=samples.actual,
                # The EP law with the velocity as filtered, so that nothing but K and B lies between the two.
                torque_nm=stiffness * samples.offset_rad - damping * samples.actual[:, 2:4],
                rate_hz=rate_hz,
                input_noise=samples.input_noise,
                bandwidth_hz=samples.bandwidth_hz,
            )
            is_held_out = path is not practised or duration_s in held_out_s
            (held_out if is_held_out else training).append(trial)
    return DataSet(
        name="planar practice",
        about=f"recorded trials of the default arm at {rate_hz:g} Hz, filtered; unseen: two of its "
        "speeds (one faster than all others) and two other paths",
        joints=config.arm.joints,
        training=tuple(training),
        held_out=tuple(held_out),
        urdf=with_wrong_inertias(FilePath(config.arm.urdf).read_text(encoding="utf-8")),
        stiffness_nm_per_rad=config.arm.stiffness_nm_per_rad,
        damping_nms_per_rad=config.arm.damping_nms_per_rad,
    )


UNSEEN_LETTERS = ("e", "h", "s")
LETTER_M = 0.065
"""Width of a letter, and half of the way from the top of a stem to the bottom of a tail."""
WRITING_VISCOUS_NMS_PER_RAD = (0.08, 0.05)
PAPER_M = (0.27, 0.20)
"""Middle of the place where letters are written, seen from the shoulder."""


def letters() -> DataSet:
    """Return 20 letters that a light two-joint arm writes, each in 2 to 3 s, with exact signals."""
    rate_hz, rng = 25.0, np.random.default_rng(2)
    trials = {}
    strokes = yaml.safe_load(FilePath(__file__).with_name("letters.yaml").read_text("utf-8"))
    for letter, stroke in strokes.items():
        points = np.array([point.split(",") for point in stroke.split()], dtype=np.float64)
        path = waypoint_path(letter, PAPER_M + LETTER_M * (points - 0.5))
        motion = sample(path, rng.uniform(2.0, 3.0), rate_hz)
        # Of a point: in m.
        hand = motion.position_rad, motion.velocity_rad_s, motion.acceleration_rad_s2
        inputs = arm_models.writing_motion(hand)
        torque_nm = arm_models.torque_nm(WRITING_ARM, inputs, WRITING_VISCOUS_NMS_PER_RAD)
        trials[letter] = Trial.exact(letter, inputs, torque_nm, rate_hz)
    return DataSet(
        name="letters",
        about=f"20 letters written by another two-joint arm, {rate_hz:g} Hz, exact signals; unseen: the "
        f"letters {', '.join(UNSEEN_LETTERS)}",
        joints=("shoulder", "elbow"),
        training=tuple(trial for letter, trial in trials.items() if letter not in UNSEEN_LETTERS),
        held_out=tuple(trials[letter] for letter in UNSEEN_LETTERS),
        urdf=with_wrong_inertias(WRITING_ARM),
        stiffness_nm_per_rad=(1.0, 1.0),
        damping_nms_per_rad=(0.0, 0.0),
    )


SEVEN_JOINTS_VISCOUS_NMS_PER_RAD = 0.5


def seven_joints() -> DataSet:
    """Return closed movements of all joints of a KUKA LBR iiwa under gravity, each on a path of its own.

    Torques are those of the inertias in the URDF that comes with PyBullet, and of viscous friction.
    """
    text, rate_hz, rng = arm_models.iiwa_urdf(), 100.0, np.random.default_rng(3)
    middle_rad = np.array([0.0, 0.5, 0.0, -1.0, 0.0, 0.8, 0.0])
    trials: list[Trial] = []
    for duration_s in np.linspace(10.0, 3.0, 15):
        path = random_loop("", middle_rad + rng.uniform(-0.3, 0.3, 7), rng, highest=2)
        motion = sample(path, duration_s, rate_hz)
        inputs = stack_inputs(motion.position_rad, motion.velocity_rad_s, motion.acceleration_rad_s2)
        torque_nm = arm_models.torque_nm(text, inputs, SEVEN_JOINTS_VISCOUS_NMS_PER_RAD)
        trials.append(Trial.exact(f"path {len(trials) + 1}, {duration_s:g} s", inputs, torque_nm, rate_hz))
    held_out = (3, 8, 13)
    return DataSet(
        name="seven joints",
        about=f"random closed paths of a KUKA LBR iiwa in 10 to 3 s, {rate_hz:g} Hz, exact signals; unseen: "
        "three of the paths",
        joints=tuple(f"lbr_iiwa_joint_{k}" for k in range(1, 8)),
        training=tuple(trial for i, trial in enumerate(trials) if i not in held_out),
        held_out=tuple(trials[i] for i in held_out),
        urdf=with_wrong_inertias(text),
        stiffness_nm_per_rad=(1.0,) * 7,
        damping_nms_per_rad=(0.0,) * 7,
    )


def random_loop(name: str, middle_rad: FloatArray, rng: np.random.Generator, *, highest: int = 3) -> Path:
    """Return a random closed path on which every joint goes 0.5 rad to at least one side of its middle.

    Each joint follows a sum of sines that go around 1 to ``highest`` times.
    """
    shape = len(middle_rad), highest
    omega = 2.0 * np.pi * np.arange(1, highest + 1, dtype=np.float64)
    phase = rng.uniform(0.0, 2.0 * np.pi, shape)
    share = rng.uniform(0.3, 1.0, shape)
    share *= 0.5 / np.abs(sines(np.linspace(0.0, 1.0, 1001), share, omega, phase)[0]).max(axis=0)[:, None]
    return sine_path(name, middle_rad, share, omega, phase)


def stacked(trials: Iterable[Trial]) -> tuple[FloatArray, FloatArray]:
    """Return inputs (n, 3 * n_joints) and torques [N·m] (n, n_joints) of some trials, one below the other."""
    trials = list(trials)
    return np.vstack([trial.inputs for trial in trials]), np.vstack([trial.torque_nm for trial in trials])


DATA_SETS: dict[str, Callable[[], DataSet]] = {
    "planar practice": planar_practice,
    "letters": letters,
    "seven joints": seven_joints,
}
