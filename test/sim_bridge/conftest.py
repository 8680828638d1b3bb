"""Arms to test: made with few words, and closed at the end of the test."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

# Lets the tests import the helper modules beside them, whatever pytest's import mode.
sys.path.insert(0, str(Path(__file__).parent))

import sim_bridge  # noqa: E402
from sim_bridge.arm import SimulatedArm  # noqa: E402
from tel_ros.core.config import ArmConfig, SimConfig  # noqa: E402

PLANAR_ARM = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm.urdf"


@pytest.fixture
def planar_arm_urdf() -> Path:
    """The URDF that comes with the project."""
    return PLANAR_ARM


@pytest.fixture
def edited_urdf(tmp_path: Path) -> Callable[..., Path]:
    """Write a copy of the project's URDF with some text replaced: ``edited_urdf({old: new})``."""

    def write(replacements: dict[str, str]) -> Path:
        text = PLANAR_ARM.read_text(encoding="utf-8")
        for old, new in replacements.items():
            assert old in text, f"{old!r} is not in the URDF any more"
            text = text.replace(old, new)
        path = tmp_path / "edited.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def endless_urdf(edited_urdf: Callable[..., Path]) -> Path:
    """The project's arm with joints that turn without end: a free swing never meets a hard stop."""
    return edited_urdf({'type="revolute"': 'type="continuous"'})


@pytest.fixture
def make_arm() -> Iterator[Callable[..., SimulatedArm]]:
    """Make arms: ``make_arm(encoder_bits=0, rate_hz=500.0, arm={"effort_limit_nm": (5.0, 5.0)})``."""
    with ExitStack() as open_arms:

        def make(
            *,
            urdf: Path = PLANAR_ARM,
            rate_hz: float = 500.0,
            seed: int = 1,
            arm: dict[str, object] | None = None,
            **sim: object,
        ) -> SimulatedArm:
            joints = (arm or {}).get("joints", ("shoulder", "elbow"))
            values: dict[str, object] = {
                "name": "test_arm",
                "urdf": str(urdf),
                "joints": joints,
                "hand_link": "hand",
                "stiffness_nm_per_rad": (15.0,) * len(joints),
                "damping_nms_per_rad": (1.5,) * len(joints),
                "effort_limit_nm": (20.0,) * len(joints),
            }
            config = ArmConfig(**(values | (arm or {})))
            return open_arms.enter_context(SimulatedArm(config, SimConfig(**sim), rate_hz=rate_hz, seed=seed))

        yield make
