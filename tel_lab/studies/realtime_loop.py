"""How regular the loop is in real time: at 500 Hz and 1 kHz, idle and beside a busy core.

Each of these is measured as it is and with the real-time options (docs/realtime.md). A row is one trial of
``tel practice`` with ``sim.clock: realtime``; its figures are those that the controller wrote into the
trial's bag. Behind each, in brackets, stands the same figure of two bare processes: one publishes joint
states from an rclpy timer, the other answers each from a callback; nothing is computed or recorded. They get
the same options. What the machine does to both is the same; the ratio is what is ours.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any

import click
import psutil
from rosbags.highlevel import AnyReader

from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import Column, Table
from tel_ros.core.control.loop_timing import LoopTimer
from tel_ros.core.errors import TelError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.trial_bag import read_trial

ON_THIS_MACHINE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
PRIORITY = 50
SPAWN = multiprocessing.get_context("spawn")


Figures = dict[str, float]
"""What one loop did: a ``LoopTiming`` as a dictionary, and the share of states answered ``in_time``."""


def bare_arm(rate_hz: float, duration_s: float, priority: int, results: Queue[Any]) -> None:
    """Publish joint states from a timer; put the share of those that were answered within the period."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    rclpy.init()
    node = rclpy.create_node("bare_arm")
    message = JointState(name=["shoulder", "elbow"], position=[0.0] * 2, velocity=[0.0] * 2, effort=[0.0] * 2)
    pub = node.create_publisher(JointState, "bare_state", 1)
    answered = published = in_time = 0
    first_s = 0.0

    def on_command(command: Float64MultiArray) -> None:
        nonlocal answered
        answered = int(command.layout.dim[0].label)

    def on_period() -> None:
        nonlocal published, in_time, first_s
        if not answered:  # until the two have found each other
            first_s = time.monotonic()
        stamp_ns = (1 + round((time.monotonic() - first_s) * rate_hz)) * round(NS_PER_S / rate_hz)
        stamp = message.header.stamp
        if answered:
            published += 1
            in_time += answered == stamp.sec * NS_PER_S + stamp.nanosec
        stamp.sec, stamp.nanosec = divmod(stamp_ns, NS_PER_S)
        pub.publish(message)

    node.create_subscription(Float64MultiArray, "bare_command", on_command, 1)
    node.create_timer(1.0 / rate_hz, on_period)
    _apply(priority)
    end_s = time.monotonic() + 60.0
    while time.monotonic() < (first_s + duration_s if answered else end_s):
        rclpy.spin_once(node, timeout_sec=0.1)
    results.put(in_time / max(published, 1))
    rclpy.try_shutdown()


def bare_controller(rate_hz: float, duration_s: float, priority: int, results: Queue[Any]) -> None:
    """Answer each joint state from a callback; put the figures of the loop."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    rclpy.init()
    node = rclpy.create_node("bare_controller")
    pub = node.create_publisher(Float64MultiArray, "bare_command", 1)
    answer = Float64MultiArray(data=[0.0, 0.0])
    answer.layout.dim = [MultiArrayDimension()]
    timer = LoopTimer(rate_hz, round(2 * duration_s * rate_hz))
    first_ns = 0

    def on_state(state: JointState) -> None:
        nonlocal first_ns
        arrived_ns = time.monotonic_ns()
        stamp_ns = state.header.stamp.sec * NS_PER_S + state.header.stamp.nanosec
        answer.layout.dim[0].label = str(stamp_ns)
        pub.publish(answer)
        first_ns = first_ns or arrived_ns
        if arrived_ns - first_ns > NS_PER_S:  # the stamps count from when both know each other
            timer.add(stamp_ns, arrived_ns, time.monotonic_ns())

    node.create_subscription(JointState, "bare_state", on_state, 1)
    _apply(priority)
    end_s = time.monotonic() + 60.0
    # A little less than the arm's, so that the end of the arm is no part of it.
    while time.monotonic() < (first_ns / NS_PER_S + duration_s - 0.2 if first_ns else end_s):
        rclpy.spin_once(node, timeout_sec=0.1)
    timing = timer.timing()
    if timing is None:
        sys.exit("the bare pair has not exchanged anything")
    results.put(asdict(timing))
    rclpy.try_shutdown()


def _apply(priority: int) -> None:
    from tel_ros.nodes.realtime import lock_memory, set_priority

    for outcome in (set_priority(priority), lock_memory(priority > 0)):
        if outcome is not None and not outcome.applied:
            print(f"bare pair: {outcome.text}", file=sys.stderr)


def bare_pair(rate_hz: float, duration_s: float, priority: int) -> Figures:
    parts = []
    for target in (bare_controller, bare_arm):
        results = SPAWN.Queue()
        arguments = (rate_hz, duration_s + 1.0, priority, results)
        process = SPAWN.Process(target=target, args=arguments, daemon=True)
        process.start()
        parts.append((process, results))
    (controller, timing), (arm, in_time) = parts
    try:
        return {**timing.get(timeout=90.0), "in_time": in_time.get(timeout=90.0)}
    finally:
        for process in (controller, arm):
            process.join(10.0)
            process.kill()


def cpu_time_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def practice_command(config: Path, folder: Path, overrides: Sequence[str]) -> list[str]:
    command = [sys.executable, "-m", "tel_ros.app.cli", "practice", str(config), "--out", str(folder)]
    return [*command, "--no-report", *(part for value in overrides for part in ("--set", value))]


def product(
    config: Path, rate_hz: float, duration_s: float, priority: int, folder: Path, more: Sequence[str] = ()
) -> Figures | None:
    """Return the figures of one trial of a practice run; None if the run failed before it had any."""
    overrides = [
        *("sim.clock=realtime", f"control.rate_hz={rate_hz}", f"control.realtime_priority={priority}"),
        *(f"control.lock_memory={str(priority > 0).lower()}", "control.path_tolerance_rad=2.0"),
        "control.state_timeout_s=1.0",  # a gap is to be measured, not to end the trial
        *("practice.trials=1", "practice.strategy=trajectory_extension"),
        *(f"practice.first_duration_s={duration_s}", f"practice.goal_duration_s={duration_s}", *more),
    ]
    done = subprocess.run(practice_command(config, folder, overrides), capture_output=True, text=True)
    summary = folder / "summary.json"
    if not summary.is_file():
        raise TelError(f"tel practice ended with code {done.returncode}: {done.stderr}")
    found = json.loads(summary.read_text())
    if not found["trials"] or found["trials"][0]["timing"] is None:
        print(f"no trial was measured: {found['outcome']}: {found['message']}", file=sys.stderr)
        return None
    trial = found["trials"][0]
    if trial["outcome"] != "completed":
        print(f"the trial was {trial['outcome']}: {trial['message']}", file=sys.stderr)
    for line in (folder / "log" / "ep_controller.log").read_text().splitlines():
        if "refused" in line:
            print(line, file=sys.stderr)
    return {**trial["timing"], "in_time": in_time(folder / trial["bag"], rate_hz)}


def in_time(bag: Path, rate_hz: float) -> float:
    """Return the share of the states of RUN whose answer acted in the very next period.

    The next state tells the effort that acted until its stamp: it is the answer's, or that of an earlier one.
    """
    trial = read_trial(bag)
    run_ns = set(trial.time_ns[trial.run].tolist())
    answers: dict[int, list[float]] = {}
    states: list[tuple[int, list[float]]] = []
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            if topics.is_named(connection.topic, topics.EFFORT_COMMANDS):
                answers[int(message.layout.dim[0].label)] = message.data.tolist()
            elif topics.is_named(connection.topic, topics.JOINT_STATES):
                stamp = message.header.stamp
                states.append((stamp.sec * NS_PER_S + stamp.nanosec, message.effort.tolist()))
    states.sort()
    asked = found = 0
    for (stamp_ns, _), (next_ns, effort) in zip(states, states[1:], strict=False):
        if run_ns and min(run_ns) <= stamp_ns <= max(run_ns):
            asked += 1
            follows = (next_ns - stamp_ns) * rate_hz < 1.5 * NS_PER_S
            found += follows and answers.get(stamp_ns) == effort
    return found / max(asked, 1)


Measured = tuple[str, Figures | None, Figures]
"""What a row is called, its figures, and those of the bare pair."""


def _both(name: str, digits: int, unit: float = 1.0) -> Callable[[Measured], str]:
    def text(row: Measured) -> str:
        _, ours, bare = row
        return f"{unit * ours[name]:.{digits}f} ({unit * bare[name]:.{digits}f})" if ours else "failed"

    return text


COLUMNS = [
    Column[Measured]("loop", lambda row: row[0], left=True),
    Column("rate Hz", _both("state_rate_hz", 1)),
    Column("jitter p50 ms", _both("jitter_p50_s", 3, 1e3)),
    Column("p99 ms", _both("jitter_p99_s", 3, 1e3)),
    Column("max ms", _both("jitter_max_s", 2, 1e3)),
    Column("answered in time %", _both("in_time", 2, 100.0)),
    Column("missed ticks", _both("missed_ticks", 0)),
    Column(
        "p99, times the bare pair's", lambda r: r[1] and r[1]["jitter_p99_s"] / r[2]["jitter_p99_s"], ".2f"
    ),
]


@study()
@click.option("--config", type=click.Path(path_type=Path), default=ROOT / "config" / "paper.yaml")
@click.option("--seconds", default=10.0, show_default=True, help="Of movement in each row.")
@click.option("--rate", "rates_hz", type=float, multiple=True, default=(500.0, 1000.0), show_default=True)
def realtime_loop(options: StudyOptions, config: Path, seconds: float, rates_hz: tuple[float, ...]) -> None:
    """How regular the loop is in real time, beside a bare pair of processes."""
    os.environ.update(ON_THIS_MACHINE)
    load_1min = os.getloadavg()[0]
    rows: list[Measured] = []
    with tempfile.TemporaryDirectory() as folder:
        for rate_hz, busy, priority in itertools.product(rates_hz, (False, True), (0, PRIORITY)):
            name = f"{rate_hz:.0f} Hz, {'busy' if busy else 'idle'}, {'options' if priority else 'plain'}"
            run = Path(folder) / f"run_{len(rows)}"
            with contextlib.ExitStack() as stack:
                if busy:
                    endless = [sys.executable, "-c", "while True: pass"]
                    stack.callback(stack.enter_context(subprocess.Popen(endless)).kill)
                ours = product(config, rate_hz, seconds, priority, run, options.overrides)
                rows.append((name, ours, bare_pair(rate_hz, seconds, priority)))
            print(*(column.text(rows[-1]) for column in COLUMNS), sep="  ", file=sys.stderr)
    print(Table(COLUMNS, rows).markdown())
    print(
        f"\nIn brackets: the bare pair. {os.cpu_count()} cores, load average {load_1min:.1f} before it "
        f"began, kernel {os.uname().release}. Busy: one process that computes without pause. Options: "
        f"SCHED_FIFO {PRIORITY}, locked memory."
    )
