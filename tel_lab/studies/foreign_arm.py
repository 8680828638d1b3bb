"""What the drives of an arm that shares nothing with this project do after a fault, in real time.

A run is ``tel practice`` on :mod:`tel_lab.stand_in_arm`. Everything in the table but the words and the number
of trials is from the arm's own log: true positions, velocities and efforts, 2,000 a second.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from select import select
from typing import Any

import click
import numpy as np

from tel_lab import stand_in_arm
from tel_lab.studies.realtime_loop import ON_THIS_MACHINE, practice_command
from tel_lab.study import StudyOptions, study
from tel_lab.tables import Column, Table
from tel_ros.core.errors import TelError
from tel_ros.core.trial import Phase
from tel_ros.recording.trial_bag import read_trial

CASES = {
    "frozen": "readings freeze, stamps go on",
    "silent": "states stop",
    "same_stamp": "the stamp repeats",
    "degrees": "elbow in degrees",
    "flipped": "elbow's sign flipped",
    "swapped": "joints exchanged",
    "weak": "drives give 1 N·m",
    "ctrl_c": "Ctrl-C",
    "tel_stop": "`tel stop`",
}
IN_MOTION = ("frozen", "silent", "same_stamp", "ctrl_c", "tel_stop")
"""In the second of three trials; the others are there from the start."""
TIMEOUT_S, QUIET_S, AFTER_S = 90.0, 0.3, 5.0
CONFIG = """arm: {name: stand_in, urdf: arm.urdf, joints: [shoulder, elbow], hand_link: hand,
  stiffness_nm_per_rad: [15, 15], damping_nms_per_rad: [1.5, 1.5], effort_limit_nm: [20, 10]}
path: {file: path.csv}
practice: {strategy: trajectory_extension, durations_s: [4, 2.5, 2.5], goal_duration_s: 2.5,
  on_abort: continue}
control: {rate_hz: 500, path_tolerance_rad: 1.0}
run: {arm: external}
"""
PATH = "shoulder,elbow\n0.3,0.3\n1.3,-0.5\n0.8,1.2\n0.3,0.3\n"


@dataclass(frozen=True)
class Seen:
    """One run: times from the fault, or from the first effort where the fault was there before, in s."""

    first_effort_s: float
    stopped_s: float
    """Until zero effort that lasts, or until the first command of the brake reached the arm."""
    speed_rad_s: float
    way_rad: float
    at_stops_s: float
    further: int
    """Trials that began later."""
    words: str


def seen(case: str, guarded: bool, seed: int, folder: Path, overrides: tuple[str, ...]) -> Seen:
    for name, text in (("run.yaml", CONFIG), ("path.csv", PATH), ("arm.urdf", stand_in_arm.URDF)):
        (folder / name).write_text(text, encoding="utf-8")
    run, log = folder / "run", folder / "truth.npz"
    fault = case if case in stand_in_arm.FAULTS else "none"
    command = [sys.executable, stand_in_arm.__file__, fault, str(seed), str(log)]
    guard = f"safety.guard={'external' if guarded else 'never'}"
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as arm:
        said_by_arm: Any = arm.stdout
        said_by_arm.readline()
        begun_s = time.monotonic()
        practice = subprocess.Popen(
            practice_command(folder / "run.yaml", run, (guard, *overrides)),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            stopped_s = math.nan
            if case in IN_MOTION and came(practice, (run / "trial_001").exists):
                arm.send_signal(signal.SIGUSR1)
                came(practice, lambda: select([said_by_arm], [], [], 0.0)[0])
                stopped_s = time.monotonic()
                if case == "ctrl_c":
                    practice.send_signal(signal.SIGINT)
                elif case == "tel_stop":
                    subprocess.run([sys.executable, "-m", "tel_ros.app.cli", "stop"], check=False)
            said = practice.communicate(timeout=TIMEOUT_S)[1]
        finally:
            practice.kill()
            arm.terminate()
    with np.load(log) as truth:
        rows, commands, fault_s = (truth[name] for name in ("rows", "commands", "fault_s"))
    summary = run / "summary.json"
    trials = json.loads(summary.read_text())["trials"] if summary.exists() else []
    words = said.strip().splitlines()[-1] if said.strip() else ""
    told = [trial["message"] for trial in trials if trial["message"] and trial["message"] not in words]
    if case == "weak":
        told += [f"{trial['saturated_ratio']:.0%} of its samples count as clipped" for trial in trials]
    words = "; ".join([*told, words])
    from_s = stopped_s if case in ("ctrl_c", "tel_stop") else float(fault_s)
    return judged(case, begun_s, from_s, rows, commands, run, len(trials), words)


def came(practice: subprocess.Popen[str], condition: Callable[[], object]) -> bool:
    """Wait for a condition as long as practice goes on; return whether it came."""
    end = time.monotonic() + TIMEOUT_S
    while not condition() and practice.poll() is None and time.monotonic() < end:
        time.sleep(0.001)
    return bool(condition())


def judged(
    case: str, begun_s: float, fault_s: float, rows: Any, commands: Any, run: Path, trials: int, words: str
) -> Seen:
    """Return what the log says. Rows: time, positions, velocities, efforts; commands: time, stamp answered.

    Where a fault was there from the start, it counts from the first effort.
    """
    acts = np.any(rows[:, 5:7] != 0.0, axis=1)
    first_s = float(rows[np.argmax(acts), 0]) if acts.any() else math.nan
    from_s = fault_s if case in IN_MOTION else first_s
    after = rows[:, 0] >= from_s if from_s == from_s else np.zeros(len(rows), dtype=bool)
    if not after.any():
        return Seen(first_s - begun_s, math.nan, 0.0, 0.0, 0.0, 0, words)
    time_s, position, velocity, acting = rows[after, 0], rows[after, 1:3], rows[after, 3:5], acts[after]
    last_s = time_s[np.flatnonzero(acting)] if acting.any() else time_s[:1]
    pauses = np.flatnonzero(np.diff([*last_s, math.inf]) > QUIET_S)
    stopped_s = float(last_s[pauses[0]]) - from_s
    if case in ("ctrl_c", "tel_stop"):
        trial = read_trial(run / "trial_002")
        braked_ns = trial.time_ns[trial.phase == Phase.STOP][:1]
        answered = commands[np.isin(commands[:, 1], braked_ns), 0]
        stopped_s = float(answered[0]) - from_s if len(answered) else math.nan
    near = time_s < from_s + AFTER_S
    beyond = np.any(np.abs(position) > stand_in_arm.STOP_RAD, axis=1)
    return Seen(
        first_s - begun_s,
        stopped_s,
        float(np.abs(velocity[near]).max()),
        float(np.abs(position[near] - position[0]).max()),
        float(beyond.sum()) / (stand_in_arm.RATE_HZ * stand_in_arm.STEPS),
        max(0, trials - (2 if case in IN_MOTION else 1)),
        words,
    )


Row = tuple[str, bool, list[Seen]]


def _figure(name: str, form: str) -> Any:
    def text(row: Row) -> str:
        values = np.array([getattr(run, name) for run in row[2]], dtype=float)
        values = values[np.isfinite(values)]
        return f"{np.median(values):{form}} ({values.max():{form}})" if len(values) else "–"

    return text


COLUMNS: list[Column[Row]] = [
    Column("fault", lambda row: CASES[row[0]], left=True),
    Column("arm_guard", lambda row: "on" if row[1] else "off", left=True),
    Column("runs", lambda row: len(row[2])),
    Column("stopped after s", _figure("stopped_s", ".3f")),
    Column("fastest rad/s", _figure("speed_rad_s", ".2f")),
    Column("way rad", _figure("way_rad", ".2f")),
    Column("at the stops s", _figure("at_stops_s", ".2f")),
    Column("further trials", lambda row: sum(each.further for each in row[2])),
    Column("first effort s", _figure("first_effort_s", ".1f")),
]


def _reasons(row: Row) -> str:
    """Return what was said, once for all runs that differ by numbers only."""
    words = [re.sub(r" \(what was recorded.*", "", run.words) for run in row[2]]
    said = {re.sub(r"\d+(\.\d+)?", "#", text): text for text in words}
    counts = Counter(re.sub(r"\d+(\.\d+)?", "#", text) for text in words)
    lines = [f"  - {counts[key]} of {len(words)}: {text}" for key, text in said.items()]
    return "\n".join([f"- {CASES[row[0]]}, arm_guard {'on' if row[1] else 'off'}", *lines])


@study()
@click.option("--runs", default=10, show_default=True, help="Of each fault, with and without arm_guard.")
@click.option("--first-domain", default=201, show_default=True, help="Of four ROS domains to use.")
def foreign_arm(options: StudyOptions, runs: int, first_domain: int) -> None:
    """Faults of an arm that is not ours, seen at its drives; 20 s a run, 60 min for 10 of each."""
    os.environ.update(ON_THIS_MACHINE)
    rows: list[Row] = []
    load, number = os.getloadavg()[0], itertools.count()
    for case, guarded in itertools.product(options.selected(list(CASES)), (True, False)):
        rows.append((case, guarded, []))
        for seed in range(1, (1 if options.quick else runs) + 1):
            os.environ["ROS_DOMAIN_ID"] = str(first_domain + next(number) % 4)
            with tempfile.TemporaryDirectory() as folder:
                rows[-1][2].append(seen(case, guarded, seed, Path(folder), options.overrides))
            print(case, guarded, seed, rows[-1][2][-1], file=sys.stderr, flush=True)
    table, reasons = Table(COLUMNS, rows).markdown(), "\n".join(map(_reasons, rows))
    print(table, reasons, sep="\n\n")
    options.write("foreign_arm.md", table=table, reasons=reasons, load=load, cores=os.cpu_count())
    if any(run.further or run.at_stops_s for case, _, runs in rows for run in runs if case != "weak"):
        raise TelError("a trial followed a fault, or the arm was at its stops")
