"""A strategy of another package practises over ROS like one of ours."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tel_process import PAPER, QUICK, StartTel, summary_of, tel_here

STRATEGY = '''
from tel_ros.core.practice.strategy import Ending, Movement, PlannedTrial, Strategy


class Once(Strategy):
    """The goal, once."""

    def __init__(self, config):
        self._goal = Movement(config.practice.goal_duration_s)

    def preview(self):
        return [self._goal]

    def movements_to_cover(self):
        return [self._goal]

    def next(self, last, forecast):
        index = 1 if last is None else last.index + 1
        return Ending("completed") if index > 1 else PlannedTrial(index, 1.0, self._goal, reason="because")
'''


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """Return a folder with a package that offers the strategy ``once``."""
    packages = tmp_path / "packages"
    about = packages / "their_package-1.0.dist-info"
    about.mkdir(parents=True)
    (packages / "their_package.py").write_text(STRATEGY)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[tel_ros.strategies]\nonce = their_package:Once\n")
    return packages


def test_a_strategy_of_another_package_practises_by_its_name(tel: StartTel, installed: Path) -> None:
    path = os.pathsep.join([str(installed), *filter(None, [os.environ.get("PYTHONPATH")])])
    run = tel(*QUICK, "practice.strategy=once", PYTHONPATH=path)
    code, out, err = run.finish()
    assert code == 0, err
    rows = summary_of(out)["trials"]
    assert [(row["duration_s"], row["reason"]) for row in rows] == [(3.0, "because")]
    assert (run.folder / "network" / "network.npz").samefile(run.folder / "network" / "after_001.npz")


def test_a_strategy_that_nobody_offers_is_refused_with_those_that_there_are(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(installed)
    code, _, err = tel_here("practice", str(PAPER), "--set", "practice.strategy=thrice")
    assert code == 2
    offered = "adaptive_extension, direct, once, subtasks, trajectory_extension"
    assert f"expected one of {offered}" in err
