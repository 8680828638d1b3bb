"""How fast an arm could run its path, by what its URDF says or by what was learned in a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import yaml

from tel_ros.core.config import Config
from tel_ros.core.learning.inputs import query_inputs
from tel_ros.core.plain_urdf import check_dynamics
from tel_ros.core.practice.fastest import AT_THE_LIMIT
from tel_ros.core.practice.learned_timings import VELOCITY_SHARE
from tel_ros.core.practice.session import PracticeSession, Prediction
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.practice.strategy import Forecast, Movement
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.joint_limits import joint_limits
from tel_ros.core.types import FloatArray
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network
from tel_ros.recording.run_folder import CONFIG_FILE, NETWORK_FILE
from tel_ros.recording.urdf import described
from tel_ros.recording.waypoint_file import load_path

_POSTURES = 60
Offsets = Callable[[FloatArray], FloatArray]
"""Inverse dynamics: from (q, q̇, q̈), shape (n, 3 * n_joints), to u - q in rad."""


@dataclass(frozen=True)
class Possible:
    """What is possible on the path of a configuration, by inverse dynamics that come from somewhere."""

    config: Config
    offsets: Offsets
    known_from: str

    def fastest(
        self, share: float, timing: Literal["minimum_jerk", "time_optimal"] = "time_optimal"
    ) -> Forecast:
        """Return the fastest movement with a share of the effort limits.

        Raises:
            TrajectoryError: there is none.
        """
        practice = replace(self.config.practice, goal="fastest", strategy="adaptive_extension", timing=timing)
        config = replace(self.config, practice=practice)
        network: Any = SimpleNamespace(predict=self._predict)
        path = load_path(config.path, config.arm)
        session = PracticeSession[Any](config, path, None, make_strategy(config), None, network)
        return session.forecast(Movement(1.0, effort_share=share))

    @cached_property
    def movement(self) -> Forecast:
        """The fastest movement with the configured share."""
        return self.fastest(self.config.practice.effort_share)

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares of the effort limits that are of interest."""
        return tuple(sorted({self.config.practice.effort_share, 1.0}))

    def efforts(self, inputs: FloatArray) -> FloatArray:
        """Return the efforts [N·m] that (q, q̇, q̈) take. Shapes (n, 3 * n_joints) and (n, n_joints)."""
        q, v, _ = np.split(inputs, 3, axis=1)
        return Springs.of(self.config.arm).effort(q + self.offsets(inputs), q, v)

    def moveit(self) -> str:
        """Return joint_limits.yaml for MoveIt.

        Raises:
            TrajectoryError: no such limits keep efforts within theirs.
        """
        config, found = self.config, self.movement
        arm, share = config.arm, config.practice.effort_share
        path = load_path(config.path, arm)
        time_s = np.linspace(0.0, found.duration_s, len(found.velocity_rad_s))
        limits = joint_limits(
            self.efforts,
            path.evaluate(np.linspace(0.0, 1.0, _POSTURES))[0],
            np.abs(found.velocity_rad_s).max(axis=0),
            np.abs(np.gradient(found.velocity_rad_s, time_s, axis=0)).max(axis=0),
            share * np.array(arm.effort_limit_nm),
        )
        rows = zip(arm.joints, *np.array(limits).tolist(), strict=True)
        values = {
            joint: {
                "has_velocity_limits": True,
                "max_velocity": float(f"{velocity:.4g}"),
                "has_acceleration_limits": True,
                "max_acceleration": float(f"{acceleration:.4g}"),
            }
            for joint, velocity, acceleration in rows
        }
        about = f"""\
# For MoveIt: {arm.name}, by {self.known_from}.
# Whatever the joints do at the same time within these limits, in the postures of {path.name},
# efforts stay within {100 * share:g} % of theirs.
"""
        return about + yaml.safe_dump({"joint_limits": values}, sort_keys=False)

    def _predict(self, desired: Any) -> Prediction:
        offset_rad = self.offsets(query_inputs(desired, 1.0 / self.config.control.rate_hz))
        return Prediction(desired.position_rad + offset_rad, np.zeros_like(offset_rad))


def limited_by(
    config: Config, effort_nm: FloatArray, velocity_rad_s: FloatArray
) -> list[tuple[str, float, float, float, float]]:
    """Return a row a joint: its name, its largest effort and velocity as shares of their limits.

    Behind each the share of the time in which it uses all that it may. Arrays of shape (n, n_joints).
    """
    arm, columns = config.arm, []
    for values, limit, most in (
        (effort_nm, arm.effort_limit_nm, config.practice.effort_share),
        (velocity_rad_s, arm.velocity_limit_rad_s, VELOCITY_SHARE),
    ):
        shares = np.abs(values) / np.array(limit)
        columns += [shares.max(axis=0), np.mean(shares >= AT_THE_LIMIT * most, axis=0)]
    return [(joint, *row) for joint, row in zip(arm.joints, np.array(columns).T.tolist(), strict=True)]


def by_urdf(config_file: Path, overrides: Sequence[str], path: str = "") -> Possible:
    """Return what the URDF's own masses, inertias and frictions would allow; ``path``: which of several.

    Raises:
        ConfigError: the configuration is wrong, there is no such path, or Pinocchio is not installed.
        InputFileError: a file cannot be read, or the URDF tells no inertia that a joint would have to move.
    """
    from tel_ros.core.learning.rigid_body import RigidBodyRegressor
    from tel_ros.recording.urdf import urdf_text

    config = load_config(config_file, overrides)
    config = replace(config, path=config.path.one(path))
    arm, description = config.arm, described(config.arm)
    check_dynamics(description, arm.hand_link)
    regressor = RigidBodyRegressor(urdf_text(description), arm.joints)
    friction = description.viscous_friction_nms_per_rad, description.coulomb_friction_nm
    parameters = np.concatenate([regressor.described, np.zeros(len(arm.joints)), *friction])
    stiffness, damping = np.array(arm.stiffness_nm_per_rad), np.array(arm.damping_nms_per_rad)

    def offsets(inputs: FloatArray) -> FloatArray:
        velocity = np.split(inputs, 3, axis=1)[1]
        return (regressor.torque(inputs, parameters) + damping * velocity) / stiffness

    return Possible(config, offsets, f"the URDF {Path(arm.urdf).name}")


def by_run(folder: Path, path: str = "") -> Possible:
    """Return what was learned in a run allows; ``path``: which of several.

    Raises:
        ConfigError: there is no such path.
        InputFileError: the folder is not that of a run, or has no network yet.
        NetworkFileError: the network cannot be read.
    """
    config = load_config(folder / CONFIG_FILE)
    config = replace(config, path=config.path.one(path))
    return Possible(config, load_network(folder / NETWORK_FILE).predict, f"what was learned in {folder.name}")
