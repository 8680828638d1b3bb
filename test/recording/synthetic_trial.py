"""A trial made of numbers, and its messages as they lie in a bag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tel_ros.core.config import RecordingConfig
from tel_ros.core.trial import LoopTiming, Phase
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_format import typestore
from tel_ros.recording.bag_writer import TrialBagWriter
from tel_ros.recording.trial_result import timing_fields

JOINTS = ("shoulder", "elbow")
PERIOD_NS = 2_000_000
METADATA = {"seed": "7", "strategy": "direct", "config": "arm:\n  name: two_link  # ü\n"}


@dataclass
class SyntheticTrial:
    """Rows of random numbers in the phases of a trial, with stamps that need all 64 bits."""

    index: int = 3
    n: int = 120
    seed: int = 0
    start_ns: int = 1_752_000_000 * NS_PER_S + 999_000_001
    outcome: int = 0
    message: str = ""
    joints: tuple[str, ...] = JOINTS
    """As the result names them; the states have two whatever it says."""
    extra_ticks: int = 5
    """Ticks that are recorded after the end of the trial, when it is no trial's any more."""
    std_rad: np.ndarray | None = None
    """What the goal says of the network's error; None: nothing."""
    springs: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    """K and B of the goal; empty: as configured."""
    timing: LoopTiming | None = None
    """How regular the loop was; None: not measured."""
    n_points: int | None = None
    """Points of the goal; None: as many as ticks."""

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        total = self.n + self.extra_ticks
        self.time_ns = self.start_ns + PERIOD_NS * np.arange(total, dtype=np.int64)
        phases = (Phase.APPROACH, Phase.SETTLE, Phase.RUN, Phase.HOLD)
        self.phase = np.sort(rng.choice(phases, total))
        self.values = {
            name: rng.normal(size=(total, 2))
            for name in (
                "desired_position_rad",
                "desired_velocity_rad_s",
                "desired_acceleration_rad_s2",
                "equilibrium_rad",
                "position_rad",
                "velocity_rad_s",
                "effort_nm",
            )
        }
        self.saturated = rng.random((total, 2)) < 0.1

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Return topic, time and bytes of all messages in the order in which a recorder writes them."""
        for k, time_ns in enumerate(self.time_ns.tolist()):
            yield topics.JOINT_STATES, time_ns, self._joint_state(k)
            yield topics.EFFORT_COMMANDS, time_ns, self._command(k)
            yield topics.CONTROL_STATES, time_ns, self._control_state(k)
        yield topics.TRIAL_GOAL, self.start_ns, self._goal()
        yield topics.TRIAL_RESULT, int(self.time_ns[self.n - 1]), self._result()

    def recorded(self) -> list[tuple[str, int, bytes]]:
        """Return the same messages, with the full names that topics have in a bag."""
        return [(f"/{topic}", time_ns, data) for topic, time_ns, data in self.messages()]

    def write(
        self,
        bag: Path,
        metadata: Mapping[str, str] = METADATA,
        *,
        without: str = "",
        recording: RecordingConfig | None = None,
    ) -> Path:
        """Write a closed bag, if wanted without the messages of one topic."""
        with TrialBagWriter(bag, metadata, recording) as writer:
            for topic, time_ns, data in self.messages():
                if topic != without:
                    writer.write(topic, time_ns, data)
        return bag

    def _control_state(self, k: int) -> bytes:
        return message(
            "tel_interfaces/msg/ControlState",
            header=self._header(k),
            trial=self.index if k < self.n else 0,
            phase=int(self.phase[k]),
            time_from_start_s=float(k),
            saturated=self.saturated[k],
            **{name: values[k] for name, values in self.values.items()},
        )

    def _joint_state(self, k: int) -> bytes:
        return message(
            "sensor_msgs/msg/JointState",
            header=self._header(k),
            name=list(JOINTS),
            position=self.values["position_rad"][k],
            velocity=self.values["velocity_rad_s"][k],
            effort=np.zeros(2),
        )

    def _command(self, k: int) -> bytes:
        types = typestore().types
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        return message("std_msgs/msg/Float64MultiArray", layout=layout, data=self.values["effort_nm"][k])

    def _goal(self) -> bytes:
        points = slice(self.n_points)
        fields = {
            name: self.values[f"desired_{name}"][points].ravel()
            for name in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
        }
        return message(
            "tel_interfaces/msg/TrialGoal",
            trial=self.index,
            alpha=0.5,
            joint_names=list(self.joints),
            time_ns=(self.time_ns - self.time_ns[0])[points],
            equilibrium_rad=self.values["equilibrium_rad"][points].ravel(),
            stiffness_nm_per_rad=np.array(self.springs[0], dtype=np.float64),
            damping_nms_per_rad=np.array(self.springs[1], dtype=np.float64),
            std_rad=np.zeros(0) if self.std_rad is None else self.std_rad.ravel(),
            **fields,
        )

    def _result(self) -> bytes:
        return message(
            "tel_interfaces/msg/TrialResult",
            index=self.index,
            outcome=self.outcome,
            message=self.message,
            alpha=0.5,
            duration_s=9.0,
            start_stamp=stamp(int(self.time_ns[0])),
            run_stamp=stamp(int(self.time_ns[0])),
            end_stamp=stamp(int(self.time_ns[self.n - 1])),
            ticks=self.n,
            joint_names=list(self.joints),
            rms_error_rad=0.1,
            rms_error_per_joint_rad=np.array([0.1, 0.1]),
            max_error_rad=0.3,
            max_effort_nm=np.array([4.0, 2.0]),
            saturated_ratio=0.0,
            **timing_fields(self.timing),
        )

    def _header(self, k: int) -> Any:
        return typestore().types["std_msgs/msg/Header"](stamp=stamp(int(self.time_ns[k])), frame_id="")


def stamp(time_ns: int) -> Any:
    """Return a time as a message."""
    return typestore().types["builtin_interfaces/msg/Time"](
        sec=time_ns // NS_PER_S, nanosec=time_ns % NS_PER_S
    )


def message(kind: str, **fields: Any) -> bytes:
    """Return a serialised message."""
    store = typestore()
    return bytes(store.serialize_cdr(store.types[kind](**fields), kind))
