"""What the tests of the core share; :mod:`two_link` has the arm that they control."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

# Lets the tests import the helper module beside them, whatever pytest's import mode.
sys.path.insert(0, str(Path(__file__).parent))

from two_link import Bench, TwoLinkArm, loops, make_bench  # noqa: E402

from tel_ros.core.learning.signals import TrialSignals  # noqa: E402
from tel_ros.core.trial import Outcome, Phase  # noqa: E402


@pytest.fixture(scope="session")
def loops_trial() -> Bench:
    """A whole trial of the project's figure in 4.5 s."""
    bench = make_bench()
    assert bench.run(loops(4.5)).outcome == Outcome.COMPLETED
    return bench


@pytest.fixture(scope="session")
def plant() -> TwoLinkArm:
    """The arm of ``loops_trial``, for its formulas."""
    return TwoLinkArm()


@pytest.fixture(scope="session")
def recorded() -> Callable[..., TrialSignals]:
    """Return what a bench's trial leaves in a record: ``recorded(bench, encoder_bits=16)``."""

    def record(bench: Bench, encoder_bits: int = 0, noise_rad: float = 0.0) -> TrialSignals:
        rows = bench.rows(Phase.SETTLE, Phase.RUN, Phase.HOLD)
        position = bench.position_rad[rows]
        position = position + noise_rad * np.random.default_rng(11).normal(size=position.shape)
        if encoder_bits:
            step = 2 * np.pi / 2**encoder_bits
            position = np.round(position / step) * step
        names = ("desired_position_rad", "desired_velocity_rad_s", "desired_acceleration_rad_s2")
        return TrialSignals(
            time_ns=bench.stamps_ns[rows],
            run=np.isin(rows, bench.rows(Phase.RUN)),
            desired=np.hstack([bench.column(name)[rows] for name in names]),
            position_rad=position,
            equilibrium_rad=bench.column("equilibrium_rad")[rows],
            saturated=bench.column("saturated")[rows],
        )

    return record
