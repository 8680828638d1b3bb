"""A bag, published again: what is heard is what was recorded, and an arm is never in danger."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from graph_harness import Graph
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool
from tel_interfaces.msg import ControlState, TrialGoal
from tel_process import HANG_S, PATIENT, ROOT, TelProcess

sys.path.insert(0, str(ROOT / "test" / "recording"))

from small_bags import STATES, joint_state, write_bag  # noqa: E402
from synthetic_trial import SyntheticTrial  # noqa: E402

from tel_ros.core.types import NS_PER_S  # noqa: E402
from tel_ros.nodes import qos  # noqa: E402
from tel_ros.nodes.bag_player import BagPlayer, message_class  # noqa: E402
from tel_ros.recording import topics  # noqa: E402
from tel_ros.recording.any_bag import open_any_bag  # noqa: E402
from tel_ros.recording.replay import Replay  # noqa: E402

MADE_UP = "nobody_msgs/msg/Nothing"


@pytest.fixture
def replaying() -> Iterator[Callable[..., TelProcess]]:
    """Return a function that starts ``tel replay``; whatever it started is ended."""
    started: list[TelProcess] = []

    def start(bag: Path, *options: str) -> TelProcess:
        started.append(TelProcess(["replay", str(bag), *options], bag, {}))
        return started[-1]

    yield start
    for process in started:
        if process.process.poll() is None:
            process.kill()
            process.process.communicate(timeout=HANG_S)


def test_what_is_heard_is_what_was_recorded(graph: Callable[..., Graph], tmp_path: Path) -> None:
    trial = SyntheticTrial(start_ns=1_700_000_000 * NS_PER_S)
    bag, client = trial.write(tmp_path / "bag"), graph([])
    recorded = {topic: [raw for t, _, raw in trial.messages() if t == topic] for topic in _TOPICS}
    heard: dict[str, list[bytes]] = {topic: [] for topic in _TOPICS}
    for topic, kind in _TOPICS.items():
        client.node.create_subscription(
            kind, f"/replay/{topic}", heard[topic].append, qos.EVERYTHING, raw=True
        )
    ticks = client.listen(Clock, topics.CLOCK)
    with open_any_bag(bag) as reader:
        replay = Replay(reader)
        with BagPlayer(replay) as player:
            # What is known to the graph may not be connected yet; volatile messages are for connected ones.
            awaited = [player._clock, *(player._publishers[f"/replay/{topic}"] for topic in _TOPICS)]
            client.spin_until(
                lambda: all(publisher.get_subscription_count() > 0 for publisher in awaited),
                "the connections",
            )
            assert not any(player.node.count_publishers(topic) for topic in topics.COMMANDS.values())
            published = threading.Thread(target=player.play, args=(1.0,))
            published.start()
            client.spin_until(lambda: heard == recorded, "all that was recorded")
            published.join(timeout=30.0)
            late: list[bytes] = []
            client.node.create_subscription(
                TrialGoal, f"/replay/{topics.TRIAL_GOAL}", late.append, qos.LATCHED, raw=True
            )
            client.spin_until(lambda: bool(late), "the goal, heard late")
    assert late == [raw for topic, _, raw in trial.messages() if topic == topics.TRIAL_GOAL]
    times_ns = [tick.clock.sec * NS_PER_S + tick.clock.nanosec for tick in ticks]
    assert times_ns == sorted(set(times_ns))
    assert set(trial.time_ns.tolist()) <= set(times_ns)
    assert player.skipped == []


def test_time_stands_still_in_a_pause(graph: Callable[..., Graph], tmp_path: Path) -> None:
    bag, client = SyntheticTrial().write(tmp_path / "bag"), graph([])
    over = threading.Event()

    def end_it() -> bool:
        if over.is_set():
            raise KeyboardInterrupt
        return False

    def play(player: BagPlayer) -> None:
        with suppress(KeyboardInterrupt):
            player.play(0.01)

    def set_pause(wanted: bool) -> None:
        assert client.call(SetBool, "/replay/pause", SetBool.Request(data=wanted)).success

    with (
        open_any_bag(bag) as reader,
        BagPlayer(Replay(reader), toggled=end_it) as player,
    ):
        playing = threading.Thread(target=play, args=(player,))
        playing.start()
        try:
            client.spin_until(lambda: player.published > 0, "the first message")
            set_pause(True)
            published = player.published
            time.sleep(0.5)  # in which a message would be due every 0.07 s
            assert player.published == published
            set_pause(False)
            client.spin_until(lambda: player.published > published, "the next message")
        finally:
            over.set()
            playing.join(timeout=HANG_S)
    assert player.published < len(list(SyntheticTrial().messages()))


_TOPICS = {topics.EFFORT_COMMANDS: Float64MultiArray, topics.CONTROL_STATES: ControlState}


def test_a_controller_sees_the_recorded_states_until_an_arm_comes(
    graph: Callable[..., Graph], replaying: Callable[..., TelProcess], tmp_path: Path
) -> None:
    states = [
        ("/somebodys_arm/states", STATES, k * 2_000_000, joint_state(k * 2_000_000, JOINTS, [0.25, k / 1e4]))
        for k in range(1, 3001)
    ]
    bag = write_bag(tmp_path / "bag", [*states, ("/nothing", MADE_UP, 0, bytes(12))])
    running = graph(["ep_controller"], *PATIENT)
    running.activate_controller()
    seen = running.listen(ControlState, topics.CONTROL_STATES)
    replay = replaying(bag, "--states-to-nodes", "--loop", "--rate", "0.5")
    running.spin_until(lambda: len(seen) > 5, "what the controller sees")
    for state in seen:
        stamp_ns = state.header.stamp.sec * NS_PER_S + state.header.stamp.nanosec
        assert list(state.position_rad) == [0.25, stamp_ns / 2_000_000 / 1e4]
    assert replay.process.poll() is None
    commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
    code, out, said = replay.finish()
    assert (code, commands) == (2, [])
    # The name of a node may become known later than its subscriptions.
    assert "listens to /effort_controller/commands: it may be an arm" in said
    assert "/nothing is left out: there is no nobody_msgs/msg/Nothing here" in said
    assert "/somebodys_arm/states → /joint_states (3000 messages)" in out


JOINTS = ("shoulder", "elbow")


@pytest.mark.parametrize(
    "name", ["nobody_msgs/msg/Nothing", "sensor_msgs/msg/Nothing", "sensor_msgs/srv/SetCameraInfo", "os", ""]
)
def test_types_that_are_not_here_have_no_class(name: str) -> None:
    assert message_class(name) is None
    assert message_class("tel_interfaces/msg/ControlState") is ControlState
