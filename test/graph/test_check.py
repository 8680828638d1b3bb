"""``tel check`` against arms behind real topics: a fake one with faults, the simulated one, and none."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tel_process import HANG_S, ROOT, tel_here, wait_until

from tel_ros.recording import topics

CONFIG = ROOT / "config" / "planar_arm.yaml"
FAKE_ARM = ROOT / "test" / "contract" / "fake_arm.py"
RATE_HZ = 200
EXTERNAL = (
    *("--set", "run.arm=external", "--set", "run.arm_timeout_s=30"),
    *("--set", f"control.rate_hz={RATE_HZ}", "--set", "control.state_timeout_s=2", "--listen", "0.5"),
)
TIMING = {"rate of states", "rate of stamps", "jitter of arrival", "age of states", "round-trip delay"}
"""A busy machine may spoil these for an arm that has nothing wrong with it."""
PATIENT_CHECK = """
import tel_ros.app.check.run as app, tel_ros.core.check.pulses as bounds
from tel_ros.app.cli import main
app.STATE_GAP_S = bounds.MOST_STATE_GAP_S = 2.0
main()
"""
StartArm = Callable[[str], None]


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may stand still for longer than an arm may be left alone; these arms are not real."""
    monkeypatch.setattr("tel_ros.app.check.run.STATE_GAP_S", 2.0)
    monkeypatch.setattr("tel_ros.core.check.pulses.MOST_STATE_GAP_S", 2.0)


@pytest.fixture
def fake_arm() -> Iterator[StartArm]:
    """Return a function that starts the fake arm with a fault."""
    started: list[subprocess.Popen] = []

    def start(fault: str) -> None:
        started.append(subprocess.Popen([sys.executable, str(FAKE_ARM), str(RATE_HZ), fault]))

    yield start
    for process in started:
        process.send_signal(signal.SIGINT)
        process.wait(HANG_S)


@pytest.fixture
def graph_node() -> Iterator[Node]:
    """A node in a context of its own, beside that of the check, with an executor."""
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = Node("beside_the_check", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield node
    node.destroy_node()
    context.try_shutdown()


def run(*arguments: str, answer: str = "") -> tuple[int, str, str]:
    return tel_here("check", str(CONFIG), *arguments, answer=answer)


def checked(*arguments: str) -> tuple[int, dict[tuple[str, str], dict[str, str]]]:
    """Check once more if the machine has stood still meanwhile: then the pulses end early, as they should."""
    for _ in range(5):
        code, out, err = run(*arguments, "--yes", "--json")
        assert out, err
        findings = {(f["check"], f["joint"]): f for f in json.loads(out)["findings"]}
        if not stood_still(findings):
            break
    return code, findings


def stood_still(findings: dict[tuple[str, str], dict[str, str]]) -> bool:
    """Return whether states were few or old: no pulses, their early end, or little of a joint's answer."""
    pulses = findings.get(("pulses", ""))
    if pulses is not None:
        said = pulses["measured"]
        blocking = set(said.partition("mended first: ")[2].split(", "))
        return "no joint state for" in said or blocking <= {"states", "age of states"}
    obeying = [
        joint for (name, joint), f in findings.items() if (name, f["verdict"]) == ("sign of effort", "ok")
    ]
    return any(findings["velocity", joint]["verdict"] == "not checked" for joint in obeying)


def spin_until(executor: SingleThreadedExecutor, condition: Callable[[], bool]) -> None:
    end = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.05)


def wrong(findings: dict[tuple[str, str], dict[str, str]]) -> set[tuple[str, str]]:
    return {key for key, finding in findings.items() if finding["verdict"] == "wrong"}


@pytest.mark.realtime
def test_a_fault_is_found_over_real_topics_and_what_is_right_is_not_blamed(fake_arm: StartArm) -> None:
    # One session takes seconds. All faults are found in test/core/check, with the same faulty arm and no ROS.
    fake_arm("flipped_effort")
    code, findings = checked(*EXTERNAL)
    assert code == 1
    assert wrong(findings) - {(name, "") for name in TIMING} == {("sign of effort", "elbow")}
    assert findings["sign of effort", "elbow"]["mend"]
    for joint in ("shoulder", "elbow"):
        for name in ("name", "effort channel", "wiring", "effort field", "velocity"):
            assert findings[name, joint]["verdict"] == "ok", findings[name, joint]
    assert findings["effort scale", "shoulder"]["verdict"] == "ok"
    assert findings["watchdog of the driver", ""]["verdict"] == "warning"  # 80 ms


@pytest.mark.realtime
def test_states_that_repeat_once_pulses_begin_end_the_check_by_name(fake_arm: StartArm) -> None:
    fake_arm("repeats_when_pushed")
    code, findings = checked(*EXTERNAL)
    assert code == 1
    assert "no new joint state for 2 s: their stamp repeats" in findings["pulses", ""]["measured"]
    assert {name for name, _ in wrong(findings)} <= {"pulses", *TIMING}


def test_an_arm_that_somebody_else_commands_or_that_has_other_names_is_not_pulsed(fake_arm: StartArm) -> None:
    fake_arm("wrong_name_second_commander")
    code, out, err = run(*EXTERNAL)
    assert code == 1, err
    assert "mended first" in out
    assert "wrong: name elbow: arm.joints needs the names" in out
    assert "wrong: other commands: end whoever else commands the arm" in out
    assert out.strip().splitlines()[-1].startswith("verdict  ")
    wait_until(lambda: run("--passive", "--listen", "0.5")[0] == 2, "a refusal beside another arm")


def test_a_passive_check_and_one_that_nobody_agrees_to_command_nothing(
    fake_arm: StartArm, graph_node: Node
) -> None:
    heard: list[Float64MultiArray] = []
    graph_node.create_subscription(Float64MultiArray, topics.EFFORT_COMMANDS, heard.append, 1000)
    fake_arm("nobody_listens")
    _, out, _ = run(*EXTERNAL, "--passive", "--json")
    assert "because --passive was given" in out

    def is_refused() -> bool:  # discovery of the listener may take longer than the check listens
        _, out, err = run(*EXTERNAL, answer="n\n")
        return "nobody has agreed" in out and "May each joint move by 0.05 rad?" in err

    wait_until(is_refused, "the question, and nobody who has agreed")
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        graph_node.executor.spin_once(timeout_sec=0.05)
    assert heard == []


@pytest.mark.realtime
def test_ctrl_c_in_mid_pulse_leaves_zero_effort(fake_arm: StartArm, graph_node: Node) -> None:
    states: list[JointState] = []
    command = [sys.executable, "-c", PATIENT_CHECK, "check", str(CONFIG), *EXTERNAL, "--yes"]
    fake_arm("no_watchdog")  # so that nothing but the check's own last command can switch the effort off
    try:
        for _ in range(5):  # on a machine that stands still the check may be over before the signal comes
            # Heard anew each time, and only the newest: an old pulse is no sign that this check has begun.
            states.clear()
            subscription = graph_node.create_subscription(JointState, topics.JOINT_STATES, states.append, 1)
            process = subprocess.Popen(
                command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
            )

            def pulses_or_ends(process: subprocess.Popen[str] = process) -> bool:
                return process.poll() is not None or (bool(states) and any(states[-1].effort))

            spin_until(graph_node.executor, pulses_or_ends)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=HANG_S)
            if process.returncode not in (0, 1):
                break
            graph_node.destroy_subscription(subscription)
        assert process.returncode == 130, err
        assert "zero effort was commanded" in err
        seen = len(states)
        spin_until(graph_node.executor, lambda: len(states) > seen + 50)
        assert not any(states[-1].effort)
    finally:
        if process.poll() is None:
            process.kill()


@pytest.mark.realtime
def test_the_simulated_arm_is_started_checked_and_ended() -> None:
    code, findings = checked(
        "--listen", "0.5", "--set", f"control.rate_hz={RATE_HZ}", "--set", "control.state_timeout_s=2"
    )
    assert {name for name, _ in wrong(findings)} <= TIMING
    assert code in (0, 1)
    assert findings["wiring", "shoulder"]["verdict"] == findings["wiring", "elbow"]["verdict"] == "ok"


def test_without_an_arm_the_exit_code_is_3() -> None:
    code, out, err = run("--set", "run.arm=external", "--set", "run.arm_timeout_s=0.5", "--yes")
    assert (code, out) == (3, "")
    assert "no joint states on /joint_states within 0.5 s" in err
    assert "There is" not in err


def test_joint_states_in_another_namespace_are_named(graph_node: Node) -> None:
    graph_node.create_publisher(JointState, "/robot1/joint_states", 1)
    said = "There is /robot1/joint_states: is the namespace right?"
    arguments = ("--set", "run.arm=external", "--set", "run.arm_timeout_s=2", "--passive")
    wait_until(lambda: said in run(*arguments)[2], "the topic that exists")


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--effort-share", "0.2"), ["--effort-share is 0.2", "up to 0.1"]),
        (("--range", "1.0"), ["--range is 1.0", "up to 0.2 rad"]),
        (("--listen", "0.1"), ["--listen is 0.1", "0.5 to 600 s"]),
        (("--set", "control.coridor_rad=1"), ["control.coridor_rad"]),
    ],
)
def test_wrong_input_is_named_and_nothing_starts(arguments: tuple[str, ...], parts: list[str]) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    for part in parts:
        assert part in err


def test_drives_that_take_positions_are_listened_to_and_never_pulsed() -> None:
    code, findings = checked("--set", "arm.command_interface=position", "--listen", "0.5")
    assert {name for name, _ in wrong(findings)} <= TIMING
    assert code == (1 if wrong(findings) else 0)
    assert findings["listener to commands", ""]["verdict"] == "ok"
    assert findings["pulses", ""]["verdict"] == "not checked"
    assert "the drives take positions" in findings["pulses", ""]["measured"]
