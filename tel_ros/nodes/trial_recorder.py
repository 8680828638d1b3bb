"""Records each trial to a bag of its own."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tel_interfaces import msg as messages
from tel_interfaces.srv import StartRecording, StopRecording

from tel_ros.core.errors import BagError, TelError
from tel_ros.core.types import NS_PER_S
from tel_ros.nodes import qos
from tel_ros.nodes.clock import STEADY
from tel_ros.nodes.conversions import time_ns
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.hot_loop import BusyGroup
from tel_ros.nodes.parameters import load_parameters
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics
from tel_ros.recording.bag_format import to_cdr, typestore
from tel_ros.recording.bag_writer import TrialBagWriter, free_mb
from tel_ros.recording.cdr import answered_ns, header_stamp_ns, trial_index

DISCOVERY_TIMEOUT_S = 5.0
DRAIN_TIMEOUT_S = 5.0
HEARD_LATELY_S = 1.0
COMMANDS = "commands"
"""Stands for whichever topic of commands a trial has."""
LITTLE_SPACE_MB, NO_SPACE_MB = 500.0, 50.0
"""A trial of ten seconds at 500 Hz takes about 3 MB."""
_CHECK_PERIOD_S = 0.02
_BATCH_S = 0.01  # nobody waits for the recorder, so it need not wake up for every message
_MESSAGE_TYPES = {topics.JOINT_STATES: JointState, topics.CONTROL_STATES: messages.ControlState}


class TrialRecorderNode(Node):
    """Writes serialised messages as they come, in the arm's own time.

    A message's time in the bag is the stamp of its header; a command's is that of the joint state that it
    answers. So a bag plays at the pace of the arm, however fast or slow the graph ran.
    """

    def __init__(self) -> None:
        super().__init__("trial_recorder")
        config = load_parameters(self, "recording")
        self._recording = config.recording
        # One that follows trajectories gets no command of each state.
        follows = config.arm.command_interface == "trajectory"
        self._commands = () if follows else tuple(topics.RECORDED_COMMANDS)
        typestore()  # takes a second to import: now, not when the first trial waits for it
        self._writer: TrialBagWriter | None = None
        self._heard_at: dict[str, float] = {}
        self._newest_ns = 0
        self._stamps: dict[str, list[int]] = {}
        self._last_bag: Path | None = None
        self._dropped_last = 0
        self._missing: dict[str, int] = {}
        self._trouble = ""
        self._ticks: Counter[int] = Counter()
        self._is_over = False
        busy = BusyGroup()
        self.batch_s = _BATCH_S
        self.busy_subscriptions = [
            self.create_subscription(
                kind, topic, partial(self._record, topic), qos.EVERYTHING, raw=True, callback_group=busy
            )
            for topic, kind in (_MESSAGE_TYPES | dict.fromkeys(self._commands, Float64MultiArray)).items()
        ]
        # Both services wait: in a group of their own, messages are served meanwhile.
        self._group = ReentrantCallbackGroup()
        for kind, name, answer in (
            (StartRecording, topics.START_RECORDING, self._start),
            (StopRecording, topics.STOP_RECORDING, self._stop_recording),
        ):
            self.create_service(kind, topics.private(name), answer, callback_group=self._group)
        self._diagnostics = Diagnostics(self, "recording", config.arm.name, self._health, self._group)

    def stop(self) -> None:
        """Do nothing: whoever has started a recording ends it, once the arm is at rest."""

    @property
    def stopped(self) -> bool:
        """Whether no bag is open."""
        return self._writer is None

    def destroy_node(self) -> None:
        """Leave an open bag among the unfinished ones."""
        if self._writer is not None:
            self._writer.abandon()
        super().destroy_node()

    def _record(self, topic: str, raw: bytes) -> None:
        self._heard_at[topic] = time.monotonic()
        if topic == topics.JOINT_STATES:
            self._newest_ns = header_stamp_ns(raw)
        if self._writer is None:
            return
        if topic in topics.RECORDED_COMMANDS:
            said_ns = answered_ns(raw)
            stamp_ns = self._newest_ns if said_ns is None else said_ns
        else:
            stamp_ns = header_stamp_ns(raw)
        stamps = self._stamps.setdefault(topic, [])
        if stamps and stamps[-1] == stamp_ns:
            return  # an arm in lockstep repeats its state until it gets an answer
        if topic == topics.CONTROL_STATES:
            index = trial_index(raw)
            self._is_over = index == 0 and self._ticks.total() > 0
            if index == 0:
                return  # said between trials
            self._ticks[index] += 1
        try:
            self._writer.write(topic, stamp_ns, raw)
            stamps.append(stamp_ns)
        except BagError as error:  # the bag stays among the unfinished ones; the trial's end says so
            writer, self._writer = self._writer, None
            self._complain(error)
            writer.abandon()

    def _has_all_until(self, end_ns: int) -> bool:
        """Return whether everything up to the last tick has arrived, and the state after its command."""
        last = {topic: stamps[-1] for topic, stamps in self._stamps.items() if stamps}
        commands = [last[topic] for topic in self._commands if topic in last]
        return (
            last.get(topics.JOINT_STATES, -1) > end_ns
            and last.get(topics.CONTROL_STATES, -1) >= end_ns
            and (not self._commands or max(commands, default=-1) >= end_ns)
        )

    async def _start(
        self, request: StartRecording.Request, response: StartRecording.Response
    ) -> StartRecording.Response:
        bag = Path(request.bag)
        try:
            if self._writer is not None and not self._is_over:
                raise BagError(bag, f"{self._writer.bag} is being recorded", "one recording at a time")
            if self._writer is not None:  # who has started it died, and the trial went to its end
                abandoned, self._writer = self._writer, None
                self.get_logger().warning(f"nobody has ended the recording {abandoned.bag}: left unfinished")
                abandoned.abandon()
            await self._until(lambda: not self._silent(), DISCOVERY_TIMEOUT_S)
            if self._silent():
                silent = ", ".join(map(self.resolve_topic_name, self._silent()))
                raise BagError(bag, f"nothing is heard on {silent}", "the topics of a trial")
            metadata = dict(zip(request.metadata_keys, request.metadata_values, strict=True))
            writer = TrialBagWriter(bag, metadata, self._recording, self.get_namespace())
            try:
                # With the time of the newest joint state; on the disk before a crash.
                goal = to_cdr("tel_interfaces/msg/TrialGoal", request.goal)
                writer.write(topics.TRIAL_GOAL, self._newest_ns, goal)
                writer.flush()
            except BagError:
                writer.abandon()
                raise
        except (TelError, ValueError) as error:
            response.message = self._complain(error)
            return response
        self._last_bag, self._trouble, self._missing = bag, "", {}
        self._stamps = {topic: [] for topic in topics.RECORDED_LIVE}
        self._ticks.clear()
        self._is_over = False
        self._writer = writer
        response.success = True
        return response

    async def _stop_recording(
        self, request: StopRecording.Request, response: StopRecording.Response
    ) -> StopRecording.Response:
        if self._writer is None:
            response.message = self._trouble or "nothing is being recorded"
            return response
        writer, result = self._writer, request.result
        response.bag = str(writer.bag)
        try:
            end_ns = time_ns(result.end_stamp)
            await self._until(
                lambda: result.ticks == 0 or self._has_all_until(end_ns),
                DRAIN_TIMEOUT_S,
                lambda: self._ticks[result.index],  # a backlog is worked off, however long that takes
            )
            self._writer = None
            # Counted, because the trial's clock may have jumped.
            response.dropped = self._dropped_last = max(0, result.ticks - self._ticks[result.index])
            if response.dropped:
                writer.abandon()
                first_s = (self._stamps[topics.CONTROL_STATES] or [0])[0] / NS_PER_S
                raise BagError(
                    writer.bag,
                    f"{response.dropped} of the trial's {result.ticks} control states did not arrive "
                    f"(the trial began at {time_ns(result.start_stamp) / NS_PER_S:.3f} s, "
                    f"the recording at {first_s:.3f} s)",
                    "all of them; the bag is left unfinished",
                )
            writer.write(topics.TRIAL_RESULT, end_ns, to_cdr("tel_interfaces/msg/TrialResult", result))
            writer.close()
        except TelError as error:
            self._writer = None
            response.message = self._complain(error)
            return response
        self._missing = missing(self._stamps, self._commands)
        if self._missing:  # what is not learned from: a lost tick fails the trial
            lost = ", ".join(f"{n} of {topic}" for topic, n in self._missing.items())
            self.get_logger().warning(f"{writer.bag}: did not arrive: {lost}")
        response.topics, response.message_counts = list(writer.counts), list(writer.counts.values())
        response.success = True
        return response

    def _complain(self, error: Exception) -> str:
        self._trouble = str(error)
        self.get_logger().error(self._trouble)
        return self._trouble

    def _health(self) -> Health:
        values: dict[str, object] = {"recording": self._writer is not None, "dropped": self._dropped_last}
        values |= {f"missing {topic}": n for topic, n in self._missing.items()}
        level, message = Level.OK, "waits for a trial"
        if self._writer is not None:
            message = f"records {self._writer.bag.name}"
            values |= {f"messages {topic}": len(stamps) for topic, stamps in self._stamps.items()}
        if self._missing:
            level, message = Level.WARN, f"{self._last_bag}: messages did not arrive"
        if self._trouble:
            level, message = Level.ERROR, self._trouble
        if self._last_bag is not None:
            left_mb = free_mb(self._last_bag)
            values |= {"bag": self._last_bag, "free_mb": round(left_mb)}
            if left_mb < LITTLE_SPACE_MB and level != Level.ERROR:
                level = Level.ERROR if left_mb < NO_SPACE_MB else Level.WARN
                message = f"less than {LITTLE_SPACE_MB:.0f} MB are free for bags"
        return Health(level, message, values)

    async def _until(
        self, condition: Callable[[], bool], timeout_s: float, progress: Callable[[], int] = lambda: 0
    ) -> None:
        """Let other callbacks run until a condition holds, or progress has stopped for a time."""
        if condition():
            return
        over: Future = Future()
        end, so_far = time.monotonic() + timeout_s, progress()

        def check() -> None:
            nonlocal end, so_far
            if progress() != so_far:
                end, so_far = time.monotonic() + timeout_s, progress()
            if not over.done() and (condition() or time.monotonic() > end):
                over.set_result(None)

        timer = self.create_timer(_CHECK_PERIOD_S, check, callback_group=self._group, clock=STEADY)
        await over
        self.destroy_timer(timer)

    def _silent(self) -> list[str]:
        """Return the topics without a recent message.

        A publisher that is known need not be connected yet. Joint states and control states also come between
        trials; commands share the controller's connection.
        """
        recently = time.monotonic() - HEARD_LATELY_S
        return [topic for topic in topics.RECORDED_LIVE if self._heard_at.get(topic, 0.0) < recently]


def missing(
    stamps_ns: Mapping[str, Sequence[int]], topics_of_commands: Collection[str] = topics.RECORDED_COMMANDS
) -> dict[str, int]:
    """Return how many joint states and commands (:data:`COMMANDS`) a recording of a trial lacks, if any.

    Each control state carries the stamp of the joint state that it answers, and so does the command that went
    out with it: a stamp without its counterpart is a message that was lost on the way. What came before the
    first message of a topic does not count, because the recording may have begun in between.

    ``stamps_ns``: of what was recorded, by topic; of control states only those of the trial. Without
    ``topics_of_commands`` none are expected.
    """
    answered = stamps_ns.get(topics.CONTROL_STATES, ())
    found = {topics.JOINT_STATES: set(stamps_ns.get(topics.JOINT_STATES, ()))}
    if topics_of_commands:
        found[COMMANDS] = {stamp for topic in topics_of_commands for stamp in stamps_ns.get(topic, ())}
    lacking = {}
    for topic, present in found.items():
        begun = next((k for k, stamp in enumerate(answered) if stamp in present), 0)
        lacking[topic] = sum(stamp not in present for stamp in answered[begun:])
    return {topic: n for topic, n in lacking.items() if n}


main = partial(run_node, TrialRecorderNode)

if __name__ == "__main__":
    main()
