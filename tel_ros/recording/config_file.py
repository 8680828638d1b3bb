"""Reading a practice run's YAML into records that check themselves, and writing it back.

Which values make sense is declared by the records in :mod:`tel_ros.core.config`. Every complaint names the
file or option, the key, the value and what was expected.
"""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from tel_ros.core.config import Config, file_keys, is_built_in
from tel_ros.core.config_fields import SourceOf, read_record
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.plain_urdf import check_dynamics
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.core.safety.monitors import FrozenReadings
from tel_ros.recording.shared_files import missing, named_file
from tel_ros.recording.urdf import described

RENAMED = {"control.corridor_rad": "control.path_tolerance_rad"}
"""Keys of the previous version, which still work. Files say so with a warning, recorded runs silently."""
_REPLACES = {
    "path.file": ("name", "files"),
    "path.name": ("file", "files"),
    "path.files": ("name", "file"),
    "path.known_file": ("known_name",),
    "path.known_name": ("known_file",),
}
"""Options that take the place of other keys of their section."""


def load_config(
    path: Path | str, overrides: Iterable[str] = (), description: Callable[[], Path] | None = None
) -> Config:
    """Read a practice run, with the arm that it names, and check all of it.

    Args:
        path: YAML file. Its key ``arm`` is the name of an arm description (relative to the file) or the
            description itself; files that either names are as :func:`.shared_files.named_file` finds them.
        overrides: ``a.b=c`` assignments that take the place of values in the files; c is YAML.
        description: gets the file of a robot description from the graph if ``arm.urdf`` is empty; None: there
            is no graph, so it must not be.

    Returns:
        The configuration, with absolute file names and the limits of the joints filled from the URDF.
    """
    path = Path(path)
    raw = read_yaml(path)
    arm_path = path
    if isinstance(raw.get("arm"), str):
        arm_path = path.parent / raw["arm"]
        raw["arm"] = read_yaml(arm_path)

    def file_of(key: str) -> Path:
        return arm_path if key.split(".")[0] == "arm" else path

    for key in file_keys():
        section, name = key.split(".")
        values = raw.get(section)
        if isinstance(values, dict) and name in values:
            values[name] = _resolved(key, values[name], file_of(key).parent)
    source_of = _overridden(raw, overrides, lambda key: str(file_of(key)))
    arm = raw.get("arm")
    if isinstance(arm, dict) and not arm.get("urdf"):
        if description is None:
            raise ConfigError("arm.urdf", "", "a URDF file: robot_description is heard in a graph alone")
        arm["urdf"] = str(description())
    config = _practicable(config_from(_renamed(raw, source_of), source_of), source_of)
    return _with_urdf_limits(config, source_of)


def _practicable(config: Config, source_of: SourceOf) -> Config:
    """Return a configuration whose strategy is there and can do what is asked."""
    try:
        make_strategy(config)
    except ConfigError as error:
        raise error.inside("", source_of(error.key)) from None
    return config


def with_overrides(config: Config, overrides: Iterable[str], keys: tuple[str, ...], source: str) -> Config:
    """Return a configuration with the values of options ``--set`` for some keys.

    ``keys``: sections or single keys that may be given; others are refused. ``source``: where all other
    values come from, for messages.
    """
    overrides = list(overrides)
    for assignment in overrides:
        key = assignment.partition("=")[0].strip()
        if not any(_one_holds_the_other(allowed, key) for allowed in keys):
            expected = f"a key of {', '.join(keys)}: everything else is as in {source}"
            raise ConfigError("--set", assignment, expected)
    raw = to_plain(config)
    return config_from(raw, _overridden(raw, overrides, lambda key: source))


def config_from(raw: Mapping[str, Any], source_of: SourceOf = lambda key: None) -> Config:
    """Return plain values as a configuration; ``source_of``: from a dotted key to its file or option."""
    return read_record(Config, _renamed(raw), source_of)


def to_plain(config: Config) -> dict[str, Any]:
    """Return a configuration as nested dictionaries, lists and scalars."""
    plain: dict[str, Any] = json.loads(json.dumps(dataclasses.asdict(config)))
    return plain


def dump_config(config: Config) -> str:
    """Return a configuration as YAML that :func:`load_config` reads back."""
    dump = partial(yaml.safe_dump, to_plain(config), sort_keys=False, default_flow_style=None)
    text = str(dump(allow_unicode=True))
    # Blanks and line ends that are not ASCII would not be read as they were.
    return text if text.replace("\n", "").isprintable() else str(dump())


def flat_values(config: Config) -> dict[str, Any]:
    """Return a configuration as dotted keys and their values (lists for tuples)."""
    return dict(_flat(to_plain(config)))


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def with_values(config: Config, values: Mapping[str, Any], source: str) -> Config:
    """Return a configuration with other values for some dotted keys, checked like any other."""
    raw = to_plain(config)
    for key, value in values.items():
        _assign(raw, key, value, source)

    def source_of(key: str) -> str | None:
        return source if any(_one_holds_the_other(key, changed) for changed in values) else None

    return _practicable(config_from(raw, source_of), source_of)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the keys and values in a file; InputFileError if it is missing or holds something else."""
    if not path.is_file():
        raise InputFileError(path, missing(path), "a YAML file")
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputFileError(path, f"not readable as YAML ({' '.join(str(error).split())})", "YAML") from None
    if not isinstance(raw, dict):
        raise InputFileError(path, "is empty" if raw is None else f"holds {raw!r:.60}", "keys and values")
    return raw


def _renamed(raw: Mapping[str, Any], warn_of: SourceOf | None = None) -> Mapping[str, Any]:
    """Return the values under today's names; where a value has both names, today's counts."""
    for old, new in RENAMED.items():
        section, name = old.split(".")
        values = raw.get(section)
        if isinstance(values, Mapping) and name in values:
            if warn_of:
                warnings.warn(f"{warn_of(old)}: {old} is called {new} now", FutureWarning, stacklevel=3)
            others = {key: value for key, value in values.items() if key != name}
            raw = {**raw, section: {new.split(".")[1]: values[name], **others}}
    return raw


def _overridden(raw: dict[str, Any], overrides: Iterable[str], source_of: SourceOf) -> SourceOf:
    """Put values in the place of others, and return where each key's value comes from now."""
    options = dict(_override(raw, assignment) for assignment in overrides)

    def source(key: str) -> str | None:
        for option, text in options.items():
            if _one_holds_the_other(key, option):
                return f"--set {text}"
        return source_of(key)

    return source


def _one_holds_the_other(key: str, other: str) -> bool:
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def _resolved(key: str, value: Any, folder: Path) -> Any:
    if isinstance(value, list):
        return [_resolved(key, each, folder) for each in value]
    names_file = key in file_keys() and isinstance(value, str) and value and not is_built_in(key, value)
    return str(named_file(value, folder, key)) if names_file else value


def _override(raw: dict[str, Any], assignment: str) -> tuple[str, str]:
    key, equals, text = assignment.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ConfigError("--set", assignment, "an assignment such as control.path_tolerance_rad=0.5")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise ConfigError(key, text, "a value in YAML", f"--set {assignment}") from None
    if key in RENAMED:
        warnings.warn(f"--set {assignment}: {key} is called {RENAMED[key]} now", FutureWarning, stacklevel=5)
        key = RENAMED[key]
    value = _resolved(key, value, Path.cwd())
    if key in _REPLACES and value and isinstance(raw.get("path"), dict):
        for replaced in _REPLACES[key]:
            raw["path"].pop(replaced, None)
    _assign(raw, key, value, f"--set {assignment}")
    return key, assignment


def _assign(raw: dict[str, Any], key: str, value: Any, source: str) -> None:
    *sections, name = key.split(".")
    values = raw
    for section in sections:
        values = values.setdefault(section, {})
        if not isinstance(values, dict):
            raise ConfigError(key, value, f"a key ({section} is a single value)", source)
    values[name] = value


def _with_urdf_limits(config: Config, source_of: SourceOf) -> Config:
    """Return a configuration with the limits of its URDF, in which there is all that it takes."""
    try:
        arm = described(config.arm)
        filled = dataclasses.replace(config, arm=arm.filled(config.arm))
    except ConfigError as error:
        raise error.inside("", source_of(error.key)) from None
    friction_nm = arm.coulomb_friction_nm
    if config.run.arm == "sim":
        friction_nm = config.sim.coulomb_friction_nm or friction_nm
        check_dynamics(arm, config.arm.hand_link, config.sim.payload_kg)
    if arm.assumed:
        warnings.warn(f"{Path(config.arm.urdf).name}: {arm.assumed}", stacklevel=3)
    stiction_nm = filled.safety.stiction_nm or FrozenReadings.stiction_nm(filled.arm, friction_nm)
    return dataclasses.replace(filled, safety=dataclasses.replace(filled.safety, stiction_nm=stiction_nm))
