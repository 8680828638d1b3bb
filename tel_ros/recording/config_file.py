"""Reading a practice run's YAML into records that check themselves, and writing it back.

A library checks structure and types; what values make sense is checked by the records in
:mod:`tel_ros.core.config`. Every complaint names the file or option, the key, the value and what was
expected.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import pydantic
import yaml

from tel_ros.core.config import Config, JointValues
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.shipped import config_folder
from tel_ros.recording.urdf import chain_to_hand, joint_limits, read_urdf, urdf_file

SourceOf = Callable[[str], str | None]
"""From a dotted key to the file or option that it came from."""

RENAMED = {"control.corridor_rad": "control.path_tolerance_rad"}
"""Keys of the version before, which still work. Files say so with a warning, recorded runs silently."""

_PYDANTIC_1 = pydantic.VERSION.startswith("1.")


def _no_truth_value(cls: Any, value: Any) -> Any:
    if any(isinstance(item, bool) for item in (value if isinstance(value, list | tuple) else [value])):
        raise ValueError("a number")
    return value


def _model_of(record: Any) -> type[pydantic.BaseModel]:
    """Return a model with the fields of a dataclass that refuses unknown keys, nested ones included."""
    fields: dict[str, Any] = {}
    hints = get_type_hints(record)
    for field in dataclasses.fields(record):
        hint = hints[field.name]
        required = field.default is field.default_factory is dataclasses.MISSING
        kind: Any = _model_of(hint) if dataclasses.is_dataclass(hint) else hint
        if _PYDANTIC_1 and hint is int:
            kind = pydantic.StrictInt  # its plain integers cut 2.5 down to 2
        # Defaults are never used (see exclude_unset), but one of None would let pydantic 1 accept None.
        fields[field.name] = (kind, ... if required else "unset")
    config: Any = type("Config", (), {"extra": "forbid"}) if _PYDANTIC_1 else {"extra": "forbid"}
    # pydantic takes true for 1.
    numbers = [name for name, hint in hints.items() if hint in (int, float, JointValues)]
    before = {"pre": True, "allow_reuse": True} if _PYDANTIC_1 else {"mode": "before"}
    validator: Any = pydantic.validator if _PYDANTIC_1 else pydantic.field_validator
    checks = {"no_truth_value": validator(*numbers, **before)(_no_truth_value)} if numbers else {}
    return pydantic.create_model(record.__name__, __config__=config, __validators__=checks, **fields)


_MODEL = _model_of(Config)


def default_config_file() -> Path:
    """Return the paper's protocol, as it lies in a checkout or as it was installed."""
    return config_folder() / "paper.yaml"


def load_config(path: Path | str, overrides: Iterable[str] = ()) -> Config:
    """Read a practice run, with the arm that it names, and check all of it.

    Args:
        path: YAML file. Its key ``arm`` is the name of an arm description (relative to the file) or the
            description itself; ``path.file`` is relative to the file, ``arm.urdf`` to the arm description, or
            in a package (see :func:`~tel_ros.recording.urdf.urdf_file`).
        overrides: ``a.b=c`` assignments that take the place of values in the files; c is YAML.

    Returns:
        The configuration, with absolute file names and the limits of the joints filled from the URDF.

    Raises:
        InputFileError: a file is missing or unreadable.
        ConfigError: a key is unknown, or a value is wrong.
    """
    path = Path(path)
    raw = read_yaml(path)
    arm_path = path
    if isinstance(raw.get("arm"), str):
        arm_path = path.parent / raw["arm"]
        raw["arm"] = read_yaml(arm_path)
    _resolve(raw, "path", "file", path.parent)
    _resolve(raw, "path", "known_file", path.parent)
    _resolve(raw, "learning", "start_from", path.parent)
    _resolve(raw, "arm", "urdf", arm_path.parent, urdf_file)
    source_of = _overridden(raw, overrides, lambda key: str(arm_path if key.split(".")[0] == "arm" else path))
    for old, new in RENAMED.items():
        if _value(raw, old) is not None:
            warnings.warn(f"{source_of(old)}: {old} is called {new} now", FutureWarning, stacklevel=2)
    config = config_from(raw, source_of)
    return _with_urdf_limits(config, source_of)


def with_overrides(config: Config, overrides: Iterable[str], keys: tuple[str, ...], source: str) -> Config:
    """Return a configuration with other values for some keys, as given by options ``--set``.

    Args:
        config: the configuration.
        overrides: as for :func:`load_config`.
        keys: which may be given: sections, or single keys.
        source: where the other values come from, for messages.

    Raises:
        ConfigError: a key is unknown or not to be given, or a value is wrong.
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
    """Check nested plain values and return them as a configuration.

    Args:
        raw: as read from YAML.
        source_of: from a dotted key to the file or option that it came from, for messages.

    Raises:
        ConfigError: a key is unknown, or a value is wrong.
    """
    raw = _renamed(raw)
    try:
        model = _MODEL.parse_obj(raw) if _PYDANTIC_1 else _MODEL.model_validate(raw)
    except pydantic.ValidationError as error:
        raise _first_complaint(error, raw, source_of) from None
    given = model.dict(exclude_unset=True) if _PYDANTIC_1 else model.model_dump(exclude_unset=True)
    config: Config = _build(Config, given, "", source_of)
    return config


def to_plain(config: Config) -> dict[str, Any]:
    """Return a configuration as nested dictionaries, lists and scalars."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        return [plain(item) for item in value] if isinstance(value, list | tuple) else value

    result: dict[str, Any] = plain(dataclasses.asdict(config))
    return result


def dump_config(config: Config) -> str:
    """Return a configuration as YAML that :func:`load_config` reads back."""
    return str(yaml.safe_dump(to_plain(config), sort_keys=False, default_flow_style=None, allow_unicode=True))


def flat_values(config: Config) -> dict[str, Any]:
    """Return a configuration as dotted keys and their values (lists for tuples)."""
    flat: dict[str, Any] = {}
    for section, values in to_plain(config).items():
        if isinstance(values, dict):
            flat.update({f"{section}.{key}": value for key, value in values.items()})
        else:
            flat[section] = values
    return flat


def with_values(config: Config, values: Mapping[str, Any], source: str) -> Config:
    """Return a configuration with other values for some dotted keys, checked like any other.

    Raises:
        ConfigError: a key is unknown, or a value is wrong.
    """
    raw = to_plain(config)
    for key, value in values.items():
        _assign(raw, key, value, source)

    def source_of(key: str) -> str | None:
        return source if any(_one_holds_the_other(key, changed) for changed in values) else None

    return config_from(raw, source_of)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the keys and values in a file.

    Raises:
        InputFileError: it is missing or unreadable, or holds something else.
    """
    if not path.is_file():
        raise InputFileError(path, "there is no such file", "a YAML file")
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputFileError(path, f"not readable as YAML ({' '.join(str(error).split())})", "YAML") from None
    if not isinstance(raw, dict):
        raise InputFileError(path, f"holds {type(raw).__name__}", "keys and values")
    return raw


def _value(raw: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key; None if there is none."""
    value: Any = raw
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _renamed(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the values under today's names."""
    for old, new in RENAMED.items():
        if (value := _value(raw, old)) is not None and _value(raw, new) is None:
            (section, before), after = old.split("."), new.split(".")[1]
            kept = {key: item for key, item in raw[section].items() if key != before}
            raw = {**raw, section: {**kept, after: value}}
    return raw


def _overridden(raw: dict[str, Any], overrides: Iterable[str], source_of: Callable[[str], str]) -> SourceOf:
    """Put values in the place of others, and return where each key's value comes from now."""
    options = dict(_override(raw, assignment) for assignment in overrides)

    def source(key: str) -> str:
        for option, text in options.items():
            if _one_holds_the_other(key, option):
                return f"--set {text}"
        return source_of(key)

    return source


def _one_holds_the_other(key: str, other: str) -> bool:
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def _beside(name: str, folder: Path) -> Path:
    return (folder / name).resolve()


def _resolve(
    raw: dict[str, Any],
    section: str,
    key: str,
    folder: Path,
    file_of: Callable[[str, Path], Path] = _beside,
) -> None:
    values = raw.get(section)
    if isinstance(values, dict) and isinstance(values.get(key), str) and values[key]:
        values[key] = str(file_of(values[key], folder))


def _override(raw: dict[str, Any], assignment: str) -> tuple[str, str]:
    key, equals, text = assignment.partition("=")
    key = key.strip()
    if not equals or not key:
        raise ConfigError("--set", assignment, "an assignment such as control.path_tolerance_rad=0.5")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise ConfigError(key, text, "a value in YAML", f"--set {assignment}") from None
    if (
        key in ("arm.urdf", "path.file", "path.known_file", "learning.start_from")
        and isinstance(value, str)
        and value
    ):
        value = str((urdf_file if key == "arm.urdf" else _beside)(value, Path.cwd()))
    replaced = {
        "path.file": "name",
        "path.name": "file",
        "path.known_file": "known_name",
        "path.known_name": "known_file",
    }.get(key)
    if replaced and value and isinstance(raw.get("path"), dict):
        raw["path"].pop(replaced, None)
    _assign(raw, key, value, f"--set {assignment}")
    return key, assignment


def _assign(raw: dict[str, Any], key: str, value: Any, source: str) -> None:
    *sections, name = RENAMED.get(key, key).split(".")
    values = raw
    for section in sections:
        values = values.setdefault(section, {})
        if not isinstance(values, dict):
            raise ConfigError(key, value, f"a key ({section} is a single value)", source)
    values[name] = value


def _first_complaint(
    error: pydantic.ValidationError, raw: Mapping[str, Any], source_of: SourceOf
) -> ConfigError:
    complaint = error.errors()[0]
    key = ".".join(str(part) for part in complaint["loc"])
    value: Any = raw
    hint: Any = Config
    record: Any = Config
    for part in complaint["loc"]:
        value = value.get(part, "missing") if isinstance(value, Mapping) else _item(value, part)
        record = hint if dataclasses.is_dataclass(hint) else record
        hint = get_type_hints(hint).get(str(part)) if dataclasses.is_dataclass(hint) else _element(hint)
    if "extra" in str(complaint["type"]):
        known = ", ".join(field.name for field in dataclasses.fields(record))
        return ConfigError(key, value, f"a known key: {known}", source_of(key))
    return ConfigError(key, value, _expectation(hint), source_of(key))


def _element(hint: Any) -> Any:
    """Return the type of the elements of a tuple or the values of a dictionary."""
    return (get_args(hint) or (None,))[-1 if get_origin(hint) is dict else 0]


def _expectation(hint: Any) -> str:
    """Say in words what a field takes; the library's own words differ from version to version."""
    if dataclasses.is_dataclass(hint):
        return "keys and values"
    if get_origin(hint) is Literal:
        return " or ".join(repr(choice) for choice in get_args(hint))
    if get_origin(hint) is tuple:
        return f"a list, each element {_expectation(_element(hint))}"
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}
    return names.get(hint, "keys and values")


def _item(value: Any, part: Any) -> Any:
    try:
        return value[part]
    except (TypeError, IndexError, KeyError):
        return value


def _build(record: Any, given: Mapping[str, Any], section: str, source_of: SourceOf) -> Any:
    hints = get_type_hints(record)
    values = {}
    for key, value in given.items():
        hint = hints[key]
        if dataclasses.is_dataclass(hint):
            value = _build(hint, value, f"{section}.{key}" if section else key, source_of)
        values[key] = value
    try:
        return record(**values)
    except ConfigError as error:
        full = error.inside(section)
        raise full.inside("", source_of(full.key)) from None


def _with_urdf_limits(config: Config, source_of: SourceOf) -> Config:
    arm = config.arm
    urdf = read_urdf(Path(arm.urdf))
    try:
        limits = joint_limits(urdf, arm.joints)
        chain_to_hand(urdf, arm.joints, arm.hand_link)
        filled = dataclasses.replace(
            arm,
            position_min_rad=arm.position_min_rad or limits.position_min_rad,
            position_max_rad=arm.position_max_rad or limits.position_max_rad,
            velocity_limit_rad_s=arm.velocity_limit_rad_s or limits.velocity_rad_s,
        )
        limits.require_within(filled)
    except ConfigError as error:
        raise error.inside("arm", source_of(f"arm.{error.key}")) from None
    return dataclasses.replace(config, arm=filled)
