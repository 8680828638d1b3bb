"""Stopping an arm at speed: by `tel stop`, by Ctrl-C however often, by a terminal that is closed."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from graph_harness import Graph
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from tel_interfaces.msg import ControlState, TrialResult
from tel_process import COARSE, HANG_S, PAPER, PATIENT, QUICK, ROOT, TelProcess, wait_until

from tel_ros.recording import topics
from tel_ros.recording.config_file import load_config
from tel_ros.recording.trial_bag import read_trial

REAL_TIME = ("sim.clock=realtime", "control.path_tolerance_rad=3.0", *PATIENT)
LONG = (*QUICK, *REAL_TIME, "practice.trials=2", "practice.durations_s=[30.0, 30.0]")
AT_REST = "interrupted: the arm is at rest, all nodes have ended"


def tel_command(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tel_ros.app.cli", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=HANG_S)


def test_tel_stop_brakes_the_arm_and_tel_reset_ends_the_stop_whatever_ros_time_does(
    tmp_path: Path, domain: int
) -> None:
    config = load_config(
        PAPER, (*COARSE, *REAL_TIME, "sim.publish_clock=true", "control.state_timeout_s=3.0")
    )
    running = Graph(config, tmp_path / "graph", ["sim_bridge", "ep_controller"], domain)
    running.processes._more += ["-p", "use_sim_time:=true"]
    with running:
        states = running.listen(ControlState, topics.CONTROL_STATES)
        commands = running.listen(Float64MultiArray, topics.EFFORT_COMMANDS)
        clock = running.listen(Clock, topics.CLOCK)
        running.wait_for_controller()

        def braking() -> list[ControlState]:
            return [s for s in states if s.trial and s.phase == ControlState.STOP]

        nothing = tel_command("stop", "--namespace", "elsewhere")
        assert nothing.returncode == 3 and "no controller was found in namespace /elsewhere" in nothing.stderr
        refused = tel_command("reset")
        assert refused.returncode == 1 and "not reset: no stop is latched" in refused.stdout
        trial = running.start_moving()
        stopped = tel_command("stop")
        assert stopped.returncode == 0, stopped.stderr
        assert f"ep_controller in /, domain {domain}" in stopped.stdout
        result = running.result(trial)
        assert result.outcome == TrialResult.ABORTED and "emergency stop" in result.message
        # The result may overtake the states.
        running.spin_until(lambda: bool(braking()), "the brake")
        assert np.abs(braking()[0].velocity_rad_s).max() > 0.1
        running.spin_until(lambda: tel_command("reset").returncode == 0, "the reset")

        # The arm stops, and the clock with it: a watchdog that went by that clock would never bark.
        running.start_moving()
        running.signal("sim_bridge", signal.SIGSTOP)
        try:
            barked = re.compile(r"no joint state for \S+ s \(time-out 3.0 s\): zero eff")
            running.spin_until(lambda: bool(barked.search(running.log("ep_controller"))), "the watchdog")
            running.spin_until(lambda: not np.any(commands[-1].data), "zero effort")
            told = clock[-1].clock
            running.spin_for(0.2)
            assert clock[-1].clock == told
        finally:
            running.signal("sim_bridge", signal.SIGCONT)


def test_ctrl_c_four_times_brakes_the_arm_at_once_and_says_what_was_seen(
    tel: Callable[..., TelProcess],
) -> None:
    run = tel(*LONG)
    run.wait_until_moving(trial=1)
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        run.process.send_signal(number)
        time.sleep(0.12)
    code, _, err = run.finish()
    assert (code, run.left_behind()) == (130, [])
    assert AT_REST in err
    trial = read_trial(run.folder / "trial_001")  # its bag is whole
    assert trial.report.message == "cancelled"
    assert np.abs(trial.velocity_rad_s[-1]).max() < 0.1


def test_a_terminal_that_is_closed_ends_the_run_in_good_order(tmp_path: Path) -> None:
    folder, (ours, theirs) = tmp_path / "run", pty.openpty()
    command = [sys.executable, "-m", "tel_ros.app.cli", "practice", str(PAPER), "--out", str(folder)]
    command += [part for override in LONG for part in ("--set", override)]

    def take_terminal() -> None:
        os.login_tty(theirs)

    run = subprocess.Popen(command, cwd=ROOT, preexec_fn=take_terminal)
    os.close(theirs)
    log = folder / "log" / "ep_controller.log"
    try:
        wait_until(lambda: log.exists() and "trial 1: " in log.read_text(), "the trial")
        os.close(ours)
        assert run.wait(HANG_S) == 130
    finally:
        run.kill()
    said = log.read_text()
    assert "trial 1: CANCELLED" in said and "ended: the arm is at rest" in said


def test_what_nobody_has_seen_at_rest_is_not_said_to_be(tel: Callable[..., TelProcess]) -> None:
    run = tel(*LONG)
    nodes = run.wait_until_moving(trial=1)
    nodes["sim_bridge"].suspend()
    run.process.send_signal(signal.SIGINT)
    code, _, err = run.finish()
    assert (code, run.left_behind()) == (130, [])
    assert "at rest" not in err.replace("was not seen at rest", "")
    assert "no joint states came at the end: whether the arm rests was not seen" in err
    assert "sim_bridge had to be killed" in err
