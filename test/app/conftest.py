"""Runs to report on."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

# Lets the tests import the helper module beside them, whatever pytest's import mode.
sys.path.insert(0, str(Path(__file__).parent))

from made_up_run import MakeRun, Trial, trials, write_run  # noqa: E402

from tel_ros.app.report.data import RunData, read_run  # noqa: E402
from tel_ros.app.report.run import write_report  # noqa: E402
from tel_ros.core.trial import LoopTiming, Outcome  # noqa: E402


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """Write a run folder: ``make_run(trials(3), outcome="aborted", message="why")``."""
    return lambda *args, **kwargs: write_run(tmp_path / "a-run", *args, **kwargs)


@pytest.fixture(scope="session")
def good_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of three trials that went well. Tests only look at it: making it takes a second."""
    return write_report(write_run(tmp_path_factory.mktemp("good") / "a-run", trials(3)))


@pytest.fixture(scope="session")
def sure_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a run that tells of trial 2 alone how sure the network was, and how regular the loop."""
    timing = LoopTiming(
        state_rate_hz=497.25,
        stamp_rate_hz=500.0,
        jitter_p50_s=1.2e-5,
        jitter_p99_s=1.234e-3,
        jitter_max_s=9.876e-3,
        response_p99_s=4.56e-4,
        response_max_s=7.89e-4,
        missed_ticks=17,
        warning="the loop was not regular: 17 of 900 ticks were missed",
    )
    second = Trial(2, timing=timing)
    made_of = [Trial(1), replace(second, std_rad=(0.03,) * second.n_points)]
    return write_report(write_run(tmp_path_factory.mktemp("sure") / "a-run", made_of))


@pytest.fixture(scope="session")
def bad_report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a run that went wrong in every way: clipped, broken off, no bag, no movement."""
    made_of = [
        Trial(1, saturated=True),
        Trial(2, outcome=Outcome.ABORTED, message="0.7 rad off"),
        Trial(3),
        Trial(4, outcome=Outcome.ABORTED, message="the arm did not settle", reached_run=False),
    ]
    message = "trial 4 was aborted: it did not settle"
    folder = tmp_path_factory.mktemp("bad") / "a-run"
    write_run(folder, made_of, outcome="aborted", message=message)
    shutil.rmtree(folder / "trial_003")
    return write_report(folder)


@pytest.fixture(scope="session")
def good_run(good_report: Path) -> RunData:
    """What the good report was made from."""
    return read_run(good_report.parent)
