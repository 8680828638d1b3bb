"""Recordings as other people make them: a moving seven-joint arm, with encoders, noise and uneven stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_bridge.arm import SimulatedArm
from tel_lab.exact_model import ExactInverseDynamics
from tel_lab.random_path import sines as sums_of_sines
from tel_lab.study import ROOT
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.types import FloatArray
from tel_ros.recording.config_file import load_config
from tel_ros.recording.topics import JOINT_STATES

CONFIG = ROOT / "config" / "kuka_iiwa.yaml"
CONTROL_HZ = 1000.0
ENCODER_BITS = 16
TORQUE_NOISE = 0.05
"""Standard deviation of the noise of a torque sensor, in units of the spread of its joint's torque."""
VISCOUS_NMS_PER_RAD = (1.0, 1.0, 0.6, 0.6, 0.2, 0.2, 0.1)
COULOMB_NM = (2.0, 2.0, 1.0, 1.0, 0.3, 0.3, 0.1)
_N_SINES = 6
_SLOWEST_HZ, FASTEST_HZ = 0.05, 0.6
_AMPLITUDE_RAD = 0.6
_MIDDLE_RAD = np.array([0.0, 0.5, 0.0, -1.0, 0.0, 0.8, 0.0])
_RAMP_S = 1.0


@dataclass(frozen=True)
class Motion:
    """What an arm did at each tick of its controller, before any encoder; or what a logger wrote down of it.

    Efforts are those of the tick before. Shape (n, n_joints) each.
    """

    joints: tuple[str, ...]
    time_s: FloatArray
    position_rad: FloatArray
    velocity_rad_s: FloatArray
    effort_nm: FloatArray


def moved(duration_s: float, speed: float, seed: int) -> Motion:
    """Return a movement of all joints on sums of sines that never repeat, without noise.

    The controller is given the exact inverse dynamics, so that the arm goes where it should at any speed;
    what is recorded does not depend on that. ``speed`` is a factor on all frequencies: 0.05 to 0.6 Hz at 1.
    """
    config = load_config(CONFIG, [])
    sim = replace(
        config.sim,
        encoder_bits=0,
        viscous_friction_nms_per_rad=VISCOUS_NMS_PER_RAD,
        coulomb_friction_nm=COULOMB_NM,
    )
    desired = sines(duration_s, speed, np.random.default_rng(seed))
    offset = ExactInverseDynamics(config, sim).predict(query_inputs(desired, 1.0 / CONTROL_HZ))
    equilibrium = desired.position_rad + offset
    stiffness, damping = np.array(config.arm.stiffness_nm_per_rad), np.array(config.arm.damping_nms_per_rad)
    sim = replace(sim, initial_position_rad=tuple(desired.position_rad[0].tolist()))
    readings = []
    with SimulatedArm(config.arm, sim, rate_hz=CONTROL_HZ, seed=seed) as arm:
        for u in equilibrium:
            reading = arm.reading()
            q, v = np.array(reading.position_rad), np.array(reading.velocity_rad_s)
            arm.step((stiffness * (u - q) - damping * v).tolist())
            readings.append((q, v, np.array(arm.reading().effort_nm)))
    position, velocity, effort = (np.array(column) for column in zip(*readings, strict=True))
    return Motion(config.arm.joints, desired.time_s, position, velocity, effort)


def recorded(motion: Motion, rate_hz: float, seed: int) -> Motion:
    """Return what a logger at another rate writes down: stamps since its start, and with its noise.

    Samples are taken unevenly, with a standard deviation of 0.2 periods from one to the next, and stamps are
    wrong by 0.1 ms.
    """
    rng = np.random.default_rng(seed)
    n = int(motion.time_s[-1] * rate_hz) - 2
    # Half of that on either end of a step.
    taken_s = (np.arange(n) + 1.0 + np.clip(rng.normal(0.0, 0.2 / np.sqrt(2.0), n), -0.45, 0.45)) / rate_hz
    stamp_s = np.maximum.accumulate(taken_s + rng.normal(0.0, 1e-4, n))

    def at(values: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(taken_s, motion.time_s, column) for column in values.T])

    step_rad = 2.0 * np.pi / 2**ENCODER_BITS
    effort = at(motion.effort_nm)
    noise = rng.normal(0.0, TORQUE_NOISE * motion.effort_nm.std(axis=0), effort.shape)
    return Motion(
        joints=motion.joints,
        time_s=stamp_s,
        position_rad=np.round(at(motion.position_rad) / step_rad) * step_rad,
        velocity_rad_s=at(motion.velocity_rad_s),
        effort_nm=effort + noise,
    )


def write_bag(record: Motion, bag: Path, storage: StoragePlugin) -> None:
    """Write a record as a stock ``joint_state_broadcaster`` would have been recorded."""
    store = get_typestore(Stores.ROS2_JAZZY)
    state, header, time = (
        store.types[name]
        for name in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with Writer(bag, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection(JOINT_STATES, state.__msgtype__, typestore=store)
        stamps_ns = np.round(1e9 * (1000.0 + record.time_s)).astype(np.int64).tolist()
        columns = (record.position_rad, record.velocity_rad_s, record.effort_nm)
        for stamp_ns, *values in zip(stamps_ns, *columns, strict=True):
            stamp = time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
            message = state(header(stamp, ""), list(record.joints), *values)
            writer.write(connection, stamp_ns, store.serialize_cdr(message, state.__msgtype__))


def sines(duration_s: float, speed: float, rng: np.random.Generator) -> DesiredTrajectory:
    """Return sums of sines that grow from rest within a second."""
    time_s = np.arange(round(duration_s * CONTROL_HZ)) / CONTROL_HZ
    n_joints = len(_MIDDLE_RAD)
    frequency_hz = speed * np.exp(rng.uniform(np.log(_SLOWEST_HZ), np.log(FASTEST_HZ), (n_joints, _N_SINES)))
    amplitude = rng.uniform(0.5, 1.0, (n_joints, _N_SINES)) * (_SLOWEST_HZ * speed / frequency_hz) ** 0.5
    amplitude *= _AMPLITUDE_RAD / amplitude.sum(axis=1, keepdims=True)
    omega, phase = 2.0 * np.pi * frequency_hz, rng.uniform(0.0, 2.0 * np.pi, (n_joints, _N_SINES))
    ramp = np.clip(time_s / _RAMP_S, 0.0, 1.0)
    grown, slope, bend = (
        10.0 * ramp**3 - 15.0 * ramp**4 + 6.0 * ramp**5,
        (30.0 * ramp**2 - 60.0 * ramp**3 + 30.0 * ramp**4) / _RAMP_S,
        (60.0 * ramp - 180.0 * ramp**2 + 120.0 * ramp**3) / _RAMP_S**2,
    )
    q, v, a = sums_of_sines(time_s, amplitude, omega, phase)
    grown, slope, bend = grown[:, None], slope[:, None], bend[:, None]
    return DesiredTrajectory(
        time_ns=np.round(1e9 * time_s).astype(np.int64),
        position_rad=_MIDDLE_RAD + grown * q,
        velocity_rad_s=grown * v + slope * q,
        acceleration_rad_s2=grown * a + 2.0 * slope * v + bend * q,
    )
