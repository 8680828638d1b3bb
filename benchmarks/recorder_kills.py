"""SIGKILL for the recorder at random moments of a trial: what is whole, what can be recovered, what is lost.

    .venv/bin/python benchmarks/recorder_kills.py --kills 100 --seed 1

Each time a real ``trial_recorder`` in a process of its own first records a short trial to its end and then
gets a second one, with seven joints. At a random moment from the call of *start* to a moment after
that of *stop* it is killed. What this process has sent is what there was to record. Then:

- the first trial must be whole, whatever became of the second;
- a second trial under its own name must be whole;
- else ``recover`` must give, byte by byte and without a gap, everything up to a moment no longer before the
  last message that the recorder can have taken than a chunk (and than the time by which the recorder was
  behind, which shows as well), and nothing may take the recovered bag for a whole one.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from recorder_stream import Stream, start_request, stop_request
from rosbags.highlevel import AnyReader
from tel_interfaces.srv import StartRecording, StopRecording

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S
from tel_ros.nodes.trial_recorder import main as recorder_main
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.recover import recover
from tel_ros.recording.trial_bag import read_trial

FIRST, SECOND = "trial_001", "trial_002"
N_JOINTS, N_POINTS = 7, 1000
FIRST_S, SECOND_S, AFTERWARDS_S = 0.1, 2.0, 0.1
ANSWER_TIMEOUT_S = 60.0
N_DOMAINS = 40


@dataclass(frozen=True)
class Kill:
    """What one kill left behind.

    Args:
        storage: of the bags.
        moment_s: when, after the call of *start* for the second trial.
        found: ``whole``, ``recovered``, ``not begun`` (no recording yet), or ``nothing`` (no whole chunk).
        sent: messages of the trial and around it that were sent before the kill.
        saved: of these, messages in the bag.
        lost_s: from the newest joint state in the bag to the newest that was sent.
        violations: what must not be.
    """

    storage: str
    moment_s: float
    found: str
    sent: int
    saved: int
    lost_s: float
    violations: tuple[str, ...]


class Client(Node):
    """Calls the recorder's services."""

    def __init__(self, context: Context) -> None:
        super().__init__("kills", context=context)
        self.executor_ = SingleThreadedExecutor(context=context)
        self.executor_.add_node(self)
        self._start = self.create_client(StartRecording, topics.START_RECORDING)
        self._stop = self.create_client(StopRecording, topics.STOP_RECORDING)

    def is_ready(self) -> bool:
        """Return whether a recorder is there."""
        return bool(self._start.service_is_ready() and self._stop.service_is_ready())

    def call_start(self, bag: Path, goal: Any) -> Any:
        """Call and return the future."""
        return self._start.call_async(start_request(str(bag), goal))

    def call_stop(self, result: Any) -> Any:
        """Call and return the future."""
        return self._stop.call_async(stop_request(result))

    def spin_until(self, done: Any, timeout_s: float) -> bool:
        """Return whether a condition came true in time."""
        end = time.monotonic() + timeout_s
        while not done():
            if time.monotonic() > end:
                return False
            self.executor_.spin_once(timeout_sec=0.01)
        return True

    def answer(self, future: Any) -> Any:
        """Wait for an answer that has to say success."""
        if not self.spin_until(future.done, ANSWER_TIMEOUT_S):
            raise TimeoutError("the recorder does not answer")
        if not future.result().success:
            raise RuntimeError(future.result().message)
        return future.result()


def record(domain: int, storage: str, chunk_s: float) -> None:
    """Be the recorder; runs in a process of its own."""
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    sys.argv = ["trial_recorder", "--ros-args", "--log-level", "error"]
    sys.argv += ["-p", f"recording.storage:={storage}", "-p", f"recording.chunk_s:={chunk_s}"]
    recorder_main()


def kill_once(
    folder: Path, recording: RecordingConfig, moment_s: float, domain: int, rate_hz: float, seed: int
) -> Kill:
    """Record a trial, begin another one, kill the recorder, and look what is there.

    In a ROS domain that is new, because the others take a process that was killed for a living one for many
    seconds.
    """
    spawner = multiprocessing.get_context("forkserver")
    process = spawner.Process(target=record, args=(domain, recording.storage, recording.chunk_s))
    process.start()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    client = Client(context)
    try:
        with Stream(client, rate_hz, N_JOINTS, (topics.EFFORT_COMMANDS,), seed) as stream:
            sent, begun = sent_until_kill(client, stream, process, folder, moment_s)
    finally:
        process.kill()
        process.join()
        client.destroy_node()
        context.try_shutdown()
    kill = judge(recording, moment_s, folder, sent)
    if begun and kill.found in ("not begun", "nothing"):
        return replace(kill, violations=(*kill.violations, "nothing is left of a recording that had begun"))
    return kill


def sent_until_kill(
    client: Client, stream: Stream, process: Any, folder: Path, moment_s: float
) -> tuple[list[Any], bool]:
    """Record a trial, begin another one, and kill the recorder.

    Returns:
        What had been sent by then, and whether the recorder had said that the recording has begun.
    """
    if not client.spin_until(client.is_ready, ANSWER_TIMEOUT_S):
        raise TimeoutError("the recorder did not come up")
    client.answer(client.call_start(folder / FIRST, stream.goal(1, N_POINTS)))
    stream.begin(1)
    client.spin_until(lambda: False, FIRST_S)
    client.answer(client.call_stop(stream.end(1)))
    goal = stream.goal(2, N_POINTS)
    stream.begin(2)
    started = client.call_start(folder / SECOND, goal)
    client.spin_until(lambda: False, min(moment_s, SECOND_S))
    if moment_s > SECOND_S:
        client.call_stop(stream.end(2))
        client.spin_until(lambda: False, moment_s - SECOND_S)
    process.kill()
    return list(stream.sent), started.done()


def judge(recording: RecordingConfig, moment_s: float, folder: Path, sent: list[Any]) -> Kill:
    """Return what is there after a kill, and what must not be."""
    first, second = folder / FIRST, folder / SECOND
    violations = []
    unfinished = second.parent / UNFINISHED / second.name
    try:
        read_trial(first)
    except BagError as error:
        violations.append(f"the trial before is not whole: {error}")
    if second.exists():
        found, bag = "whole", second
        try:
            read_trial(second)
        except BagError as error:
            violations.append(f"not whole under its own name: {error}")
    elif not unfinished.exists() or not list(unfinished.glob("*.*[34p]")):
        return Kill(recording.storage, moment_s, "not begun", len(sent), 0, 0.0, tuple(violations))
    else:
        found = "recovered"
        try:
            bag = recover(unfinished).bag
        except BagError as error:
            if "no whole chunk" not in str(error) and "no transaction" not in str(error):
                violations.append(str(error))
            return Kill(recording.storage, moment_s, "nothing", len(sent), 0, 0.0, tuple(violations))
        with suppress(BagError):
            read_trial(bag)
            violations.append("a recovered bag passes for a whole one")
    saved = in_bag(bag)
    violations += compared(saved, sent)
    n_saved = sum(len(stamps) for stamps in saved.values())
    states = [stamp for topic, stamp, _ in sent if topic == topics.JOINT_STATES]
    newest = max(saved.get(topics.JOINT_STATES, {states[0]: b""}))
    lost_s = max(0, states[-1] - newest) / NS_PER_S
    return Kill(recording.storage, moment_s, found, len(sent), n_saved, lost_s, tuple(violations))


def in_bag(bag: Path) -> dict[str, dict[int, bytes]]:
    """Return the live messages in a bag: topic to stamp to bytes."""
    found: dict[str, dict[int, bytes]] = {}
    with AnyReader([bag]) as reader:
        for connection, time_ns, raw in reader.messages():
            topic = connection.topic.removeprefix("/")
            if topic not in topics.RECORDED_ONCE:
                found.setdefault(topic, {})[time_ns] = bytes(raw)
    return found


def compared(saved: dict[str, dict[int, bytes]], sent: list[Any]) -> list[str]:
    """Return where what was saved is not what was sent, without a gap."""
    complaints = []
    for topic, messages in saved.items():
        known = {stamp: raw for t, stamp, raw in sent if t == topic}
        common = [stamp for stamp in messages if stamp in known]
        changed = sum(not is_same(messages[stamp], known[stamp]) for stamp in common)
        if changed:
            complaints.append(f"{changed} messages of {topic} are not as they were sent")
        gaps = sum(min(common) <= s <= max(common) and s not in messages for s in known) if common else 0
        if gaps:
            complaints.append(f"{gaps} messages of {topic} are missing from the middle")
    return complaints


def is_same(received: bytes, sent: bytes) -> bool:
    """Return whether a message is as it was sent.

    The middleware fills it up to a multiple of four bytes, and says by how much in the third and fourth byte.
    """
    return received[:2] == sent[:2] and received[4:] == sent[4:] + bytes(-len(sent) % 4)


def shown(kills: list[Kill], recording: RecordingConfig) -> str:
    """Return a row of the table for one storage."""
    counts = Counter(kill.found for kill in kills)
    lost_s = np.array([kill.lost_s for kill in kills if kill.found == "recovered"])
    p50, most = (np.median(lost_s), lost_s.max()) if len(lost_s) else (np.nan, np.nan)
    share = [100.0 * k.saved / k.sent for k in kills if k.found == "recovered"]
    cells = [
        *(recording.storage, f"{recording.chunk_s:g}", len(kills), counts["whole"], counts["recovered"]),
        *(counts["not begun"], counts["nothing"], f"{p50:.2f}", f"{most:.2f}"),
        *(f"{np.median(share):.0f}" if share else "", sum(bool(kill.violations) for kill in kills)),
    ]
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> int:
    """Run the campaign and print the table; 1 if something happened that must not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=100, help="all storages together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate-hz", type=float, default=500.0, help="of the arm")
    parser.add_argument("--storage", choices=["mcap", "sqlite3"], action="append")
    parser.add_argument("--chunk-s", type=float, default=RecordingConfig().chunk_s)
    parser.add_argument("--first-domain", type=int, default=60, help=f"of {N_DOMAINS} ROS domains to use")
    parser.add_argument("--out", type=Path, help="JSON lines, one a kill")
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tel_ros.nodes.trial_recorder"])
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    storages = options.storage or ["mcap", "sqlite3"]
    rng = np.random.default_rng(options.seed)
    kills: dict[str, list[Kill]] = {storage: [] for storage in storages}
    with tempfile.TemporaryDirectory() as root:
        for k in range(options.kills):
            recording = RecordingConfig(storage=storages[k % len(storages)], chunk_s=options.chunk_s)
            moment_s = float(rng.uniform(0.0, SECOND_S + AFTERWARDS_S))
            domain = options.first_domain + k % N_DOMAINS
            where = Path(root) / f"{k:03d}"
            try:
                kill = kill_once(where, recording, moment_s, domain, options.rate_hz, options.seed + k)
            except (TimeoutError, RuntimeError) as error:
                # Before anything was killed: the machine is too busy for a recorder to keep up.
                print(f"kill {k} did not come about: {error}", file=sys.stderr, flush=True)
                continue
            kills[recording.storage].append(kill)
            print(json.dumps(asdict(kill)), file=sys.stderr, flush=True)
            if options.out:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(kill)) + "\n")
    print(
        "| storage | chunk s | kills | whole | recovered | not begun | nothing | lost s, median | most "
        "| saved %, median | violations |\n" + "|---" * 11 + "|"
    )
    for storage, of_storage in kills.items():
        print(shown(of_storage, RecordingConfig(storage=storage, chunk_s=options.chunk_s)))
    return int(any(kill.violations for of_storage in kills.values() for kill in of_storage))


if __name__ == "__main__":
    sys.exit(main())
