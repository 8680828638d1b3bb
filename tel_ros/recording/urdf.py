"""URDF files: reading one, the meshes that it names, and the arm that it describes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from tel_ros.core.arm_description import MOVABLE, ArmDescription
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.plain_urdf import plain_urdf
from tel_ros.core.urdf import EXPECTED, Urdf
from tel_ros.recording.shared_files import missing, named_file

_MOST_BYTES = 100_000_000
_STANDS_STILL_RAD = 0.01
"""Range within which a joint counts as held: its encoder may have noise."""


def read_urdf(path: Path) -> Urdf:
    """Return a parsed URDF; InputFileError if it is missing, not readable or none."""
    if not path.is_file():
        raise InputFileError(path, missing(path), EXPECTED)
    try:
        if (size := path.stat().st_size) > _MOST_BYTES:
            raise InputFileError(path, f"has {size / 1e6:.0f} MB", EXPECTED)
        return Urdf(path.read_bytes(), path)
    except OSError as error:
        raise InputFileError(path, f"not readable ({error.strerror})", EXPECTED) from error


def described(arm: ArmConfig) -> ArmDescription:
    """Return what its URDF file says of an arm; errors as :class:`ArmDescription`, or it is no URDF."""
    return ArmDescription.of(read_urdf(Path(arm.urdf)), arm)


def urdf_text(arm: ArmDescription) -> str:
    """Return a URDF of an arm for readers that take joints at 0: the file, if they see the same arm in it."""
    return arm.urdf.text if arm.as_written else plain_urdf(arm)


def mesh_file(urdf: Path, name: str) -> str | None:
    """Return the file of a mesh that a URDF names, or None if it is not there.

    ``package://NAME/meshes/a.stl`` is looked for above the URDF, with and without NAME, and in packages.
    """
    relative = name.removeprefix("package://").removeprefix("file://")
    tails = [relative, relative.partition("/")[2]] if name.startswith("package://") else [relative]
    for folder in urdf.resolve().parents:
        for tail in tails:
            if tail and (folder / tail).is_file():
                return str(folder / tail)
    try:
        return str(named_file(name, urdf.parent)) if name.startswith("package://") else None
    except InputFileError:
        return None


def arm_description(
    file: Path, joints: Sequence[str], others: Mapping[str, tuple[float, float]]
) -> tuple[str, list[str]]:
    """Return a URDF in which all joints that are not learned are fixed where they were, and what was assumed.

    ``others``: within which positions [rad] other joints were recorded; what was not is taken to be as near
    to 0 as it can be. ConfigError: a joint is not in the file, or one that is not learned has moved.
    """
    urdf = read_urdf(file)
    found = [joint.name for joint in urdf.joints.values() if joint.kind in MOVABLE]
    held = {}
    for name in found:
        low, high = others.get(name, (0.0, 0.0))
        if name not in joints and high - low > _STANDS_STILL_RAD:
            expected = f"also {name}, which moved by {high - low:.3g} rad in the recording"
            raise ConfigError("joints", ", ".join(joints), expected)
        if name not in joints and name in others:
            held[name] = 0.5 * (low + high)
    arm = ArmDescription(urdf, joints, held)
    unsaid = {name: place for name, place in arm.held.items() if name not in held}
    assumed = [f"{k} was not recorded: the arm is described with it at {at:g}" for k, at in unsaid.items()]
    return plain_urdf(arm), assumed
