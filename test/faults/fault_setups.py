"""The graphs into which faults are injected: an arm, a clock, and short trials of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.trajectories.paths import NAMED_PATHS
from tel_ros.recording.config_file import load_config

ROOT = Path(__file__).parents[2]

RATE_HZ = 250.0
"""Of the control loop. Two graphs share two cores, each with an observer in Python as well."""
SWING_RAD = 0.5
"""Each joint goes this far to one side, once, and comes back to where it started."""
RUN_S = 1.4
WATCHDOG_S = 0.02
"""Of the simulated driver."""
PRIORITY = 50
"""Of controller, simulated driver and observer, as config/real_arm.yaml has it; where it is permitted."""
COMMAND_AGE_LIMIT_S = 0.01
"""Of the simulated driver: the longest way there and back that the arm contract allows at this rate."""
SHORT_TRIALS = (
    *("practice.strategy=trajectory_extension", "practice.on_abort=continue"),
    *(f"practice.first_duration_s={RUN_S}", f"practice.goal_duration_s={RUN_S}"),
    *("control.approach_speed_rad_s=1.5", "control.settle_time_s=0.2", f"control.rate_hz={RATE_HZ}"),
    # Every trial is of one speed and the faults are the point: the plainest learner does.
    *("learning.weights=lms", "learning.max_subtrees=0", "learning.passes=1", "learning.filter=fixed"),
    "sim.lockstep_timeout_s=1.0",
    # As the arm contract recommends: commands that stutter or come late drive an arm wild within the longest
    # time-out, and only the driver can tell.
    f"sim.watchdog_s={WATCHDOG_S}",
    f"sim.command_age_limit_s={COMMAND_AGE_LIMIT_S}",
)
"""Short trials; an aborted one is followed by the next."""
FLUNG_BACK_J = 1.0
"""What the springs give back that stop the swing at its fastest."""
TRIAL_S = 0.5 + 0.2 + RUN_S + 0.2
"""Approach, settle, run and hold, in arm time, of a trial that nothing disturbs."""


@dataclass(frozen=True)
class Setup:
    """One kind of graph.

    Args:
        name: as results and the page call it.
        config_file: run configuration to start from.
        in_between: whether the campaign stands between arm and graph (``run.arm: external``, real time);
            otherwise the run brings its own arm up, in lockstep.
        work_tolerance_j: what the motors may put into a braked arm without being said to drive it. It covers
            one control period at full effort in mid-motion, and the springs' work while a swing dies out.
        falls: whether gravity moves the arm when its motors are off.
        weight: how often it is drawn.
        alone: whether no other graph may run beside it on two cores: states that are late for want of a core
            are a fault of their own, and an arm that bears a weight sinks then.
        guarded: whether ``arm_guard`` watches the commands, where the campaign stands in between.
        settings: of the configuration, beside those that all have.
    """

    name: str
    config_file: Path
    in_between: bool
    work_tolerance_j: float
    falls: bool
    weight: float
    alone: bool = False
    guarded: bool = True
    settings: tuple[str, ...] = ()

    def config(self, folder: Path, trials: int) -> tuple[Config, list[str]]:
        """Return the configuration of a run, and the settings that make it of the file.

        Its path, in waypoints in the folder, is a closed swing; neighbouring joints go to opposite sides.
        """
        plain = load_config(self.config_file)
        start_rad, joints = NAMED_PATHS[plain.path.name].evaluate(np.zeros(1))[0][0], plain.arm.joints
        side = np.where(np.arange(len(joints)) % 2, -1.0, 1.0)
        s = np.linspace(0.0, 1.0, 17)
        rows = start_rad + SWING_RAD * 0.5 * (1.0 - np.cos(2.0 * np.pi * s))[:, None] * side
        rows[-1] = rows[0]  # to the last digit: then the path is closed
        waypoints = folder / "swing.csv"
        np.savetxt(waypoints, rows, "%.6f", ",", header=",".join(joints), comments="", encoding="utf-8")
        settings = [
            *SHORT_TRIALS,
            f"practice.trials={trials}",
            "path.name=",
            f"path.file={waypoints}",
            f"sim.initial_position_rad={start_rad.tolist()}",
            f"run.arm={'external' if self.in_between else 'sim'}",
            f"safety.guard={'external' if self.guarded else 'never'}",
            f"sim.clock={'realtime' if self.in_between else 'lockstep'}",
            f"control.realtime_priority={PRIORITY if self.in_between else 0}",
            *self.settings,
        ]
        return load_config(self.config_file, settings), settings


SETUPS = {
    setup.name: setup
    for setup in (
        Setup("planar", ROOT / "config" / "planar_arm.yaml", True, 0.05, False, 0.3),
        Setup("unguarded", ROOT / "config" / "planar_arm.yaml", True, 0.05, False, 0.2, guarded=False),
        Setup("planar_3", ROOT / "config" / "planar_arm_3.yaml", True, 0.05, False, 0.15),
        Setup("iiwa", ROOT / "config" / "kuka_iiwa.yaml", True, 2.0, True, 0.1, alone=True),
        Setup("lockstep", ROOT / "config" / "planar_arm.yaml", False, 0.05, False, 0.15),
        # Its hold on a stop is a spring that is latched, and gives back what it took up.
        Setup(
            *("trajectory", ROOT / "config" / "planar_arm.yaml", False, FLUNG_BACK_J, False, 0.15),
            settings=("arm.command_interface=trajectory",),
        ),
        Setup("iiwa_lockstep", ROOT / "config" / "kuka_iiwa.yaml", False, 2.0, True, 0.1),
    )
}
