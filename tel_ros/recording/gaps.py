"""Which messages a recording lacks, found from the stamps of those that it has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tel_ros.recording import topics

COMMANDS = "commands"
"""Stands for whichever topic of commands a trial has."""


def missing(stamps_ns: Mapping[str, Sequence[int]]) -> dict[str, int]:
    """Return how many joint states and commands (:data:`COMMANDS`) a recording of a trial lacks, if any.

    Each control state carries the stamp of the joint state that it answers, and so does the command that went
    out with it: a stamp without its counterpart is a message that was lost on the way. What came before the
    first message of a topic does not count, because the recording may have begun in between.
    ``stamps_ns``: of what was recorded, by topic; of control states only those of the trial.
    """
    answered = stamps_ns.get(topics.CONTROL_STATES, ())
    commands = [stamp for topic in topics.RECORDED_COMMANDS for stamp in stamps_ns.get(topic, ())]
    found = {topics.JOINT_STATES: stamps_ns.get(topics.JOINT_STATES, ()), COMMANDS: commands}
    lacking = {topic: _without_counterpart(answered, stamps) for topic, stamps in found.items()}
    return {topic: n for topic, n in lacking.items() if n}


def _without_counterpart(answered: Sequence[int], stamps: Sequence[int]) -> int:
    present = set(stamps)
    begun = next((k for k, stamp in enumerate(answered) if stamp in present), 0)
    return sum(stamp not in present for stamp in answered[begun:])
