"""Whether bags may be learned from together: the same arm, joint by joint, behind the same interface."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import BagError
from tel_ros.recording.provenance import stored_config, stored_urdf

_KEYS = ("name", "joints", "command_interface", "stiffness_nm_per_rad", "damping_nms_per_rad")


def require_same_arm(bags: Sequence[tuple[Path, Mapping[str, str]]], arm: ArmConfig | None = None) -> None:
    """Make sure that all bags are of one arm.

    Compared are its name, its joints in their order, its command interface, its springs (those of the
    configuration: what a single trial varies is accounted for) and the text of its URDF.

    Args:
        bags: with their metadata.
        arm: of which they have to be, with a URDF that can be read; None: that of the first bag.

    Raises:
        BagError: a bag differs in that; the message says in what, with both values.
    """
    if arm is not None:
        reference, origin = _facts(arm, Path(arm.urdf).read_text(encoding="utf-8")), "the configuration"
    else:
        reference, origin = {}, str(bags[0][0]) if bags else ""
    for bag, metadata in bags:
        facts = _facts(stored_config(bag, metadata).arm, stored_urdf(bag, metadata))
        for key, value in facts.items():
            expected = reference.setdefault(key, value)
            if value != expected:
                raise BagError(bag, f"{key} is {value!r}", f"{expected!r}, as in {origin}")


def _facts(arm: ArmConfig, urdf: str) -> dict[str, Any]:
    facts: dict[str, Any] = {f"arm.{key}": getattr(arm, key) for key in _KEYS}
    facts["arm.urdf"] = f"a text with the SHA-256 {hashlib.sha256(urdf.encode()).hexdigest()[:16]}"
    return facts
