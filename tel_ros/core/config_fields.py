"""What a configuration record declares about its fields, beside their types: ranges, files, units, meanings.

A field's type says it all: ``rate: Annotated[float, Range(0.0, 1.0)] = 0.5``, ``urdf: TextFile``; the text
below the field is its manual. Checks, files, ROS parameters and the reference pages all read these
declarations.
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from operator import attrgetter
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from tel_ros.core.errors import ConfigError

JointValues = tuple[float, ...]
SourceOf = Callable[[str], str | None]
"""From a dotted key to the file or option that it came from."""
Record = TypeVar("Record")


@dataclass(frozen=True)
class Range:
    """The numbers that a field, or each element of a list, may have; always finite."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    """Whether ``low`` itself is excluded."""

    def holds(self, value: float) -> bool:
        """Whether a number is in the range; NaN and infinity never are."""
        above = value > self.low if self.above else value >= self.low
        return above and value <= self.high and abs(value) < math.inf

    def text(self, number: str) -> str:
        """Say it for a ``number``, ``whole number`` or ``numbers``: ``a finite number above 0``."""
        finite = "" if number == "whole number" or self.high < math.inf else "finite "
        text = finite + number if number.endswith("s") else f"a {finite}{number}"
        if self.high < math.inf:
            ends = f"above {self.low:g} and up to" if self.above else f"from {self.low:g} to"
            return f"{text} {ends} {self.high:g}"
        if self.low == -math.inf:
            return text
        return f"{text} {'above' if self.above else 'of at least'} {self.low:g}"


@dataclass(frozen=True)
class FileRole:
    """A file that a key names. A relative name is resolved where the key is read; bags hold the content."""

    binary: bool = False
    """Whether it is stored in Base64, and with the first trial only."""


TextFile = Annotated[str, FileRole()]
BinaryFile = Annotated[str, FileRole(binary=True)]
Finite = Annotated[float, Range()]
Positive = Annotated[float, Range(0.0, above=True)]
NonNegative = Annotated[float, Range(0.0)]
Share = Annotated[float, Range(0.0, 1.0, above=True)]
Factor = Annotated[float, Range(1.0)]
Count = Annotated[int, Range(1)]

_UNITS = {
    **{"_nm_per_rad": "N·m/rad", "_nms_per_rad": "N·m·s/rad", "_nm_per_s": "N·m/s", "_rad_s2": "rad/s²"},
    **{"_rad_s": "rad/s", "_per_s": "1/s", "_rad": "rad", "_nm": "N·m", "_hz": "Hz", "_kg": "kg", "_s": "s"},
}


@dataclass(frozen=True)
class Declared:
    """One field of a record, as declared."""

    name: str
    hint: Any
    """Its type without annotations."""
    doc: str
    """The text below it, on one line."""
    unit: str
    """As its name says; empty if it has none."""
    is_required: bool
    range: Range | None
    """Of the number, or of each element."""
    file: FileRole | None

    @property
    def expected(self) -> str:
        """What the field takes, in words."""
        if self.range and get_origin(self.hint) is tuple:
            return self.range.text("numbers")
        return in_words(self.hint, self.range)


def in_words(hint: Any, limits: Range | None = None) -> str:
    """Say what a type takes."""
    if get_origin(hint) is Literal:
        return " or ".join(map(repr, get_args(hint)))
    if get_origin(hint) is tuple:
        return f"a list, each element {in_words(get_args(hint)[0])}"
    if hint in (int, float):
        number = "whole number" if hint is int else "number"
        return limits.text(number) if limits else f"a {number}"
    return {bool: "true or false", str: "text"}.get(hint, "keys and values")


def declared(record: Any) -> Mapping[str, Declared]:
    """Return what a dataclass declares about its fields, by their names."""
    return _declared(record)


@cache
def _declared(record: Any) -> Mapping[str, Declared]:
    hints, plain, docs = get_type_hints(record, include_extras=True), get_type_hints(record), _docs(record)
    found = {}
    for field in fields(record):
        hint = hints[field.name]
        element = get_args(hint)[0] if get_origin(hint) is tuple else hint
        notes = getattr(element, "__metadata__", ())
        found[field.name] = Declared(
            name=field.name,
            hint=plain[field.name],
            doc=docs.get(field.name, ""),
            unit=next((unit for end, unit in _UNITS.items() if field.name.endswith(end)), ""),
            is_required=field.default is field.default_factory is MISSING,
            range=next((note for note in notes if isinstance(note, Range)), None),
            file=next((note for note in notes if isinstance(note, FileRole)), None),
        )
    return found


def _docs(record: type) -> dict[str, str]:
    body = ast.parse(inspect.getsource(record)).body[0].body  # type: ignore[attr-defined]
    docs = {}
    for field, text in zip(body, body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            docs[ast.unparse(field.target)] = " ".join(str(ast.literal_eval(text.value)).split())
    return docs


class Checked:
    """Base of the records: each refuses values outside its declared ranges and choices when it is made."""

    def __post_init__(self) -> None:
        for name, field in declared(type(self)).items():
            value = getattr(self, name)
            if get_origin(field.hint) is Literal:
                self.require(value in get_args(field.hint), name, field.expected)
            if field.range:
                values = value if isinstance(value, tuple) else (value,)
                self.require(all(map(field.range.holds, values)), name, field.expected)

    def require(self, condition: bool, key: str, expected: str) -> None:
        """Refuse the value of a (dotted) key unless a condition holds; NaN has to make it false."""
        if not condition:
            value = attrgetter(key)(self)
            raise ConfigError(key, list(value) if isinstance(value, tuple) else value, expected)

    def require_one_per_joint(self, joints: Sequence[str], section: str = "") -> None:
        """Refuse lists of numbers without one per joint; those with a default may be empty."""
        for name, field in declared(type(self)).items():
            values = getattr(self, name)
            if field.hint != JointValues or len(values) == len(joints) or not (values or field.is_required):
                continue
            one_each = f"{len(joints)} {field.expected}, one for each of the joints {', '.join(joints)}"
            expected = one_each if field.is_required else f"nothing, or {one_each}"
            raise ConfigError(f"{section}{name}", list(values), expected)


def read_record(
    record: type[Record], raw: Any, source_of: SourceOf = lambda key: None, section: str = ""
) -> Record:
    """Check nested plain values, as read from YAML, against the types of a dataclass, and return them as one.

    Its fields are text, numbers, true or false, literals, anything, dataclasses (or None), or tuples and
    dictionaries of those. ``section`` stands in front of the keys in messages. Raises ConfigError: a key is
    unknown or missing, or a value is wrong.
    """
    fields, prefix = declared(record), f"{section}." if section else ""
    if not isinstance(raw, Mapping):
        raise ConfigError(section, raw, "keys and values", source_of(section))
    for name, value in raw.items():
        if name not in fields:
            key = f"{prefix}{name}"
            raise ConfigError(key, value, f"a known key: {', '.join(fields)}", source_of(key))
    values = {}
    for name, field in fields.items():
        if name in raw or field.is_required:
            key = f"{prefix}{name}"
            if name not in raw:
                raise ConfigError(key, "missing", field.expected, source_of(key))
            values[name] = _read(field.hint, raw[name], key, field.expected, source_of)
    try:
        return record(**values)
    except ConfigError as error:
        full = error.inside(section)
        raise full.inside("", source_of(full.key)) from None


def _read(hint: Any, value: Any, key: str, expected: str, source_of: SourceOf) -> Any:
    """Return a plain value as a field's type. Text like 1e-3, no number in YAML 1.1, counts as one."""
    origin, of = get_origin(hint), get_args(hint)
    if hint is Any:
        return value
    if origin is UnionType:  # with None
        return None if value is None else _read(of[0], value, key, in_words(of[0]), source_of)
    if is_dataclass(hint):
        return read_record(hint, value, source_of, key)  # type: ignore[arg-type]
    if origin is tuple and isinstance(value, list | tuple):
        element = in_words(of[0])
        return tuple(_read(of[0], each, f"{key}.{i}", element, source_of) for i, each in enumerate(value))
    if origin is dict and isinstance(value, Mapping):
        return {
            name: _read(of[1], each, f"{key}.{name}", in_words(of[1]), source_of)
            for name, each in value.items()
        }
    if origin is Literal and value in of:
        return value
    if hint is float and isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    if hint is int and isinstance(value, float) and value.is_integer():
        return int(value)
    if hint in (bool, str, int) and type(value) is hint:
        return value
    raise ConfigError(key, value, expected, source_of(key))
