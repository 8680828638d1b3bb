"""What a sweep consists of: cases, grids and seeds, laid out as points and checked before anything runs."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from tel_lab.study import assignments
from tel_ros import __version__
from tel_ros.core.config import Config, file_values
from tel_ros.core.config_fields import read_record
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.recording.config_file import flat_values, load_config, read_yaml


@dataclass(frozen=True)
class MapPlan:
    """A figure to draw of a sweep: one panel a case, a cell for each pair of values.

    ``x`` and ``y`` are keys of the grid, their labels empty for the key itself; ``tolerance_rad`` is the RMS
    error of the last trial that is good enough.
    """

    x: str
    y: str
    tolerance_rad: float
    x_label: str = ""
    y_label: str = ""


@dataclass(frozen=True)
class SweepPlan:
    """What to go through, as the YAML file of a sweep says it.

    Args:
        set: dotted keys and values for all points.
        cases: names and what each case changes: bundles of values that go together.
        grid: dotted keys and the values to go through.
        seeds: how many seeds for each point.
        map: figure to draw at the end.
        overrides: ``key=value`` for all points, from the command line.

    Raises:
        ConfigError: a grid is empty or names a value twice, a key is given twice, there are no seeds, or the
            map is of keys that are not in the grid.
    """

    set: dict[str, Any] = field(default_factory=dict)
    cases: dict[str, dict[str, Any]] = field(default_factory=dict)
    grid: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    seeds: int = 1
    map: MapPlan | None = None
    overrides: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.seeds < 1:
            raise ConfigError("--seeds", self.seeds, "a whole number of at least 1")
        for key, values in self.grid.items():
            texts = [json.dumps(value) for value in values]
            if not texts or len(set(texts)) < len(texts):
                raise ConfigError(key, list(values), "one value or more, each once", "--grid")
        if "seed" in self.grid and self.seeds > 1:
            raise ConfigError("--seeds", self.seeds, "1, since the grid names the seeds")
        for axis in (self.map.x, self.map.y) if self.map else ():
            if axis not in self.grid:
                raise ConfigError("map", axis, f"keys of the grid: {', '.join(self.grid) or 'there is none'}")
        for name, changes in self.cases.items():
            if twice := self.grid.keys() & changes.keys():
                expected = "a key that is in the grid or in cases, not in both"
                raise ConfigError(min(twice), name, expected, "cases")

    @property
    def for_all(self) -> tuple[str, ...]:
        return (*assignments(self.set), *self.overrides)

    def plain(self) -> dict[str, Any]:
        return {
            "overrides": list(self.for_all),
            "cases": {name: list(assignments(changes)) for name, changes in self.cases.items()},
            "grid": {key: list(values) for key, values in self.grid.items()},
            "seeds": self.seeds,
        }


@dataclass(frozen=True)
class SweepPoint:
    """One practice run of a sweep, or why there can be no such configuration.

    The labels tell it from the others: case, keys of the grid, seed; columns of the table. ``key``: hash of
    the resolved configuration, of the labels if there is none.
    """

    labels: Mapping[str, Any]
    config: Config | None
    problem: str
    key: str


def parse_grid(text: str) -> tuple[str, tuple[Any, ...]]:
    """Return key and values of an option such as ``sim.inertia_scale=0.5,1,2``; ConfigError if it is none."""
    key, equals, values = text.partition("=")
    try:
        parsed = yaml.safe_load(f"[{values}]")
    except yaml.YAMLError:
        parsed = None
    if not key.strip() or not equals or not parsed:
        raise ConfigError("--grid", text, "a key and values such as sim.inertia_scale=0.5,1,2")
    return key.strip(), tuple(parsed)


def make_plan(
    file: Path | None, overrides: Sequence[str] = (), grid: Sequence[str] = (), seeds: int | None = None
) -> SweepPlan:
    """Return the plan of a YAML file (None: an empty one); options take the place of what it says.

    Raises:
        InputFileError: the file is missing or unreadable.
        ConfigError: a key is unknown, a value or an option is malformed, or the plan makes no sense.
    """
    values, named = read_yaml(file) if file else {}, dict[str, list[Any]]()
    for key, of_key in map(parse_grid, grid):
        if key in named:
            raise ConfigError(key, list(of_key), "each key in one grid", "--grid")
        named[key] = list(of_key)
    if isinstance(values.get("grid", {}), dict):
        values["grid"] = {**values.get("grid", {}), **named}
    values |= {} if seeds is None else {"seeds": seeds}
    plan = read_record(SweepPlan, values, lambda key: str(file) if file else None)
    return replace(plan, overrides=(*plan.overrides, *overrides))


def lay_out(config_file: Path, plan: SweepPlan) -> list[SweepPoint]:
    """Return all points, each with its configuration resolved and checked.

    A value that is right beside some values of the other grids and wrong beside others gives points with a
    problem. One that is right nowhere is a mistake.

    Raises:
        InputFileError: a file is missing or unreadable.
        ConfigError: a key is unknown, or a value of a grid fits no point.
    """
    points: list[SweepPoint] = []
    errors: dict[str, ConfigError] = {}
    fits: set[str] = set()
    for case, values in itertools.product(plan.cases or [None], itertools.product(*plan.grid.values())):
        asked = dict(zip(plan.grid, values, strict=True))
        grid, changes = assignments(asked), assignments(plan.cases[case]) if case else ()
        # What to blame if it never fits: first the values of the grid, then the case.
        parts = [*(f"--grid {text}" for text in grid), f"case {case}"]
        label = {} if case is None else {"case": case}
        try:
            config = load_config(config_file, [*plan.for_all, *changes, *grid])
        except ConfigError as error:
            for part in parts:
                errors.setdefault(part, error)
            labels = {**label, **asked, "seed": asked.get("seed")}
            # Without its source: that would be the option that passed a value on, not where it came from.
            problem = str(ConfigError(error.key, error.value, error.expected))
            points.append(SweepPoint(labels, None, problem, hash_of(labels)))
            continue
        fits.update(parts)
        for seed in range(config.seed, config.seed + plan.seeds):
            seeded = replace(config, seed=seed)
            resolved = flat_values(seeded)
            labels = {**label, **{key: resolved[key] for key in plan.grid}, "seed": seed}
            points.append(SweepPoint(labels, seeded, "", config_hash(seeded)))
    for part, first in errors.items():
        if part not in fits:
            source = first.source if part == "case None" else part
            raise ConfigError(first.key, first.value, first.expected, source)
    return points


def config_hash(config: Config) -> str:
    """Return what names a result: equal for equal configurations that read equal files, wherever these lie.

    Raises:
        InputFileError: a file that the configuration names cannot be read.
    """
    values = {key: value for key, value in flat_values(config).items() if key != "versions"}
    values["path.files"] = config.path.names
    values |= {key: _file_hash(file) for key, file in file_values(config).items()}
    return hash_of({"tel_ros": __version__, **values})


def _file_hash(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputFileError(path, f"not readable ({error.strerror})", "a file") from None


def hash_of(values: Any) -> str:
    """Return a short name for plain values, the same for equal ones."""
    text = json.dumps(values, sort_keys=True)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()[:16]
