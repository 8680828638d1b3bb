"""The methods of ``tel compare``: what each is called, what it is told, and how it comes into being."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tel_lab.comparison.servo_methods import (
    FeedbackErrorLearning,
    Feedforward,
    Method,
    servo,
    with_velocity_reference,
)
from tel_lab.comparison.stored_command import IterativeLearningControl, VirtualTrajectoryLearning
from tel_lab.exact_model import ExactInverseDynamics
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError
from tel_ros.core.trajectories.trajectory import DesiredTrajectory, sample
from tel_ros.core.types import FloatArray
from tel_ros.recording.new_network import new_network
from tel_ros.recording.waypoint_file import load_path

Given = Literal["nothing", "kinematics", "model"]

_LMS = (
    "learning.name=lms_tree",
    "learning.weights=lms",
    "learning.filter=fixed",
    "learning.filter_cutoff_hz=15",
)
_LEAST_SQUARES = ("learning.name=lms_tree", "learning.weights=least_squares", "learning.filter=auto")
_RIGID_BODY = ("learning.name=rigid_body", "learning.filter=auto")
_RIGID_BODY_AND_TREE = (
    "learning.name=rigid_body+lms_tree",
    "learning.weights=least_squares",
    "learning.filter=auto",
)
_PAPER = ("practice.strategy=trajectory_extension", "practice.spacing=duration", "practice.durations_s=[]")
_ADAPTIVE = ("practice.strategy=adaptive_extension",)
_DIRECT = ("practice.strategy=direct",)
_ACTUAL, _DESIRED = ("learning.training=actual",), ("learning.training=desired",)


@dataclass(frozen=True)
class MethodSpec:
    """A method of the comparison.

    Args:
        name: on the command line.
        title: in tables and figures.
        note: how it works, in a line.
        given: what it is told of the arm, besides the springs K and B.
        settings: what it changes in the configuration, as for ``--set``.
        make: from the configuration of one arm; None: the configured practice strategy and learner.
        stiffer: factors on K and B.
    """

    name: str
    title: str
    note: str
    given: Given = "nothing"
    settings: tuple[str, ...] = ()
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


def _period_s(config: Config) -> float:
    return 1.0 / config.control.rate_hz


def _servo(config: Config) -> Method:
    return servo(_period_s(config))


def _exact(config: Config) -> Method:
    return Feedforward(ExactInverseDynamics(config, config.sim).predict, _period_s(config))


def _usual_servo(config: Config, desired: DesiredTrajectory) -> FloatArray:
    arm = config.arm
    return with_velocity_reference(
        desired, np.array(arm.damping_nms_per_rad) / np.array(arm.stiffness_nm_per_rad)
    )


def _iterative_learning(config: Config) -> Method:
    desired = goal_movement(config)
    return IterativeLearningControl(desired, _usual_servo(config, desired), _period_s(config))


def _virtual_trajectory(config: Config) -> Method:
    desired = goal_movement(config)
    return VirtualTrajectoryLearning(desired, _usual_servo(config, desired), _period_s(config))


def _feedback_error(config: Config) -> Method:
    return FeedbackErrorLearning(new_network(config), _period_s(config))


_ALL = (
    MethodSpec("no_learning", "no learning", "the equilibrium point is the desired position", make=_servo),
    # K times 4 and B times 2 keep the damping ratio.
    MethodSpec(
        "stiffer_servo",
        "stiffer servo (4 K, 2 B)",
        "the same with four times K and twice B, which keeps the damping ratio; does not learn",
        make=_servo,
        stiffer=(4.0, 2.0),
    ),
    MethodSpec(
        "tel_paper",
        "TEL as in the paper",
        "the paper's schedule (15 even steps of the duration), LMS tree, actual trajectory training",
        settings=(*_PAPER, *_LMS, *_ACTUAL),
    ),
    MethodSpec(
        "tel_adaptive_lms",
        "TEL adaptive, LMS tree",
        "the same learner, steps of its own choice",
        settings=(*_ADAPTIVE, *_LMS, *_ACTUAL),
    ),
    MethodSpec(
        "tel_adaptive_least_squares",
        "TEL adaptive, least-squares tree",
        "trees whose weights are solved for over all trials",
        settings=(*_ADAPTIVE, *_LEAST_SQUARES, *_ACTUAL),
    ),
    MethodSpec(
        "tel_adaptive_rigid_body",
        "TEL adaptive, rigid body",
        "parameters of rigid links with friction",
        given="kinematics",
        settings=(*_ADAPTIVE, *_RIGID_BODY, *_ACTUAL),
    ),
    MethodSpec(
        "tel_adaptive_rigid_body_tree",
        "TEL adaptive, rigid body + tree",
        "a tree learns what the rigid links leave",
        given="kinematics",
        settings=(*_ADAPTIVE, *_RIGID_BODY_AND_TREE, *_ACTUAL),
    ),
    MethodSpec(
        "direct_actual",
        "direct, actual training",
        "every trial at the goal speed, LMS tree, actual trajectory training",
        settings=(*_DIRECT, *_LMS, *_ACTUAL),
    ),
    MethodSpec(
        "direct_desired",
        "direct, desired training",
        "likewise, desired trajectory training",
        settings=(*_DIRECT, *_LMS, *_DESIRED),
    ),
    MethodSpec(
        "direct_least_squares",
        "direct, least-squares tree",
        "likewise, the learner of TEL adaptive without its practice strategy",
        settings=(*_DIRECT, *_LEAST_SQUARES, *_ACTUAL),
    ),
    MethodSpec(
        "direct_rigid_body",
        "direct, rigid body",
        "likewise",
        given="kinematics",
        settings=(*_DIRECT, *_RIGID_BODY, *_ACTUAL),
    ),
    MethodSpec(
        "iterative_learning",
        "iterative learning control",
        "P- and D-type with a lead of 50 ms and a zero-phase filter of 10 Hz, begins with û = y + K⁻¹ B ẏ; "
        "gains from a random search on a simulation of the same arm and of two with 0.8 and 1.25 times "
        "its inertia",
        make=_iterative_learning,
    ),
    MethodSpec(
        "virtual_trajectory",
        "virtual-trajectory correction",
        "the virtual trajectory moves by 0.15 of the tracking error, zero-phase filter of 2 Hz; begins and "
        "was tuned likewise",
        make=_virtual_trajectory,
    ),
    MethodSpec(
        "feedback_error",
        "feedback-error learning",
        "the feedback effort trains an LMS tree at the desired inputs, trial by trial, η = 0.1; "
        "û = y + K⁻¹ B ẏ + N(y)",
        settings=_LMS,
        make=_feedback_error,
    ),
    MethodSpec(
        "exact_model",
        "exact inverse dynamics",
        "the simulated masses and frictions from the first trial on: the limit",
        given="model",
        make=_exact,
    ),
)
METHODS: dict[str, MethodSpec] = {spec.name: spec for spec in _ALL}
"""All methods by name."""
