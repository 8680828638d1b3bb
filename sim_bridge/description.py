"""The URDF of an arm, as far as its simulation needs it: checked, and put into a form without surprises."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError as XmlError

import numpy as np
from urdf_parser_py.urdf import URDF, Inertia, Inertial, Joint, Link, Pose
from urdf_parser_py.xml_reflection.core import ParseError as UrdfError

from tel_ros.core.config import JointValues
from tel_ros.core.errors import ConfigError, InputFileError

MOVABLE = ("revolute", "continuous")
PAYLOAD_LINK = "tel_ros_payload"


class ArmDescription:
    """What the URDF says about the joints of an arm, in the order of ``joints``.

    Args:
        path: the URDF file.
        joints: names of the joints to move, in any order. A movable joint that carries one of them must be
            named, too. Other movable joints (a gripper's, say) are held at 0.
        hand_link: the link that carries the payload.

    Raises:
        InputFileError: the file cannot be read, or describes an arm that cannot be simulated.
        ConfigError: a name is not in the file, or a joint that carries a named one is not named.
    """

    def __init__(self, path: str | Path, joints: Sequence[str], hand_link: str) -> None:
        self.path, self.joints, self.hand_link = Path(path), tuple(joints), hand_link
        self._refused = partial(InputFileError, self.path)
        self._robot = _read(self.path)
        self._check_structure()
        self._check_names()
        moved = self._selected()
        for joint in moved:
            self._check_joint(joint)
        for joint in self._held():
            self._check_held_joint(joint)
        self.position_min_rad: JointValues = tuple(
            j.limit.lower if j.type == "revolute" else -math.inf for j in moved
        )
        self.position_max_rad: JointValues = tuple(
            j.limit.upper if j.type == "revolute" else math.inf for j in moved
        )
        self.effort_limit_nm: JointValues = tuple(j.limit.effort if j.limit else math.inf for j in moved)
        self.viscous_friction_nms_per_rad: JointValues = tuple(
            (j.dynamics and j.dynamics.damping) or 0.0 for j in moved
        )
        self.coulomb_friction_nm: JointValues = tuple(
            (j.dynamics and j.dynamics.friction) or 0.0 for j in moved
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the file says, or leaves out, that its author may not have meant: one sentence each."""
        held = [joint.name for joint in self._held()]
        remarks = [f"held at 0, because arm.joints does not name them: {', '.join(held)}"] if held else []
        for link in self._moving_links():
            if link.inertial is None and (link.visuals or link.collisions):
                remarks.append(
                    f"link {link.name!r} has a shape, but no <inertial>: it is taken as weightless"
                )
            elif (
                link.inertial and link.inertial.mass == 0.0 and self.link_inertia_trace_kgm2(link.name) > 0.0
            ):
                remarks.append(f"link {link.name!r} has an <inertia>, but no mass: it is taken as written")
        return tuple(remarks)

    def link_inertia_trace_kgm2(self, name: str) -> float:
        """Sum of the principal moments of inertia of a link; 0 without ``<inertial>``."""
        inertial = self._robot.link_map[name].inertial
        inertia = inertial.inertia if inertial and inertial.inertia else Inertia()
        return float(inertia.ixx + inertia.iyy + inertia.izz)

    def check_inertias(self) -> None:
        """Refuse what no body has: PyBullet would silently simulate it without any inertia.

        Raises:
            InputFileError: a link that moves has a negative moment, or one above the sum of the two others.
        """
        for link in self._moving_links():
            inertia = (link.inertial and link.inertial.inertia) or Inertia()
            matrix = np.array(inertia.to_matrix())
            moments = np.linalg.eigvalsh(matrix) if np.all(np.isfinite(matrix)) else np.full(3, np.nan)
            rounding = 1e-9 * abs(moments).max()
            if not (moments[0] >= -rounding and moments[2] <= moments[0] + moments[1] + rounding):
                found = ", ".join(f"{moment:.4g}" for moment in moments)
                raise self._refused(
                    f"link {link.name!r} has an <inertia> that no body has (principal moments {found} kg·m²)",
                    "principal moments of at least 0, none above the sum of the two others",
                )

    def for_simulation(self, *, inertia_scale: float, payload_kg: float, visuals: bool) -> str:
        """Return a URDF that a simulator cannot misunderstand.

        A link without ``<inertial>`` has no mass, as the format means it (PyBullet would give it 1 kg).
        Joints that are not to move are fixed at 0. Friction and shapes to collide with are left out.

        Args:
            inertia_scale: factor on the masses and inertias of the links, not on the payload.
            payload_kg: point mass at the origin of the hand link.
            visuals: keep the visual shapes; the paths of meshes are made absolute.
        """
        robot = URDF(name=self._robot.name)
        if visuals:
            for material in self._robot.materials:
                robot.add_aggregate("material", material)
        for link in self._robot.links:
            plain = Link(name=link.name, inertial=_scaled(link.inertial, inertia_scale))
            for visual in link.visuals if visuals else ():
                self._make_mesh_path_absolute(visual.geometry)
                plain.add_aggregate("visual", visual)
            robot.add_link(plain)
        for joint in self._robot.joints:
            plain = Joint(joint.name, joint.parent, joint.child, "fixed", origin=joint.origin)
            if joint.name in self.joints:
                plain.type, plain.axis, plain.limit = joint.type, joint.axis, joint.limit
            robot.add_joint(plain)
        if payload_kg:
            point_mass = Inertial(mass=payload_kg, inertia=Inertia(), origin=_identity())
            robot.add_link(Link(name=PAYLOAD_LINK, inertial=point_mass))
            mount = Joint(f"{PAYLOAD_LINK}_mount", self.hand_link, PAYLOAD_LINK, "fixed", origin=_identity())
            robot.add_joint(mount)
        return str(robot.to_xml_string())

    def _selected(self) -> list[Any]:
        return [self._robot.joint_map[name] for name in self.joints]

    def _held(self) -> list[Any]:
        return [j for j in self._robot.joints if j.type != "fixed" and j.name not in self.joints]

    def _moving_links(self) -> list[Any]:
        """Return the links that a named joint carries, directly or not."""
        moving = [joint.child for joint in self._selected()]
        for link in moving:
            moving.extend(child for _, child in self._robot.child_map.get(link, []) if child not in moving)
        return [link for link in self._robot.links if link.name in moving]

    def _check_structure(self) -> None:
        robot = self._robot
        for kind, elements in (("link", robot.links), ("joint", robot.joints)):
            names = [element.name for element in elements]
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise self._refused(f"{kind} {twice[0]!r} is there twice", f"each {kind} once")
        for joint in robot.joints:
            for end in (joint.parent, joint.child):
                if end not in robot.link_map:
                    found = f"joint {joint.name!r} is attached to {end!r}"
                    raise self._refused(found, "links that are in the file")
        children = [joint.child for joint in robot.joints]
        for name in children:
            if children.count(name) > 1:
                raise self._refused(f"link {name!r} has two parents", "one tree of links")
        roots = [name for name in robot.link_map if name not in children]
        connected = list(roots[:1])
        for link in connected:
            connected.extend(child for _, child in robot.child_map.get(link, []))
        if sorted(connected) != sorted(robot.link_map):
            found = f"its links form no tree (links without a parent: {', '.join(roots) or 'none'})"
            raise self._refused(found, "one tree of links")
        for link in robot.links:
            mass_kg = link.inertial.mass if link.inertial else 0.0
            if not 0.0 <= mass_kg < math.inf:
                found = f"link {link.name!r} has the mass {mass_kg}"
                raise self._refused(found, "a finite number of at least 0")

    def _check_names(self) -> None:
        robot = self._robot
        movable = [joint.name for joint in robot.joints if joint.type != "fixed"]
        here = f"of {self.path}, which has {', '.join(movable) or 'none'}"
        missing = [name for name in self.joints if name not in movable]
        if missing:
            raise ConfigError("arm.joints", missing[0], f"a movable joint {here}")
        for name in self.joints:
            joint = robot.joint_map[name]
            while joint.parent in robot.parent_map:
                joint = robot.joint_map[robot.parent_map[joint.parent][0]]
                if joint.type != "fixed" and joint.name not in self.joints:
                    expected = f"also {joint.name!r}, which carries {name!r}, {here}"
                    raise ConfigError("arm.joints", list(self.joints), expected)
        if self.hand_link not in robot.link_map:
            links = ", ".join(robot.link_map)
            raise ConfigError("arm.hand_link", self.hand_link, f"a link of {self.path}, which has {links}")

    def _check_joint(self, joint: Any) -> None:
        def refuse(found: str, expected: str) -> InputFileError:
            return self._refused(f"joint {joint.name!r} {found}", expected)

        if joint.type not in MOVABLE:
            raise refuse(f"is {joint.type}", f"one of the types {' and '.join(MOVABLE)}")
        if joint.mimic:
            raise refuse(f"mimics {joint.mimic.joint!r}", "joints that move on their own")
        limit = joint.limit
        if joint.type == "revolute":
            if not limit:
                raise refuse("has no <limit>", "a <limit> in every revolute joint")
            if not -math.inf < limit.lower < limit.upper < math.inf:
                raise refuse(
                    f"has the range {limit.lower} to {limit.upper}", "finite limits, lower below upper"
                )
        if limit and not 0.0 < limit.effort < math.inf:
            raise refuse(f"has the effort limit {limit.effort}", "a finite number of N·m above 0")
        for key in ("damping", "friction"):
            value = getattr(joint.dynamics, key, None) or 0.0
            if not 0.0 <= value < math.inf:
                raise refuse(f"has the {key} {value}", "a finite number of at least 0")

    def _check_held_joint(self, joint: Any) -> None:
        limit = joint.limit
        if limit and joint.type in ("revolute", "prismatic") and not limit.lower <= 0.0 <= limit.upper:
            raise self._refused(
                f"joint {joint.name!r} has the range {limit.lower} to {limit.upper}",
                "a range with 0 in it, because arm.joints does not name this joint and it is held there",
            )

    def _make_mesh_path_absolute(self, geometry: Any) -> None:
        # The simulator reads a copy of the file that lies elsewhere.
        filename = getattr(geometry, "filename", None)
        if filename is None:
            return
        relative = filename.removeprefix("package://").removeprefix("file://")
        # "package://name/meshes/a.stl" is looked for above the URDF, with and without the package's name.
        tails = [relative, relative.partition("/")[2]] if filename.startswith("package://") else [relative]
        for folder in self.path.resolve().parents:
            for tail in tails:
                if (folder / tail).is_file():
                    geometry.filename = str(folder / tail)
                    return


def _read(path: Path) -> Any:
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputFileError(path, f"cannot be read ({error.strerror})", "a URDF file") from error
    try:
        return URDF.from_xml_string(text)
    except (XmlError, UrdfError, ValueError, AssertionError) as error:
        reason = " ".join(str(error).split())
        raise InputFileError(path, f"is not a URDF ({reason})", "a URDF file") from error


def _identity() -> Pose:
    return Pose(xyz=[0.0, 0.0, 0.0], rpy=[0.0, 0.0, 0.0])


def _scaled(inertial: Inertial | None, factor: float) -> Inertial:
    if inertial is None:
        return Inertial(mass=0.0, inertia=Inertia(), origin=_identity())
    old = inertial.inertia or Inertia()
    inertia = Inertia(**{key: getattr(old, key) * factor for key in Inertia.KEYS})
    return Inertial(mass=inertial.mass * factor, inertia=inertia, origin=inertial.origin or _identity())
