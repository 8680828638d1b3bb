"""A strategy of another package practises over ROS like one of ours."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from graph_harness import QUICK, TelProcess, summary_of

STRATEGY = '''
from tel_ros.core.practice.strategy import Ending, Movement, PlannedTrial, Strategy


class Twice(Strategy):
    """The goal, twice."""

    def __init__(self, config):
        self._goal = Movement(config.practice.goal_duration_s)

    def preview(self):
        return [self._goal]

    def movements_to_cover(self):
        return [self._goal]

    def next(self, last, forecast):
        index = 1 if last is None else last.index + 1
        return Ending("completed") if index > 2 else PlannedTrial(index, 1.0, self._goal, reason="because")
'''


@pytest.fixture
def installed(tmp_path: Path) -> str:
    """Return a search path with a package that offers the strategy ``twice``."""
    packages = tmp_path / "packages"
    about = packages / "their_package-1.0.dist-info"
    about.mkdir(parents=True)
    (packages / "their_package.py").write_text(STRATEGY)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[tel_ros.strategies]\ntwice = their_package:Twice\n")
    return os.pathsep.join([str(packages), *filter(None, [os.environ.get("PYTHONPATH")])])


@pytest.mark.timeout(120)
def test_a_strategy_of_another_package_practises_by_its_name(
    tel: Callable[..., TelProcess], installed: str
) -> None:
    run = tel(*QUICK, "practice.strategy=twice", PYTHONPATH=installed)
    code, out, err = run.finish()
    assert code == 0, err
    rows = summary_of(out)["trials"]
    assert [(row["duration_s"], row["reason"]) for row in rows] == [(3.0, "because")] * 2
    assert (run.folder / "network" / "network.npz").samefile(run.folder / "network" / "after_002.npz")


def test_a_strategy_that_nobody_offers_is_refused_with_those_that_there_are(
    tel: Callable[..., TelProcess], installed: str
) -> None:
    code, _, err = tel("practice.strategy=thrice", PYTHONPATH=installed).finish()
    assert code == 2
    assert "expected one of adaptive_extension, direct, subtasks, trajectory_extension, twice" in err
