"""A trial in its bag: what is stored beside the messages, and reading it back."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, TelError, counted
from tel_ros.core.practice.strategy import PlannedTrial
from tel_ros.core.springs import SpringChange, Springs
from tel_ros.core.trial import Outcome, Phase, Trial, TrialReport
from tel_ros.core.types import NS_PER_S, FloatArray
from tel_ros.recording import any_bag, topics
from tel_ros.recording.any_bag import AnyBag
from tel_ros.recording.bag_writer import CHECKSUMS, RECOVERED, sha256
from tel_ros.recording.cdr import time_ns
from tel_ros.recording.config_file import config_from, dump_config
from tel_ros.recording.provenance import stored_files
from tel_ros.recording.trial_result import report_of

_EXPECTED = "a closed rosbag2 folder of a trial"
GO_BACK_TO = "go_back_to"
"""In the metadata: the trial whose network was gone back to before this one; empty: none."""
REVISION = "network_revision"
"""In the metadata: of the network that has predicted the command."""


@dataclass(frozen=True, kw_only=True)
class RecordedTrial(Trial):
    """A trial as it lies in its bag, with what was stored beside the messages."""

    bag: Path
    metadata: Mapping[str, str]
    command_std_rad: FloatArray
    """Standard deviation that the network expected of the error in û, for the ticks of RUN (the last holds
    for those beyond the trajectory). Shape (n_run, n_joints); inf where it or the bag does not tell."""


def trial_metadata(plan: PlannedTrial, config: Config, written: Config, revision: str) -> dict[str, str]:
    """Return the custom data of a trial's bag: all that it takes to plan, repeat and learn from the trial.

    ``written`` is ``config`` as in the run's folder; ``revision``: of the network that predicted the command.
    """
    return {
        "config": dump_config(written),
        "strategy": config.practice.strategy,
        "trial": str(plan.index),
        "alpha": repr(plan.alpha),
        "duration_s": repr(plan.movement.own_duration_s),
        "reason": plan.reason,
        **({"path": plan.movement.path} if plan.movement.path else {}),
        "seed": str(config.seed),
        GO_BACK_TO: "" if plan.go_back_to is None else str(plan.go_back_to),
        REVISION: revision,
        **{f"version.{name}": version for name, version in written.versions.items()},
        **stored_files(config, plan.index),
    }


def read_trial(bag: Path, *, recovered: bool = False) -> RecordedTrial:
    """Read a trial; BagError unless it is whole: closed, unchanged, all of its messages and ticks there.

    With ``recovered`` a bag that was recovered after a crash will do, for a person who wants to look: its end
    may be missing. Where there is no result, the outcome is ``ABORTED``; the message says why.
    """
    with _opened(bag, recovered) as (reader, metadata):
        states, results, goals = (
            [message for _, message in _messages(reader, topic)]
            for topic in (topics.CONTROL_STATES, topics.TRIAL_RESULT, topics.TRIAL_GOAL)
        )
        if RECOVERED in metadata and not results and goals:
            results = [None]
        for what, messages in (("results", results), ("goals", goals)):
            if len(messages) != 1:
                raise BagError(bag, f"holds {len(messages)} trial {what}", "exactly one")
        return _trial(bag, metadata, states, results[0], goals[0])


def read_report(bag: Path) -> TrialReport:
    """Return the report of a recorded trial; BagError also if it does not hold exactly one result."""
    results = read_topic(bag, topics.TRIAL_RESULT)
    if len(results) != 1:
        raise BagError(bag, f"holds {counted(len(results), 'trial result')}", "exactly one")
    return report_of(results[0][1])


def read_topic(bag: Path, topic: str) -> list[tuple[int, Any]]:
    """Return time [ns] and content of a topic's messages in a closed bag; BagError unless all."""
    with _opened(bag) as (reader, _):
        return _messages(reader, topic)


def check_bag(bag: Path) -> None:
    """Raise BagError unless a bag is closed, unchanged, not recovered and can be opened; reads no message."""
    with _opened(bag):
        pass


@contextmanager
def _opened(bag: Path, recovered: bool = False) -> Iterator[tuple[AnyBag, dict[str, str]]]:
    """Open a bag; whatever goes wrong with it, meanwhile as well, becomes a BagError."""
    metadata = read_metadata(bag, recovered=recovered)
    with any_bag.reading(bag, _EXPECTED):
        check_sums(bag)
        with any_bag.open_any_bag(bag) as reader:
            yield reader, metadata


def check_sums(bag: Path) -> None:
    """Raise BagError if a data file is not as it was recorded. Bags of other recorders come without sums."""
    if not (bag / CHECKSUMS).is_file():
        return
    for line in (bag / CHECKSUMS).read_text(encoding="utf-8").splitlines():
        recorded, name = line.split(maxsplit=1)
        if sha256(bag / name) != recorded:
            found = f"cannot be trusted: {name} has changed since it was recorded"
            raise BagError(bag, found, f"the checksum in {CHECKSUMS}")


def _trial(bag: Path, metadata: dict[str, str], states: list[Any], result: Any, goal: Any) -> RecordedTrial:
    # Of a trial whose recording ended before it did only the goal tells.
    report = _unfinished(goal, metadata[RECOVERED]) if result is None else report_of(result)
    joints = tuple((goal if result is None else result).joint_names)
    states = [state for state in states if state.trial == report.index]
    # A trial that lost the arm before its first tick has none, and is whole.
    if len(states) < report.ticks or (not states and report.outcome == Outcome.COMPLETED):
        expected = f"at least the trial's {counted(report.ticks, 'tick')}"
        raise BagError(bag, f"holds {counted(len(states), 'control state')}", expected)

    def column(name: str) -> Any:
        values = [getattr(state, name) for state in states]
        lengths = {len(value) for value in values} - {len(joints)}
        if lengths:
            expected = f"one value for each of the joints {', '.join(joints)}"
            raise BagError(bag, f"holds {counted(lengths.pop(), 'value')} in {name}", expected)
        return np.array(values).reshape(len(states), len(joints))

    derivatives = ("desired_position_rad", "desired_velocity_rad_s", "desired_acceleration_rad_s2")
    phase = np.array([state.phase for state in states], dtype=np.int64)
    same = ("equilibrium_rad", "position_rad", "velocity_rad_s", "effort_nm")
    return RecordedTrial(
        bag=bag,
        metadata=metadata,
        report=report,
        joints=joints,
        time_ns=np.array([time_ns(state.header.stamp) for state in states], dtype=np.int64),
        phase=phase,
        desired=np.hstack([column(name) for name in derivatives]),
        **{name: column(name) for name in same},
        saturated=column("saturated").astype(bool),
        command_std_rad=_command_std(bag, goal, int(np.count_nonzero(phase == Phase.RUN))),
        springs=_springs(bag, metadata, goal, joints),
    )


def _unfinished(goal: Any, why: str) -> TrialReport:
    unknown = np.full(len(goal.joint_names), math.nan)
    return TrialReport(
        index=int(goal.trial),
        alpha=float(goal.alpha),
        duration_s=goal.time_ns[-1] / NS_PER_S,
        outcome=Outcome.ABORTED,
        message=f"the recording has no end: recovered {why}",
        rms_error_rad=math.nan,
        rms_error_per_joint_rad=unknown,
        max_error_rad=math.nan,
        max_effort_nm=unknown,
        saturated_ratio=math.nan,
    )


def _springs(
    bag: Path, metadata: Mapping[str, str], goal: Any, joints: tuple[str, ...]
) -> SpringChange | None:
    """Return the springs that came with the goal, and those of the configuration that is stored with them."""
    # Bags from before goals had them have no such fields.
    stiffness = np.asarray(getattr(goal, "stiffness_nm_per_rad", ()), dtype=np.float64)
    damping = np.asarray(getattr(goal, "damping_nms_per_rad", ()), dtype=np.float64)
    if stiffness.size == damping.size == 0:
        return None
    try:
        config: Config = config_from(yaml.safe_load(metadata["config"]))
        columns = [list(goal.joint_names).index(joint) for joint in joints]
        used, configured = Springs(stiffness[columns], damping[columns]), Springs.of(config.arm)
        if config.arm.joints != joints:
            raise ValueError(f"its configuration is for the joints {', '.join(config.arm.joints)}")
    except (TelError, yaml.YAMLError, KeyError, ValueError, IndexError, TypeError) as error:
        found = f"does not tell how stiff its springs were ({error})"
        raise BagError(bag, found, "K and B for each joint, and the configuration in the metadata") from None
    return None if used.equal(configured) else SpringChange(used, configured)


def _command_std(bag: Path, goal: Any, n_run: int) -> FloatArray:
    """Return the standard deviation that came with the goal, one row a tick of RUN."""
    n_joints, n = len(goal.joint_names), len(goal.time_ns)
    # Bags from before goals had it have no such field.
    flat = np.asarray(getattr(goal, "std_rad", ()), dtype=np.float64)
    if flat.size == 0:
        return np.full((n_run, n_joints), np.inf)
    if flat.size != n * n_joints:
        expected = f"nothing, or one value for each of the {n} points and {n_joints} joints"
        raise BagError(bag, f"its goal holds {counted(flat.size, 'value')} in std_rad", expected)
    std: FloatArray = flat.reshape(n, n_joints)[np.minimum(np.arange(n_run), n - 1)]
    return std


def read_metadata(bag: Path, *, recovered: bool = False) -> dict[str, str]:
    """Return what was stored beside the messages of a closed bag, not a recovered one unless that will do."""
    file = bag / any_bag.METADATA_FILE
    if not file.is_file():
        unclosed = bag.is_dir() and any_bag.files_in(bag)
        found = "has no metadata.yaml: it was never closed" if unclosed else any_bag.what_is(bag)
        raise BagError(bag, found, _EXPECTED)
    information = any_bag.bag_information(bag)
    metadata = any_bag.custom_data(information)
    # Anybody's data would do without; here the mark of a recovered bag stands, and how much there has to be.
    for key, kind in (("custom_data", dict), ("topics_with_message_count", list)):
        if not isinstance(information.get(key, "") or kind(), kind) or key not in information:
            raise BagError(file, f"tells no {key}", "the metadata of a trial's bag")
    if RECOVERED in metadata and not recovered:
        found = f"was recovered after a crash ({metadata[RECOVERED]}): its end may be missing"
        raise BagError(bag, found, "a bag that was recorded to its end")
    return metadata


def _messages(reader: AnyBag, topic: str) -> list[tuple[int, Any]]:
    connections = [c for c in reader.connections if topics.is_named(c.topic, topic)]
    if not connections:
        raise BagError(reader.bag, f"has no topic {topics.absolute(topic)}", "a bag of a trial")
    return reader.contents(connections, exactly=True)


def read_arm_record(
    bag: Path, command_topic: str
) -> tuple[dict[int, tuple[tuple[float, ...], tuple[float, ...]]], list[tuple[int, tuple[float, ...]]]]:
    """Return states and commands of a trial, of joints in the order of the messages.

    Stamp [ns] to positions and velocities; and stamps of states that were answered, each with its command.
    """
    states = {
        stamp_ns: (tuple(state.position.tolist()), tuple(state.velocity.tolist()))
        for stamp_ns, state in read_topic(bag, topics.JOINT_STATES)
    }
    if not states:
        raise BagError(bag, "holds no joint states", "those of a trial")
    commands = read_topic(bag, command_topic)
    return states, [(stamp_ns, tuple(command.data.tolist())) for stamp_ns, command in commands]
