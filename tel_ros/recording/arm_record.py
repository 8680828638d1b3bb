"""What an arm did in a recorded trial, and what it was told."""

from __future__ import annotations

from pathlib import Path

from tel_ros.core.errors import BagError
from tel_ros.recording import topics
from tel_ros.recording.trial_bag import read_topic

Joints = tuple[float, ...]


def read_arm_record(
    bag: Path, command_topic: str
) -> tuple[dict[int, tuple[Joints, Joints]], list[tuple[int, Joints]]]:
    """Return the joint states and the commands of a trial, of joints in the order of the messages.

    Returns:
        Stamp [ns] to positions in rad and velocities in rad/s; and stamps of the states that were answered,
        each with the command that answered it.

    Raises:
        BagError: the bag cannot be read, or holds no joint states.
    """
    states = {
        time_ns: (tuple(state.position.tolist()), tuple(state.velocity.tolist()))
        for time_ns, state in read_topic(bag, topics.JOINT_STATES)
    }
    if not states:
        raise BagError(bag, "holds no joint states", "those of a trial")
    commands = read_topic(bag, command_topic)
    return states, [(time_ns, tuple(command.data.tolist())) for time_ns, command in commands]
