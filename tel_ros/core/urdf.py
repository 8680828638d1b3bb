"""A URDF file as a tree of named links and joints, decoded; what stands in them is read when it is used."""

from __future__ import annotations

import codecs
import math
import re
from typing import NamedTuple
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from tel_ros.core.errors import InputFileError

EXPECTED = "a URDF file (key arm.urdf)"
NOWHERE = (0.0, 0.0, 0.0)
_MARKS = {
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
    b"<\0?\0": "utf-16-le",
    b"\0<\0?": "utf-16-be",
}
DECLARATION = re.compile(r"""(<\?xml\b[^>]*?)\s+encoding\s*=\s*["']([\w.:-]*)["']""")
_NOT_A_URDF = {
    r"<!doctype html|<html": "is an HTML page, as a server sends it for a file that it does not have",
    r"version https://git-lfs": "is a pointer of Git LFS: the file itself was not fetched (git lfs pull)",
}


class Joint(NamedTuple):
    """A joint of the file, between two of its links."""

    name: str
    kind: str
    parent: str
    child: str
    element: Element


class Urdf:
    """A file, parsed; InputFileError about ``path`` if it is none or its links form no tree.

    ``text``: decoded as it declares, in a form that can be encoded as UTF-8.
    """

    def __init__(self, content: bytes, path: object) -> None:
        self.path = path
        self.text = self._decoded(content)
        robot = self._parsed(self.text.strip("\ufeff\0\x1a \t\r\n"))
        self.materials = robot.findall("material")
        self.links = dict(self._named(robot, "link"))
        if not self.links:
            raise self.refused("has no links", EXPECTED)
        self.joints = {
            name: Joint(name, each.get("type", ""), self._end(each, "parent"), self._end(each, "child"), each)
            for name, each in self._named(robot, "joint")
        }
        self.carried: dict[str, list[Joint]] = {name: [] for name in self.links}
        """The joints that a link carries."""
        self.carrier: dict[str, Joint] = {}
        """The joint that carries a link; the root has none."""
        for joint in self.joints.values():
            if joint.child in self.carrier:
                raise self.refused(f"link {joint.child!r} has two parents", "one tree of links")
            self.carrier[joint.child] = joint
            self.carried[joint.parent].append(joint)
        roots = [name for name in self.links if name not in self.carrier]
        if len(roots) != 1 or len(self.below(roots[0])) != len(self.links):
            found = f"its links form no tree (links without a parent: {', '.join(roots) or 'none'})"
            raise self.refused(found, "one tree of links")
        self.root = roots[0]

    def refused(self, found: str, expected: str) -> InputFileError:
        """Return an error about this file."""
        return InputFileError(self.path, found, expected)

    def below(self, link: str) -> list[str]:
        """Return a link and all that it carries, directly or not, parents first."""
        found = [link]
        for each in found:
            found.extend(joint.child for joint in self.carried[each])
        return found

    def way_to(self, link: str) -> list[Joint]:
        """Return the joints from the root to a link."""
        way: list[Joint] = []
        while (joint := self.carrier.get(link)) is not None:
            way.append(joint)
            link = joint.parent
        return way[::-1]

    def numbers(
        self, element: Element, tag: str, attribute: str, default: tuple[float, ...], *, finite: bool = True
    ) -> tuple[float, ...]:
        """Return numbers below an element; the default, which says how many, if nothing is there."""
        found = element.find(tag)
        text = None if found is None else found.get(attribute)
        if text is None:
            return default
        try:
            values = tuple(map(float, text.split()))
        except ValueError:
            values = ()
        if len(values) == len(default) and (not finite or all(map(math.isfinite, values))):
            return values
        if "${" in text or "$(" in text:
            raise self._xacro(f'{attribute}="{text}"')
        number = "a finite number" if len(default) == 1 else f"{len(default)} finite numbers"
        what = f"{element.tag} {element.get('name', '')!r}" if element.get("name") else f"an <{element.tag}>"
        raise self.refused(f'{what} has <{tag} {attribute}="{text}">', number)

    def axis(self, joint: Joint) -> tuple[float, ...]:
        """Return the axis of a joint as it is written, of any length but 0."""
        axis = self.numbers(joint.element, "axis", "xyz", (1.0, 0.0, 0.0))
        if not any(axis):
            raise self.refused(f"joint {joint.name!r} has an <axis> of zeros", "a direction")
        return axis

    def _decoded(self, content: bytes) -> str:
        marked = next((name for mark, name in _MARKS.items() if content.startswith(mark)), "")
        declared = DECLARATION.match(content[:300].decode("latin-1").lstrip())
        name = marked or (declared and declared[2]) or "utf-8"
        said = f"declares the encoding {name!r}" if declared or marked else "declares no encoding"
        wide = re.match(r"utf.?(16|32)|ucs|iso.?10646", name, re.IGNORECASE)
        try:
            if wide and not marked:
                raise ValueError("its first bytes are those of another")
            text = content.decode(name)
        except (ValueError, LookupError) as error:
            raise self.refused(f"{said}, and cannot be decoded so ({error})", EXPECTED) from error
        return text if name.lower() in ("utf-8", "utf8") else DECLARATION.sub(r"\1", text, count=1)

    def _parsed(self, text: str) -> Element:
        for start, what in _NOT_A_URDF.items():
            if re.match(start, text, re.IGNORECASE):
                raise self.refused(what, EXPECTED)
        # Without namespaces, like the parsers of other tools: prefixes that nobody declared are common.
        builder, parser = TreeBuilder(), expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
        try:
            parser.Parse(text, True)
            robot: Element = builder.close()
        except (expat.ExpatError, ValueError) as error:
            raise self.refused(f"not a readable URDF ({error})" if text else "is empty", EXPECTED) from error
        if robot.tag != "robot":
            raise self.refused(f"not a readable URDF (it is <{robot.tag}>, not <robot>)", EXPECTED)
        for element in (robot, *robot.iterfind("link"), *robot.iterfind("joint")):
            if left := next((each.tag for each in element if each.tag.startswith("xacro:")), ""):
                raise self._xacro(f"<{left}>")
        return robot

    def _xacro(self, found: str) -> InputFileError:
        return self.refused(f"is a xacro file ({found})", "a URDF file made of it: xacro FILE > FILE.urdf")

    def _named(self, robot: Element, tag: str) -> list[tuple[str, Element]]:
        found, names = [], set()
        for element in robot.iterfind(tag):
            name = element.get("name", "")
            if "${" in name or "$(" in name:
                raise self._xacro(f'{tag} name="{name}"')
            if not name or name in names:
                what = f"{tag} {name!r} is there twice" if name else f"a {tag} has no name"
                raise self.refused(what, f"each {tag} once, by a name")
            names.add(name)
            found.append((name, element))
        return found

    def _end(self, joint: Element, end: str) -> str:
        found = joint.find(end)
        link = "" if found is None else found.get("link", "")
        if link not in self.links:
            what = f"joint {joint.get('name')!r} is attached to {link!r}" if link else ""
            what = what or f"joint {joint.get('name')!r} has no <{end}>"
            raise self.refused(what, "links that are in the file")
        return link
