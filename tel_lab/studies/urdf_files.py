"""URDF files as packages ship them: whether the arms in them can be practised with, or why they are refused.

The arm of a file is its longest chain of joints that turn by themselves. What a person would have to say of
it (limits that the file lacks, where sliding joints below it are held) is in its configuration.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import numpy as np
import yaml

from tel_lab.offline import OfflinePractice
from tel_lab.study import StudyOptions, study
from tel_lab.tables import Column, Table, of_texts
from tel_ros.core.arm_description import TURNING, ArmDescription
from tel_ros.core.errors import InputFileError, TelError
from tel_ros.core.plain_urdf import check_dynamics
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.urdf import Urdf
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.urdf import read_urdf
from tel_ros.recording.waypoint_file import load_path

KINDS = COMPLETED, ABORTED, REFUSED, NO_ARM = "trial completed", "trial aborted", "refused", "no arm"
FEWEST_JOINTS = 2
OWN_FREQUENCY_RAD_S = 15.0
"""Of each joint on its spring."""
WAY_RAD = 0.1
EFFORT_NM, SPEED_RAD_S, RANGE_RAD = 1000.0, 10.0, (-1.0, 1.0)
"""For what a file does not say."""


@dataclass(frozen=True)
class Judged:
    """What came of a file: its kind, and a line."""

    package: str
    file: str
    kind: str
    said: str


def judged(package: str, folder: Path, file: Path) -> Judged:
    name = str(file.relative_to(folder))
    try:
        urdf = read_urdf(file)
        joints = arm_joints(urdf)
        if len(joints) < FEWEST_JOINTS:
            return Judged(package, name, NO_ARM, "")
        with tempfile.TemporaryDirectory() as scratch:
            report = practised(urdf, file, joints, Path(scratch))
    except TelError as error:
        said = str(error)
        for path in (str(file), str(file.resolve())):
            said = said.replace(f"{path}: ", "").replace(path, "the file")
        return Judged(package, name, REFUSED, said)
    if report.outcome is Outcome.COMPLETED:
        return Judged(package, name, COMPLETED, f"{1e3 * report.rms_error_rad:.2f} mrad RMS")
    return Judged(package, name, ABORTED, report.message)


def arm_joints(urdf: Urdf) -> tuple[str, ...]:
    """Return the joints of the longest chain of joints that turn by themselves, from the root on."""
    chains = (
        tuple(
            joint.name
            for joint in urdf.way_to(link)
            if joint.kind in TURNING and joint.element.find("mimic") is None
        )
        for link in urdf.links
    )
    return max(chains, key=len)


def practised(urdf: Urdf, file: Path, joints: tuple[str, ...], scratch: Path) -> TrialReport:
    arm = ArmDescription(urdf, joints)
    below = {joint.name for joint in urdf.way_to(urdf.joints[joints[-1]].parent)}
    said = {name for name in arm.held if name in below or urdf.joints[name].element.find("mimic") is not None}
    ranges = [limit.range_rad or RANGE_RAD for limit in arm.limits]
    low, high = np.clip(np.transpose(ranges), -math.pi, math.pi)
    middle, step = 0.5 * (low + high), np.minimum(WAY_RAD, 0.2 * (high - low))
    try:
        inertia = np.diag(check_dynamics(arm, "", position_rad=middle))
    except InputFileError:  # told by the trial itself
        inertia = np.ones(len(joints))
    stiffness = OWN_FREQUENCY_RAD_S**2 * inertia
    speed = np.array([min(limit.velocity_rad_s, SPEED_RAD_S) for limit in arm.limits])
    duration_s = max(2.0, float(max(6.0 * step / speed)))
    config: dict[str, Any] = {
        "arm": {
            "name": urdf.root,
            "urdf": str(file),
            "joints": list(joints),
            "hand_link": urdf.joints[joints[-1]].child,
            "held": {name: arm.held[name] for name in said},
            "stiffness_nm_per_rad": stiffness.tolist(),
            "damping_nms_per_rad": (1.4 * stiffness / OWN_FREQUENCY_RAD_S).tolist(),
            "effort_limit_nm": [min(limit.effort_nm, EFFORT_NM) for limit in arm.limits],
            "velocity_limit_rad_s": speed.tolist(),
            "position_min_rad": low.tolist(),
            "position_max_rad": high.tolist(),
        },
        "path": {"file": "waypoints.csv"},
        "practice": {"trials": 1, "first_duration_s": duration_s, "goal_duration_s": duration_s},
        "sim": {"initial_position_rad": middle.tolist()},
    }
    (scratch / "run.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    points = [",".join(map(repr, row.tolist())) for row in (middle, middle + step, middle)]
    (scratch / "waypoints.csv").write_text("\n".join([",".join(joints), *points]) + "\n", encoding="utf-8")
    loaded = load_config(scratch / "run.yaml")
    with OfflinePractice(loaded, load_path(loaded.path, loaded.arm), new_network(loaded)) as practice:
        (trial,) = practice.run()
    return trial.report


REFUSALS = (
    Column[tuple[str, list[Judged]]]("file", lambda row: f"`{row[1][0].file}`", left=True),
    Column[tuple[str, list[Judged]]]("files", lambda row: len(row[1])),
    Column[tuple[str, list[Judged]]]("what is said", lambda row: row[0], left=True),
)


@study(sets=False)
@click.option("--in", "packages", multiple=True, default=["pybullet_data"], help="Folder or Python package.")
def urdf_files(options: StudyOptions, packages: tuple[str, ...]) -> None:
    """Which of the URDF files that packages ship can be practised with."""
    tasks = {}
    for name in packages:
        folder = Path(name).absolute()
        if not folder.is_dir():
            spec = find_spec(name)
            if spec is None or not spec.submodule_search_locations:
                raise click.UsageError(f"{name!r} is neither a folder nor an installed package")
            folder = Path(spec.submodule_search_locations[0])
        for file in sorted(folder.rglob("*.urdf")):
            if file.is_file() and "random_urdfs" not in file.parts:
                tasks[str(file)] = (folder.name, folder, file)
    found = list(options.results(judged, tasks))
    counts = []
    for package in dict.fromkeys(row.package for row in found):
        kinds = [row.kind for row in found if row.package == package]
        counts.append([package, *map(str, (len(kinds), *map(kinds.count, KINDS)))])
    groups: dict[str, list[Judged]] = {}
    for row in (row for row in found if row.kind == REFUSED):
        groups.setdefault(row.said, []).append(row)
    tables = (
        of_texts(("package", "files", *KINDS), counts).markdown(),
        Table(REFUSALS, list(groups.items())).markdown(),
    )
    print(*tables, sep="\n\n")
    no_arm = sum(row.kind == NO_ARM for row in found)
    options.write(
        "urdf_files.md",
        arms=len(found) - no_arm,
        files=len(found),
        fewest=FEWEST_JOINTS,
        no_arm=no_arm,
        counts=tables[0],
        refusals=tables[1],
    )
