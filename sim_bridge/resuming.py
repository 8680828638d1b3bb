"""Bringing the simulated arm to where it was when a run was interrupted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sim_bridge.arm import ArmReading, SimulatedArm
from tel_ros.recording import topics
from tel_ros.recording.run_folder import trial_bags
from tel_ros.recording.trial_bag import read_topic


def replay_arm(
    new_arm: Callable[[], SimulatedArm], run: Path, command_topic: str
) -> tuple[SimulatedArm, int]:
    """Return an arm that has gone through all trials of a run, and how much later it was than its own time.

    Equal commands give bit-identical readings: the arm gets the recorded commands, one a period, and has to
    read what is recorded. So its joints, sensors, noise and the commands on their way are as they were. Where
    it reads something else (periods have passed without commands, or in real time), nobody can tell more than
    where it was last: there it rests.

    Args:
        new_arm: makes the arm as a run begins with it.
        run: folder of the run.
        command_topic: of the arm.

    Returns:
        The arm, and what is to be added to its time [ns]; 0 if it is exactly as it was.

    Raises:
        BagError: a bag cannot be read.
        ConfigError: the place where it was last is beyond a hard stop.
    """
    arm = new_arm()
    position_rad, last_ns = None, 0
    exact = True
    for bag in trial_bags(run):
        states = {
            time_ns: (tuple(state.position.tolist()), tuple(state.velocity.tolist()))
            for time_ns, state in read_topic(bag, topics.JOINT_STATES)
        }
        exact = exact and _follows(arm, states, bag, command_topic)
        last_ns = max(states)
        position_rad = states[last_ns][0]
    if exact or position_rad is None:
        return arm, 0
    arm.close()
    arm = new_arm()
    arm.set_state(position_rad, (0.0,) * len(position_rad))
    return arm, last_ns


def _follows(arm: SimulatedArm, states: dict[int, tuple], bag: Path, command_topic: str) -> bool:
    for time_ns, command in read_topic(bag, command_topic):
        if not _reads(arm.reading(), states, time_ns):
            return False
        arm.step(command.data)
    return _reads(arm.reading(), states, max(states))


def _reads(reading: ArmReading, states: dict[int, tuple], time_ns: int) -> bool:
    found = (reading.position_rad, reading.velocity_rad_s)
    # The very first state of a run was there before the recorder listened.
    return reading.time_ns == time_ns and states.get(time_ns, found) == found
