"""Going on with a run that was interrupted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from tel_ros.core.arm_state import ArmState
from tel_ros.core.control.controller import EpController
from tel_ros.core.errors import BagError
from tel_ros.nodes.conversions import to_goal
from tel_ros.recording import topics


def declare_resume(node: Node) -> Path | None:
    """Declare ``resume`` and return the folder of the run to go on with, that of ``config``; None: none."""
    what = "whether to go on with the run in whose folder the file of the parameter config lies"
    about = ParameterDescriptor(description=what, read_only=True)
    if not node.declare_parameter("resume", False, about).value:
        return None
    return Path(node.get_parameter("config").value).parent


def replay_control(controller: EpController, run: Path, joints: Sequence[str]) -> bool:
    """Let a new controller go through all trials of a run, so that it holds what it held after them.

    Nothing is sent anywhere. The controller is a function of goals and joint states: fed with the recorded
    ones it has to decide what is recorded. False: it did not, since something that is not recorded, such as
    an emergency stop, had a part; it must not be used then. Raises BagError: a bag cannot be read;
    TrajectoryError: a recorded goal is one that the arm must not follow.
    """
    # Imported late: a loop that begins anew needs no bags, and should not wait for their reader.
    from tel_ros.recording.run_folder import trial_bags
    from tel_ros.recording.trial_bag import read_topic, read_trial

    for bag in trial_bags(run):
        goals = read_topic(bag, topics.TRIAL_GOAL)
        trial = read_trial(bag)
        if trial.joints != tuple(joints):
            raise BagError(bag, f"is of the joints {', '.join(trial.joints)}", ", ".join(joints))
        controller.start(to_goal(goals[0][1], joints))
        rows = zip(trial.time_ns.tolist(), trial.position_rad, trial.velocity_rad_s, strict=True)
        for k, (time_ns, position_rad, velocity_rad_s) in enumerate(rows):
            tick = controller.tick(ArmState(time_ns, position_rad, velocity_rad_s))
            if (
                tick is None
                or tick.phase != trial.phase[k]
                or not np.array_equal(tick.equilibrium_rad, trial.equilibrium_rad[k])
                or not np.array_equal(tick.effort_nm, trial.effort_nm[k])
            ):
                return False
        if controller.active:
            return False
    return True
