"""Kinds of learners, and a network in a file."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

# Lets the tests import the helper modules beside them, whatever pytest's import mode.
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import pytest
from every_learner import LEARNERS
from small_networks import trained

from tel_ros.recording.network_file import save_network


@pytest.fixture(params=list(LEARNERS.values()), ids=list(LEARNERS))
def options(request: pytest.FixtureRequest) -> dict[str, object]:
    """One kind of learner, with trees that are small so that they are quick."""
    if "rigid_body" in request.param["name"]:
        pytest.importorskip("pinocchio")
    return {"gaussians_per_input": 6} | request.param


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A stored network that has learned from two trials."""
    save_network(trained(2), tmp_path / "network.npz")
    return tmp_path / "network.npz"


@pytest.fixture
def rewrite(file: Path) -> Callable[..., None]:
    """Replace arrays in the file, or keys of its header, ``part.key`` of a part; None takes them away."""

    def change(header: dict[str, Any] | None = None, **arrays: Any) -> None:
        with np.load(file) as stored:
            content = dict(stored)
        text = json.loads(str(content["header"]))
        for path, value in (header or {}).items():
            *parts, key = path.split(".")
            inner = text[parts[0]] if parts else text
            inner[key] = value
            if value is None:
                del inner[key]
        content["header"] = np.array(json.dumps(text))
        content |= arrays
        np.savez(file, **{name: array for name, array in content.items() if array is not None})

    return change
