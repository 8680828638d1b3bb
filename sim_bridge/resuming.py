"""Bringing the simulated arm to where it was when a run was interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from sim_bridge.arm import SimulatedArm

States = Mapping[int, tuple[tuple[float, ...], tuple[float, ...]]]
"""What was recorded of a trial: stamp [ns] to positions in rad and velocities in rad/s of all joints."""
Commands = Sequence[tuple[int, Sequence[float]]]
"""Likewise the stamps of the states that were answered, and the commands that answered them."""


def replay_arm(
    new_arm: Callable[[], SimulatedArm], trials: Iterable[tuple[States, Commands]]
) -> tuple[SimulatedArm, int]:
    """Return an arm that has gone through the trials of a run, and how much later it was than its own time.

    Equal commands give bit-identical readings: the arm gets the recorded commands, one a period, and has to
    read what is recorded. So its joints, sensors, noise and the commands on their way are as they were, and
    the time to add [ns] is 0. Where it reads something else (periods have passed without commands, or in real
    time), it rests where it was last. Raises ConfigError: the place where it was last is beyond a hard stop.
    """
    arm, exact = new_arm(), True
    position_rad: tuple[float, ...] = ()
    last_ns = 0
    for states, commands in trials:
        exact = exact and _follows(arm, states, commands)
        last_ns = max(states)
        position_rad = states[last_ns][0]
    if exact:
        return arm, 0
    arm.close()
    arm = new_arm()
    arm.set_state(position_rad, (0.0,) * len(position_rad))
    return arm, last_ns


def _follows(arm: SimulatedArm, states: States, commands: Commands) -> bool:
    for time_ns, command in (*commands, (max(states), None)):
        now_ns, *found, _ = arm.reading()
        # The very first state of a run was there before the recorder listened.
        if now_ns != time_ns or states.get(time_ns, tuple(found)) != tuple(found):
            return False
        if command is not None:
            arm.step(command)
    return True
