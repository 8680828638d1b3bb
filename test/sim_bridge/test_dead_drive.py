"""A drive that does not act for a while flings nothing when it acts again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from sim_bridge.arm import SimulatedArm
from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import Config
from tel_ros.core.control.controller import EpController
from tel_ros.core.trajectories.trajectory import sample
from tel_ros.core.trial import Phase, TrialGoal
from tel_ros.recording.config_file import load_config
from tel_ros.recording.waypoint_file import load_path

CONFIGS = Path(__file__).parents[2] / "config"
DEAD_S = 0.5


class Episode(NamedTuple):
    """What came of a drive that did not act for half a second in mid-trial."""

    stopped_after_s: float
    """Time from the beginning of it to the first tick of STOP."""
    first_effort_share: float
    """Largest share of an effort limit commanded in the first 20 ms in which the drive acts again."""
    work_j: float
    """The most that the motors put into the arm from then on, over any interval."""
    message: str
    end: Phase


def dead_drive(config: Config, dead_s: float = DEAD_S) -> Episode:
    path = load_path(config.path, config.arm)
    desired = sample(path, 3.0, config.control.rate_hz)
    controller = EpController(config.arm, config.control, config.safety)
    controller._first_motion = None  # as after a completed trial
    controller.start(TrialGoal(1, 1.0, desired, desired.position_rad))
    limit_nm = np.array(config.arm.effort_limit_nm)
    since_s = stopped_s = None
    shares, powers = [], []
    with SimulatedArm(config.arm, config.sim, rate_hz=config.control.rate_hz, seed=1) as arm:
        while since_s is None or controller.active or arm.reading().time_ns * 1e-9 < since_s + dead_s + 3.0:
            reading = arm.reading()
            state = ArmState(
                reading.time_ns,
                np.array(reading.position_rad),
                np.array(reading.velocity_rad_s),
                effort_nm=np.array(reading.effort_nm),
            )
            tick = controller.tick(state)
            assert tick is not None
            if since_s is None and controller.phase == Phase.RUN and controller.time_from_start_s >= 0.4:
                since_s = reading.time_ns * 1e-9
            if since_s is not None and stopped_s is None and controller.phase == Phase.STOP:
                stopped_s = reading.time_ns * 1e-9 - since_s
            if since_s is not None and reading.time_ns * 1e-9 < since_s + dead_s:
                arm.coast()
                continue
            arm.step(tick.effort_nm.tolist())
            if since_s is not None:
                shares.append(np.abs(tick.effort_nm / limit_nm).max())
                powers.append(arm.reading().effort_nm @ state.velocity_rad_s)
    work_j = np.cumsum(powers) / config.control.rate_hz
    risen_j = work_j - np.minimum.accumulate(np.minimum(work_j, 0.0))
    assert controller.report is not None
    return Episode(
        stopped_s if stopped_s is not None else np.inf,
        float(max(shares[: round(0.02 * config.control.rate_hz)])),
        float(risen_j.max()),
        controller.report.message,
        controller.phase,
    )


@pytest.fixture(scope="module")
def iiwa() -> Config:
    config = load_config(CONFIGS / "kuka_iiwa.yaml")
    start_rad = load_path(config.path, config.arm).evaluate(np.zeros(1))[0][0].tolist()
    return replace(config, sim=replace(config.sim, initial_position_rad=tuple(start_rad)))


def test_an_arm_whose_drive_was_dead_is_caught_without_a_kick(iiwa: Config) -> None:
    episode = dead_drive(iiwa)
    assert episode.stopped_after_s < 0.1
    assert "does not exert what it is commanded" in episode.message
    assert episode.first_effort_share < 0.5
    assert episode.work_j < 1.0
    assert episode.end == Phase.STOP


def test_unwatched_the_wound_up_springs_act_at_once(iiwa: Config) -> None:
    """What the rule is for: without it this test's twin would not be worth much."""
    episode = dead_drive(replace(iiwa, safety=replace(iiwa.safety, watch_drives=False)))
    assert episode.first_effort_share > 0.9
    assert episode.work_j > 5.0
    assert episode.stopped_after_s > 0.15


def test_a_drive_that_always_acts_is_not_suspected(iiwa: Config) -> None:
    episode = dead_drive(iiwa, dead_s=0.0)
    assert episode.stopped_after_s == np.inf
    assert episode.message == ""
    assert episode.end == Phase.HOLD
