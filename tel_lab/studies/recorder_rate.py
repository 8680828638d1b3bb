"""Whether the recorder keeps up with 1 kHz, four topics and seven joints, and what that costs.

A process publishes joint states, efforts, set points and control states. A real ``trial_recorder`` records
them into each of the storages; a bare process subscribes to the same topics through rclpy's executor and
throws the bytes away. Messages a second are those that came, not those that were wanted: on a busy machine
the publisher may not keep up itself. Loss is what was sent during the trial and is not in the bag.

With ``--trials`` it also opens, reads and learns from a run of so many trials: copies of a recorded one.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosbags.highlevel import AnyReader

from tel_lab.recorder_stream import SPAWNER, Client, Sent, Stream, beside, in_bag, is_same, record
from tel_lab.studies.realtime_loop import ON_THIS_MACHINE, cpu_time_s
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import NONE, of_texts
from tel_ros.core.config import RecordingConfig
from tel_ros.core.learning.signals import configured_samples, learning_record
from tel_ros.core.types import NS_PER_S
from tel_ros.nodes import qos
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import CHECKSUMS, BagWriter
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network
from tel_ros.recording.trial_bag import check_bag, read_trial

SAMPLE_RUN = ROOT / "bags" / "sample_run"
RATE_HZ, N_JOINTS, N_POINTS = 1000.0, 7, 5000
COMMANDS = (topics.EFFORT_COMMANDS, topics.POSITION_COMMANDS)
STORAGES = ("mcap", "sqlite3")
WARM_UP_S = 2.0
Row = list[str]


def rate_row(
    who: str, sent: list[Sent], elapsed_s: float, heard: int, lost: int, cpu: float, size: str
) -> Row:
    """Return what a recorder or the bare subscriber did, messages on all topics together.

    ``lost``: sent during the trial and not there; ``cpu``: share of a core; ``size``: bytes/message on disk.
    """
    as_sent = f"{np.mean([len(raw) for _, _, raw in sent]):.0f}"
    rates = f"{len(sent) / elapsed_s:.0f}", f"{heard / elapsed_s:.0f}"
    return [who, *rates, str(lost), f"{100.0 * cpu:.0f}", size, as_sent]


def watched(client: Client, stream: Stream, pid: int, duration_s: float) -> tuple[float, float]:
    """Let a trial go on; return how long it took in s, and the share of a core that a process used then."""
    stream.begin(1)
    cpu_s, began = cpu_time_s(pid), time.monotonic()
    client.spin_for(duration_s)
    elapsed_s = time.monotonic() - began
    return elapsed_s, (cpu_time_s(pid) - cpu_s) / elapsed_s


def listen(domain: int, counts: Any) -> None:
    """Be the bare subscriber; runs in a process of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node("bare", context=context)

    def heard(raw: bytes) -> None:
        counts.value += 1

    for topic, kind in Stream.types(COMMANDS).items():
        node.create_subscription(kind, topic, heard, qos.EVERYTHING, raw=True)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    executor.spin()


def bare(duration_s: float, domain: int) -> Row:
    counts = SPAWNER.Value("q", 0)
    with (
        beside(domain, listen, counts) as (process, client),
        Stream(client, RATE_HZ, N_JOINTS, COMMANDS, seed=1) as stream,
    ):
        client.require(lambda: counts.value > 0, "the bare subscriber hears nothing")
        client.spin_for(WARM_UP_S)
        before = counts.value
        elapsed_s, cpu = watched(client, stream, process.pid, duration_s)
        sent, heard = list(stream.sent), counts.value - before
    # What was on its way at either end is not lost: this process does not know which messages came.
    return rate_row("bare", sent, elapsed_s, heard, 0, cpu, NONE)


def recorded(storage: str, duration_s: float, domain: int, folder: Path) -> Row:
    bag = folder / storage
    with (
        beside(domain, record, storage, RecordingConfig().chunk_s) as (process, client),
        Stream(client, RATE_HZ, N_JOINTS, COMMANDS, seed=1) as stream,
    ):
        client.wait_for_recorder()
        client.spin_for(WARM_UP_S)
        client.answer(client.call_start(bag, stream.goal(1, N_POINTS)))
        elapsed_s, cpu = watched(client, stream, process.pid, duration_s)
        result = stream.end(1)
        end_ns = result.end_stamp.sec * NS_PER_S + result.end_stamp.nanosec
        sent = [message for message in stream.sent if message[1] <= end_ns]
        answer = client.answer(client.call_stop(result))
    saved = in_bag(bag)
    lost = sum(not is_same(saved[topic].get(stamp, b""), raw) for topic, stamp, raw in sent)
    if lost != answer.dropped:
        print(f"{storage}: the recorder says that it has dropped {answer.dropped} ticks", file=sys.stderr)
    size = sum(file.stat().st_size for file in bag.iterdir() if file.suffix in (".mcap", ".db3"))
    on_disk = f"{size / sum(answer.message_counts):.0f}"
    return rate_row(storage, sent, elapsed_s, len(sent) - lost, lost, cpu, on_disk)


def copied_run(storage: str, folder: Path, n_trials: int) -> list[Path]:
    """Return so many bags in a storage, each a copy of the sample run's first trial."""
    source = SAMPLE_RUN / "trial_001"
    bags = [folder / storage / f"trial_{k + 1:03d}" for k in range(n_trials)]
    metadata = dict(read_trial(source).metadata)
    with AnyReader([source]) as reader:
        messages = [(c.topic, time_ns, bytes(raw)) for c, time_ns, raw in reader.messages()]
        kinds = {c.topic: c.msgtype for c in reader.connections}
        for bag in bags:
            with BagWriter(bag, metadata, RecordingConfig(storage=storage)) as writer:  # type: ignore[arg-type]
                for topic, kind in kinds.items():
                    writer.add_topic(topic, kind, ())
                for message in messages:
                    writer.write(*message)
    if not all((bag / CHECKSUMS).is_file() for bag in bags):
        raise ValueError("a bag was not closed")
    return bags


def reading(storage: str, folder: Path, n_trials: int) -> Row:
    """Return what it takes to open, read and learn from a run, in CPU time."""
    config = load_config(SAMPLE_RUN / "run.yaml")
    bags = copied_run(storage, folder, n_trials)
    times_s = [time.process_time()]
    for bag in bags:
        check_bag(bag)
    times_s.append(time.process_time())
    trials = [read_trial(bag) for bag in bags]
    times_s.append(time.process_time())
    network = new_network(config)
    for trial in trials:
        samples = configured_samples(learning_record(trial), config.learning)
        network, _ = network.trained_on(samples, config.learning.training)
    times_s.append(time.process_time())
    size_mb = sum(file.stat().st_size for bag in bags for file in bag.iterdir()) / 1e6
    ticks = sum(len(trial.time_ns) for trial in trials)
    return [storage, str(n_trials), str(ticks), f"{size_mb:.1f}", *(f"{s:.2f}" for s in np.diff(times_s))]


RATES = ("", "sent/s", "heard/s", "lost", "CPU % of a core", "bytes/message on disk", "as sent")
READINGS = ("storage", "trials", "ticks", "MB", "open, CPU s", "read, CPU s", "learn, CPU s")


@study()
@click.option("--duration-s", default=20.0, show_default=True)
@click.option("--repeats", default=3, show_default=True)
@click.option("--trials", default=100, show_default=True, help="Of the run that is read.")
@click.option("--first-domain", default=40, show_default=True)
def recorder_rate(
    options: StudyOptions, duration_s: float, repeats: int, trials: int, first_domain: int
) -> None:
    """Whether the recorder keeps up with 1 kHz, four topics and seven joints, and what that costs."""
    os.environ.update(ON_THIS_MACHINE)
    storages, rates = options.selected(STORAGES), []
    print(f"{os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} before it began\n")
    for turn in range(repeats):
        domain = first_domain + turn * (1 + len(storages))
        with tempfile.TemporaryDirectory() as folder:
            rates.append(bare(duration_s, domain))
            for n, storage in enumerate(storages, start=1):
                rates.append(recorded(storage, duration_s, domain + n, Path(folder)))
    print(of_texts(RATES, rates).markdown(), end="\n\n")
    with tempfile.TemporaryDirectory() as folder:
        print(of_texts(READINGS, [reading(name, Path(folder), trials) for name in storages]).markdown())
