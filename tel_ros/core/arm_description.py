"""What a URDF says of an arm: read as far as it is used, and put into a form without surprises.

Simulation, kinematics, learners and views all read the form that is made here: axes have length 1, and joints
that the arm does not move are fixed where they are held. What nobody uses may be nonsense.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np

from tel_ros.core.config import ArmConfig, JointValues
from tel_ros.core.errors import ConfigError, InputFileError, look_alikes
from tel_ros.core.kinematics import ChainJoint, LinkJoint, SerialChain
from tel_ros.core.urdf import NOWHERE, Joint, Urdf

TURNING = ("revolute", "continuous")
MOVABLE = (*TURNING, "prismatic")
"""Types of joints that have one position."""
_KNOWN = (*MOVABLE, "fixed", "floating", "planar")
ENDLESS_RAD = 1e6
"""Range of a joint that turns without end."""
_MOST_NAMES = 8


class Limit(NamedTuple):
    """What the file says of a joint's limits, as far as it can be used."""

    range_rad: tuple[float, float] | None
    """None: none that has a width."""
    effort_nm: float
    """inf: none."""
    velocity_rad_s: float
    """inf: none."""


class ArmDescription:
    """What a URDF says of an arm whose ``joints`` move; tuples have one value for each, in that order.

    A movable joint that carries one of them must be among them, or be held where ``held`` says. Others are
    held there as well, or as near to 0 as their range permits; joints that mimic one follow it. Raises
    InputFileError: the file says nonsense of what is used; ConfigError: a joint is not there or cannot move,
    or is carried by one that is not held.
    """

    def __init__(self, urdf: Urdf, joints: Sequence[str], held: Mapping[str, float] | None = None) -> None:
        self.urdf, self.joints = urdf, tuple(joints)
        self._given = dict(held or {})
        self._check_names()
        self.moving = {link for name in joints for link in urdf.below(urdf.joints[name].child)}
        """Links that a named joint carries, directly or not."""
        used = {joint.name for link in self.moving for joint in urdf.way_to(link)}
        self.held: dict[str, float] = {}
        """Where the other movable joints are, rad or m."""
        self.placed: dict[str, ChainJoint] = {}
        """Every joint of the file as it is placed in this arm."""
        for joint in urdf.joints.values():
            try:
                self._hold(joint, ())
                self.placed[joint.name] = self._placed(joint)
            except InputFileError:
                if joint.name in used:
                    raise
                nowhere = np.zeros(3)
                self.placed[joint.name] = ChainJoint(nowhere, nowhere, np.array([1.0, 0.0, 0.0]), None)
        self.limits = tuple(self._limit(urdf.joints[name]) for name in joints)
        self.viscous_friction_nms_per_rad = self._friction("damping")
        self.coulomb_friction_nm = self._friction("friction")

    @classmethod
    def of(cls, urdf: Urdf, arm: ArmConfig) -> ArmDescription:
        """Return the description of a configured arm: its joints turn, and nothing else moves by itself."""
        try:
            found = cls(urdf, arm.joints, arm.held)
            for name in arm.joints:
                if urdf.joints[name].kind not in TURNING:
                    raise ConfigError("joints", name, f"joints that turn: {name} slides, in m and N")
                for joint in urdf.way_to(urdf.joints[name].parent):
                    if joint.name in found.held and joint.name not in arm.held:
                        also = f"also {joint.name!r}, which carries {name!r}, or its position in arm.held"
                        raise ConfigError("joints", list(arm.joints), also)
            found._check_held()
            found.chain(arm.hand_link)
        except ConfigError as error:
            raise error.inside("arm") from None
        return found

    @property
    def assumed(self) -> str:
        """Where joints are held that nobody has spoken of; empty: there are none."""
        at = [f"{name} at {place:g}" for name, place in self.held.items() if name not in self._given]
        return f"held, as neither arm.joints nor arm.held names them: {listed(at)}" if at else ""

    @property
    def as_written(self) -> bool:
        """Whether another reader of the file, who takes joints at 0, sees the same arm."""
        axes = {name: self.urdf.axis(self.urdf.joints[name]) for name in self.joints}
        same = all(tuple(self.placed[name].axis) == axis for name, axis in axes.items())
        return same and not any(self.held.values())

    def filled(self, arm: ArmConfig) -> ArmConfig:
        """Return the arm with its empty limits filled from the file.

        Raises ConfigError: a limit is in neither, or goes beyond the file's: what the motor cannot do is
        clipped behind the controller's back, and learned from as if it had acted.
        """
        for name, limit in zip(self.joints, self.limits, strict=True):
            no_limit = limit.velocity_rad_s == math.inf
            missing = {"velocity_limit_rad_s": "no velocity limit"} if no_limit else {}
            if limit.range_rad is None:
                found = self.urdf.joints[name].element.find("limit")
                ends = "" if found is None else f" ({found.get('lower', 0)} to {found.get('upper', 0)})"
                missing |= dict.fromkeys(("position_min_rad", "position_max_rad"), f"no range{ends}")
            for key, what in missing.items():
                if not getattr(arm, key):
                    expected = f"one value for each joint: {self.urdf.path} gives {name} {what}"
                    raise ConfigError(f"arm.{key}", [], expected)
        ranges = [limit.range_rad or (-math.inf, math.inf) for limit in self.limits]
        low = tuple(max(low, -ENDLESS_RAD) for low, _ in ranges)
        high = tuple(min(high, ENDLESS_RAD) for _, high in ranges)
        filled = dataclasses.replace(
            arm,
            position_min_rad=arm.position_min_rad or low,
            position_max_rad=arm.position_max_rad or high,
            velocity_limit_rad_s=arm.velocity_limit_rad_s or tuple(lim.velocity_rad_s for lim in self.limits),
        )
        efforts = [limit.effort_nm for limit in self.limits]
        for key, least, most in (
            ("effort_limit_nm", (0.0,) * len(low), efforts),
            ("position_min_rad", low, high),
            ("position_max_rad", low, high),
        ):
            values = getattr(filled, key)
            for name, value, a, b in zip(self.joints, values, least, most, strict=True):
                if not a <= value <= b:
                    expected = f"{a:g} to {b:g} for {name}, as in the URDF"
                    raise ConfigError(f"arm.{key}", list(values), expected)
        return filled

    def stops_rad(self, arm: ArmConfig) -> tuple[JointValues, JointValues]:
        """Return between which positions the joints of the body itself can move: ±inf without end."""
        own = zip(arm.position_min_rad, arm.position_max_rad, strict=True) if arm.position_min_rad else ()
        configured = list(own) or [(-math.inf, math.inf)] * len(self.joints)
        ranges = [limit.range_rad or pair for limit, pair in zip(self.limits, configured, strict=True)]
        return tuple(low for low, _ in ranges), tuple(high for _, high in ranges)

    def chain(self, hand_link: str) -> SerialChain:
        """Return the joints from the root to the hand; ConfigError if there is no such link."""
        if hand_link not in self.urdf.links:
            raise ConfigError("hand_link", hand_link, f"a link of {self._has(hand_link, self.urdf.links)}")
        return SerialChain(tuple(self.placed[joint.name] for joint in self.urdf.way_to(hand_link)))

    @property
    def link_joints(self) -> tuple[LinkJoint, ...]:
        """All joints of the file, in its order."""
        return tuple(LinkJoint(j.parent, j.child, self.placed[j.name]) for j in self.urdf.joints.values())

    def _check_names(self) -> None:
        movable = [joint.name for joint in self.urdf.joints.values() if joint.kind in MOVABLE]
        for name in self.joints:
            if name not in movable:
                raise ConfigError("joints", name, f"a movable joint of {self._has(name, movable)}")
        others = [name for name in movable if name not in self.joints]
        for name in self._given:
            if name not in others:
                expected = f"a joint that arm.joints does not name, of {self._has(name, others)}"
                raise ConfigError("held", name, expected)

    def _check_held(self) -> None:
        """Refuse positions that a joint cannot have, and joints that follow others by themselves."""
        for name, value in self._given.items():
            low, high = self._range(self.urdf.joints[name]) or (-math.inf, math.inf)
            if not (low <= value <= high and math.isfinite(value)):
                expected = f"{low:g} to {high:g} for {name}, as in the URDF"
                raise ConfigError("held", {name: value}, expected)
        for joint in (each for each in self.urdf.joints.values() if each.child in self.moving):
            leader = (self._mimicked(joint) or ("",))[0] if joint.kind in MOVABLE else ""
            if leader and joint.name in self.joints:
                expected = f"joints that move on their own: {joint.name} mimics {leader!r}"
                raise ConfigError("joints", joint.name, expected)
            if leader in self.joints and joint.name not in self._given:
                expected = f"{{{joint.name}: POSITION}} in it: it mimics {leader!r}, but would be held"
                raise ConfigError("held", self._given, expected)

    def _has(self, name: str, names: Sequence[str] | Mapping[str, object]) -> str:
        alike = look_alikes(name, names) or get_close_matches(name, list(names), cutoff=0.5)
        perhaps = f"; perhaps {alike[0]!r} is meant" if alike else ""
        return f"the URDF (it has {', '.join(names) or 'none'}{perhaps})"

    def _mimicked(self, joint: Joint) -> tuple[str, float, float] | None:
        """Return which joint another one follows, how many times as far, and from where."""
        mimic = joint.element.find("mimic")
        if mimic is None or mimic.get("joint") is None:
            return None
        (ratio,) = self.urdf.numbers(joint.element, "mimic", "multiplier", (1.0,))
        (offset,) = self.urdf.numbers(joint.element, "mimic", "offset", (0.0,))
        return mimic.get("joint", ""), ratio, offset

    def _hold(self, joint: Joint, followers: tuple[str, ...]) -> float:
        """Return where a joint is held, as ``self.held`` does from now on; ``followers`` wait for that."""
        name = joint.name
        if joint.kind not in MOVABLE or name in self.joints or name in self.held:
            return self.held.get(name, 0.0)
        low, high = self._range(joint) or (-math.inf, math.inf)
        place = self._given.get(name, min(max(0.0, low), high))
        if name not in self._given and (mimicked := self._mimicked(joint)) is not None:
            leader, ratio, offset = mimicked
            if leader in self.urdf.joints and leader not in (*followers, name):
                place = offset + ratio * self._hold(self.urdf.joints[leader], (*followers, name))
        self.held[name] = place
        return place

    def _range(self, joint: Joint) -> tuple[float, float] | None:
        """Return the range of a joint; None: there is none that can be used."""
        if joint.kind == "continuous":
            return -math.inf, math.inf
        (low,) = self.urdf.numbers(joint.element, "limit", "lower", (0.0,), finite=False)
        (high,) = self.urdf.numbers(joint.element, "limit", "upper", (0.0,), finite=False)
        return (low, high) if -math.inf < low < high < math.inf else None

    def _limit(self, joint: Joint) -> Limit:
        found = []
        for key in ("effort", "velocity"):
            (value,) = self.urdf.numbers(joint.element, "limit", key, (math.inf,), finite=False)
            found.append(value if value > 0.0 else math.inf)
        return Limit(self._range(joint), *found)

    def _friction(self, key: str) -> JointValues:
        found = []
        for name in self.joints:
            (value,) = self.urdf.numbers(self.urdf.joints[name].element, "dynamics", key, (0.0,))
            if value < 0.0:
                raise self.urdf.refused(f"joint {name!r} has the {key} {value}", "a number of at least 0")
            found.append(value)
        return tuple(found)

    def _placed(self, joint: Joint) -> ChainJoint:
        """Return a joint as it is in this arm: fixed where it is held."""
        if joint.kind not in _KNOWN:
            expected = "revolute, continuous, prismatic or fixed"
            raise self.urdf.refused(f"joint {joint.name!r} is of the type {joint.kind!r}", expected)
        index = self.joints.index(joint.name) if joint.name in self.joints else None
        held, axis = self.held.get(joint.name, 0.0), np.array([1.0, 0.0, 0.0])
        if held or index is not None:
            written = self.urdf.axis(joint)
            axis = np.array([value / math.hypot(*written) for value in written])
        place = np.array(self.urdf.numbers(joint.element, "origin", "xyz", NOWHERE))
        rpy = np.array(self.urdf.numbers(joint.element, "origin", "rpy", NOWHERE))
        found = ChainJoint(place, rpy, axis, index, joint.kind == "prismatic")
        if not held:
            return found
        places, turned = dataclasses.replace(found, index=0).placements(np.array([[held]]))
        from scipy.spatial.transform import Rotation  # late: few arms have such a joint

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of gimbal lock: any of the angles will do
            rpy = Rotation.from_matrix(turned).as_euler("xyz")[0]
        return dataclasses.replace(found, origin_m=places[0], origin_rpy_rad=rpy)


def listed(names: Sequence[str]) -> str:
    """Return names on a line, but not dozens."""
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
