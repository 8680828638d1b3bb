"""How fast the whole graph runs in lockstep, beside two bare processes that exchange the same messages.

    .venv/bin/python benchmarks/lockstep.py [--priority 10]

The bare pair does nothing but answer each other through rclpy's executor: the ratio of the two says what the
arm, the controller and the recorder cost, whatever machine this is.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).parents[1]
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


class StageClock:
    """Hears on the graph in which stage a run is, and adds up the time spent in each."""

    def __init__(self) -> None:
        import rclpy
        from tel_interfaces.action import Practice

        rclpy.init()
        self.seconds: dict[str, float] = {}
        self._stage, self._since = "", time.monotonic()
        self._node = rclpy.create_node("stage_clock")
        self._node.create_subscription(
            Practice.Impl.FeedbackMessage, "/practice/_action/feedback", self._hear, 100
        )

    def _hear(self, message: Any) -> None:
        if message.feedback.stage != self._stage:
            now = time.monotonic()
            self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._since
            self._stage, self._since = message.feedback.stage, now

    def listen(self, duration_s: float) -> None:
        """Let messages arrive for a while."""
        import rclpy

        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            rclpy.spin_once(self._node, timeout_sec=max(0.0, end - time.monotonic()))


def practice(config: Path, folder: Path, overrides: list[str]) -> tuple[dict, dict[str, float], float]:
    """Run practice; return its summary, the CPU time [s] of each node, and the time [s] spent moving."""
    command = [sys.executable, "-m", "tel_ros.app.cli", "practice", str(config), "--out", str(folder)]
    command += ["--no-report", *(part for override in overrides for part in ("--set", override))]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    cpu_s: dict[str, float] = {}
    clock = StageClock()
    while process.poll() is None:
        for child in psutil.Process(process.pid).children():
            try:
                times, name = child.cpu_times(), child.cmdline()[2].split(".")
                cpu_s[name[0] if name[0] == "sim_bridge" else name[-1]] = times.user + times.system
            except (psutil.NoSuchProcess, IndexError):
                continue
        clock.listen(0.2)
    if process.returncode != 0:
        sys.exit(f"tel practice ended with code {process.returncode}")
    return json.loads((folder / "summary.json").read_text()), cpu_s, clock.seconds["moving"]


def main() -> None:
    """Run both and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=ROOT / "config" / "paper.yaml")
    parser.add_argument("--trials", type=int, default=4)
    parser.add_argument("--priority", type=int, default=0, help="control.realtime_priority of the graph")
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    bare = bare_round_trips_per_s()
    with tempfile.TemporaryDirectory() as folder:
        overrides = [
            f"practice.trials={options.trials}",
            f"control.realtime_priority={options.priority}",
        ]
        summary, cpu_s, moving_s = practice(options.config, Path(folder) / "run", overrides)
    trials, rate_hz = summary["trials"], summary["config"]["control"]["rate_hz"]
    ticks, wall_s = sum(t["ticks"] for t in trials), sum(t["wall_s"] for t in trials)
    rate = ticks / moving_s
    print(f"bare pair                   {bare:8.0f} round trips/s")
    print(f"graph, moving and recording {rate:8.0f} ticks/s, {rate / bare:.2f} of the bare pair")
    print(f"arm time / wall clock       {rate / rate_hz:8.2f} at {rate_hz:.0f} Hz, {os.cpu_count()} cores")
    print(f"the same with learning      {ticks / rate_hz / wall_s:8.2f}")
    for name, seconds in sorted(cpu_s.items()):
        print(f"CPU {name:<23} {1e6 * seconds / ticks:8.0f} µs a tick, start-up included")


if __name__ == "__main__":
    main()
