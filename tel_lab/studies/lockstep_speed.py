"""How fast the whole graph runs in lockstep, beside two bare processes that exchange the same messages.

The bare pair only answers each other through rclpy's executor: the ratio of the two says what the arm, the
controller and the recorder cost, whatever machine this is.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import click
import psutil

from tel_lab.studies.realtime_loop import ON_THIS_MACHINE, cpu_time_s, practice_command
from tel_lab.study import ROOT, StudyOptions, study
from tel_lab.tables import of_texts
from tel_ros.core.errors import TelError
from tel_ros.recording import topics

BARE_S = 5.0
ECHO = """
import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = rclpy.create_node("echo")
answer = Float64MultiArray(data=[0.0, 0.0])
pub = node.create_publisher(Float64MultiArray, "bare_command", 1)
node.create_subscription(JointState, "bare_state", lambda message: pub.publish(answer), 1)
try:
    rclpy.spin(node)
except BaseException:
    pass  # however it is ended: its work is done
"""


def bare_round_trips_per_s() -> float:
    """Return how often a second two bare processes exchange a joint state and a command."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    echo = subprocess.Popen([sys.executable, "-c", ECHO])
    rclpy.init()
    try:
        node = rclpy.create_node("bare")
        zero = [0.0, 0.0]
        state = JointState(name=["shoulder", "elbow"], position=zero, velocity=zero, effort=zero)
        pub = node.create_publisher(JointState, "bare_state", 1)
        count = 0

        def answered(message: Float64MultiArray) -> None:
            nonlocal count
            count += 1
            pub.publish(state)

        node.create_subscription(Float64MultiArray, "bare_command", answered, 1)
        while count == 0:  # until the two have found each other
            pub.publish(state)
            rclpy.spin_once(node, timeout_sec=0.2)
        first, start = count, time.monotonic()
        while time.monotonic() - start < BARE_S:
            rclpy.spin_once(node, timeout_sec=0.1)
        return (count - first) / (time.monotonic() - start)
    finally:
        rclpy.try_shutdown()
        echo.terminate()
        echo.wait(10.0)


def practised(
    config: Path, folder: Path, overrides: list[str]
) -> tuple[dict[str, Any], dict[str, float], float]:
    """Practise; return the summary, the CPU time of each node in s, and the time spent moving in s."""
    import rclpy
    from tel_interfaces.action import Practice

    command = practice_command(config, folder, overrides)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    cpu_s: dict[str, float] = {}
    stage_s: dict[str, float] = defaultdict(float)
    stage, since = "", time.monotonic()

    def hear(message: Any) -> None:
        nonlocal stage, since
        if message.feedback.stage != stage:
            now = time.monotonic()
            stage_s[stage] += now - since
            stage, since = message.feedback.stage, now

    rclpy.init()
    node = rclpy.create_node("stage_clock")
    node.create_subscription(Practice.Impl.FeedbackMessage, f"{topics.PRACTICE}/_action/feedback", hear, 100)
    while process.poll() is None:
        for child in psutil.Process(process.pid).children():
            try:
                name = child.cmdline()[2].split(".")
                cpu_s[name[0] if name[0] == "sim_bridge" else name[-1]] = cpu_time_s(child.pid)
            except (psutil.NoSuchProcess, IndexError):
                continue
        end = time.monotonic() + 0.2
        while (left_s := end - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=left_s)
    if process.returncode != 0:
        raise TelError(f"tel practice ended with code {process.returncode}")
    return json.loads((folder / "summary.json").read_text()), cpu_s, stage_s["moving"]


@study()
@click.option("--config", type=click.Path(path_type=Path), default=ROOT / "config" / "paper.yaml")
@click.option("--trials", default=4, show_default=True)
@click.option("--priority", default=0, show_default=True, help="control.realtime_priority of the graph.")
def lockstep_speed(options: StudyOptions, config: Path, trials: int, priority: int) -> None:
    """How fast the graph runs in lockstep, beside a bare pair of processes."""
    os.environ.update(ON_THIS_MACHINE)
    bare = bare_round_trips_per_s()
    with tempfile.TemporaryDirectory() as folder:
        overrides = [f"practice.trials={trials}", f"control.realtime_priority={priority}"]
        summary, cpu_s, moving_s = practised(config, Path(folder) / "run", [*overrides, *options.overrides])
    done, rate_hz = summary["trials"], summary["config"]["control"]["rate_hz"]
    ticks, wall_s = sum(t["ticks"] for t in done), sum(t["wall_s"] for t in done)
    rate = ticks / moving_s
    lines = [
        ("bare pair, round trips/s", f"{bare:.0f}"),
        ("graph, moving and recording, ticks/s", f"{rate:.0f}"),
        ("the same, times the bare pair's", f"{rate / bare:.2f}"),
        (f"arm time / wall clock at {rate_hz:.0f} Hz, {os.cpu_count()} cores", f"{rate / rate_hz:.2f}"),
        ("the same with learning", f"{ticks / rate_hz / wall_s:.2f}"),
        *(
            (f"CPU of {n}, µs a tick with start-up", f"{1e6 * s / ticks:.0f}")
            for n, s in sorted(cpu_s.items())
        ),
    ]
    print(of_texts(("", "measured"), lines).markdown())
