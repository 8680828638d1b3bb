"""The methods of ``tel compare``: what each is called, what it is told, and how it comes into being."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from tel_lab.comparison import servo_methods as servos
from tel_lab.comparison.servo_methods import Method
from tel_lab.comparison.stored_command import (
    IterativeLearningControl,
    StoredCommand,
    VirtualTrajectoryLearning,
)
from tel_lab.exact_model import ExactInverseDynamics
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.recording.new_network import new_network
from tel_ros.recording.waypoint_file import load_path

Given = Literal["nothing", "kinematics", "model"]
Settings = tuple[str, ...]

_LMS = (
    *("learning.name=lms_tree", "learning.weights=lms"),
    *("learning.filter=fixed", "learning.filter_cutoff_hz=15"),
)
_SOLVED = ("learning.weights=least_squares", "learning.filter=auto")
_LEAST_SQUARES = ("learning.name=lms_tree", *_SOLVED)
_RIGID_BODY = ("learning.name=rigid_body", "learning.filter=auto")
_RIGID_BODY_AND_TREE = ("learning.name=rigid_body+lms_tree", *_SOLVED)
_PAPER = ("practice.strategy=trajectory_extension", "practice.spacing=duration", "practice.durations_s=[]")
_ADAPTIVE = ("practice.strategy=adaptive_extension",)
_DIRECT = ("practice.strategy=direct",)


@dataclass(frozen=True)
class MethodSpec:
    """A method of the comparison.

    Args:
        name: on the command line.
        title: in tables and figures.
        note: how it works, in a line.
        settings: what it changes in the configuration, as for ``--set``.
        given: what it is told of the arm, besides the springs K and B.
        make: from the configuration of one arm; None: the configured practice strategy and learner.
        stiffer: factors on K and B.
    """

    name: str
    title: str
    note: str
    settings: Settings = ()
    given: Given = "nothing"
    make: Callable[[Config], Method] | None = None
    stiffer: tuple[float, float] = (1.0, 1.0)


def chosen(names: Sequence[str]) -> list[MethodSpec]:
    """Return methods by name in the order of :data:`METHODS`; all if no name is given.

    Raises:
        ConfigError: there is no such method.
    """
    for name in names:
        if name not in METHODS:
            raise ConfigError("--methods", name, f"some of {', '.join(METHODS)}")
    return [spec for name, spec in METHODS.items() if not names or name in names]


def goal_movement(config: Config) -> DesiredTrajectory:
    """Return the movement that is wanted."""
    path = load_path(config.path, config.arm)
    return sample(path, config.practice.goal_duration_s, config.control.rate_hz)


def _servo(config: Config) -> Method:
    return servos.servo(1.0 / config.control.rate_hz)


def _exact(config: Config) -> Method:
    return servos.Feedforward(ExactInverseDynamics(config, config.sim).predict, 1.0 / config.control.rate_hz)


def _feedback_error(config: Config) -> Method:
    return servos.FeedbackErrorLearning(new_network(config), 1.0 / config.control.rate_hz)


def _stored(kind: type[StoredCommand], config: Config) -> Method:
    """Return a command that is corrected from trial to trial, and begins as that of the usual servo."""
    desired, arm = goal_movement(config), config.arm
    damping_s = np.array(arm.damping_nms_per_rad) / np.array(arm.stiffness_nm_per_rad)
    initial_rad = servos.with_velocity_reference(desired, damping_s)
    return kind(desired, initial_rad, 1.0 / config.control.rate_hz)


def _tel(
    name: str, title: str, note: str, settings: Settings, given: Given = "nothing", training: str = "actual"
) -> MethodSpec:
    return MethodSpec(name, title, note, (*settings, f"learning.training={training}"), given)


_ALL = (
    MethodSpec("no_learning", "no learning", "the equilibrium point is the desired position", make=_servo),
    MethodSpec(
        *("stiffer_servo", "stiffer servo (4 K, 2 B)"),
        "the same with four times K and twice B, which keeps the damping ratio; does not learn",
        make=_servo,
        stiffer=(4.0, 2.0),
    ),
    _tel(
        *("tel_paper", "TEL as in the paper"),
        "the paper's schedule (15 even steps of the duration), LMS tree, actual trajectory training",
        (*_PAPER, *_LMS),
    ),
    _tel(
        *("tel_adaptive_lms", "TEL adaptive, LMS tree", "the same learner, steps of its own choice"),
        (*_ADAPTIVE, *_LMS),
    ),
    _tel(
        *("tel_adaptive_least_squares", "TEL adaptive, least-squares tree"),
        "trees whose weights are solved for over all trials",
        (*_ADAPTIVE, *_LEAST_SQUARES),
    ),
    _tel(
        *("tel_adaptive_rigid_body", "TEL adaptive, rigid body", "parameters of rigid links with friction"),
        (*_ADAPTIVE, *_RIGID_BODY),
        "kinematics",
    ),
    _tel(
        *("tel_adaptive_rigid_body_tree", "TEL adaptive, rigid body + tree"),
        "a tree learns what the rigid links leave",
        (*_ADAPTIVE, *_RIGID_BODY_AND_TREE),
        "kinematics",
    ),
    _tel(
        *("direct_actual", "direct, actual training"),
        "every trial at the goal speed, LMS tree, actual trajectory training",
        (*_DIRECT, *_LMS),
    ),
    _tel(
        *("direct_desired", "direct, desired training", "likewise, desired trajectory training"),
        (*_DIRECT, *_LMS),
        training="desired",
    ),
    _tel(
        *("direct_least_squares", "direct, least-squares tree"),
        "likewise, the learner of TEL adaptive without its practice strategy",
        (*_DIRECT, *_LEAST_SQUARES),
    ),
    _tel(
        *("direct_rigid_body", "direct, rigid body", "likewise", (*_DIRECT, *_RIGID_BODY), "kinematics"),
    ),
    MethodSpec(
        *("iterative_learning", "iterative learning control"),
        "P- and D-type with a lead of 50 ms and a zero-phase filter of 10 Hz, begins with û = y + K⁻¹ B ẏ; "
        "gains from a random search on a simulation of the same arm and of two with 0.8 and 1.25 times "
        "its inertia",
        make=partial(_stored, IterativeLearningControl),
    ),
    MethodSpec(
        *("virtual_trajectory", "virtual-trajectory correction"),
        "the virtual trajectory moves by 0.15 of the tracking error, zero-phase filter of 2 Hz; begins and "
        "was tuned likewise",
        make=partial(_stored, VirtualTrajectoryLearning),
    ),
    MethodSpec(
        *("feedback_error", "feedback-error learning"),
        "the feedback effort trains an LMS tree at the desired inputs, trial by trial, η = 0.1; "
        "û = y + K⁻¹ B ẏ + N(y)",
        _LMS,
        make=_feedback_error,
    ),
    MethodSpec(
        *("exact_model", "exact inverse dynamics"),
        "the simulated masses and frictions from the first trial on: the limit",
        given="model",
        make=_exact,
    ),
)
METHODS: dict[str, MethodSpec] = {spec.name: spec for spec in _ALL}
"""All methods by name."""
