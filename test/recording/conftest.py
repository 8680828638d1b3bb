"""Files to test with: the project's own, copied to where they may be spoiled."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

# Lets the tests import the helper module beside them, whatever pytest's import mode.
sys.path.insert(0, str(Path(__file__).parent))

from synthetic_trial import SyntheticTrial  # noqa: E402

import sim_bridge  # noqa: E402
from tel_ros.core.config import Config  # noqa: E402
from tel_ros.recording.config_file import load_config  # noqa: E402

PLANAR_ARM = Path(sim_bridge.__file__).parent / "urdf" / "planar_arm.urdf"

RUN_YAML = """\
arm: arms/two_link.yaml
path:
  name: planar_loops
practice:
  trials: 3
control:
  path_tolerance_rad: 0.8
seed: 7
"""
ARM_YAML = """\
name: two_link
urdf: ../robots/planar_arm.urdf
joints: [shoulder, elbow]
hand_link: hand
stiffness_nm_per_rad: [15.0, 15.0]
damping_nms_per_rad: [1.5, 1.5]
effort_limit_nm: [20.0, 20.0]
"""


@pytest.fixture
def config_folder(tmp_path: Path) -> Path:
    """A folder with ``run.yaml``, the arm that it names in ``arms/`` and its URDF in ``robots/``."""
    folder = tmp_path / "config"
    (folder / "arms").mkdir(parents=True)
    (folder / "robots").mkdir()
    (folder / "run.yaml").write_text(RUN_YAML, encoding="utf-8")
    (folder / "arms" / "two_link.yaml").write_text(ARM_YAML, encoding="utf-8")
    shutil.copy(PLANAR_ARM, folder / "robots")
    return folder


@pytest.fixture
def edit(config_folder: Path) -> Callable[[str, str, str], Path]:
    """Replace some text in one of the files: ``edit("run.yaml", old, new)``; returns ``run.yaml``."""

    def replace(file: str, old: str, new: str) -> Path:
        text = (config_folder / file).read_text(encoding="utf-8")
        assert old in text, f"{old!r} is not in {file} any more"
        (config_folder / file).write_text(text.replace(old, new), encoding="utf-8")
        return config_folder / "run.yaml"

    return replace


@pytest.fixture
def config(config_folder: Path) -> Config:
    """The configuration in ``config_folder``."""
    return load_config(config_folder / "run.yaml")


@pytest.fixture
def trial() -> SyntheticTrial:
    """A trial to write."""
    return SyntheticTrial()


@pytest.fixture
def trial_bag(tmp_path: Path, trial: SyntheticTrial) -> Path:
    """Its closed bag."""
    return trial.write(tmp_path / "run" / "trial_003")
