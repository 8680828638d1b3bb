"""Injecting faults into a running graph one after the other, and judging each."""

from __future__ import annotations

import math
import re
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import psutil
from fault_body import Body
from fault_graph import END_TIMEOUT_S, START_TIMEOUT_S, FaultGraph
from fault_judge import Episode, Expectation, Trace, caught_up_ns, crashes, judge
from fault_kind import Kind
from fault_kinds import ANY_REASON, FROZEN_RAD, KINDS, SILENCE_S
from fault_plan import Fault
from fault_tap import Heard
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from tel_ros.app.bring_up import node_names
from tel_ros.core.errors import BagError, TelError
from tel_ros.core.trial import Outcome
from tel_ros.core.types import NS_PER_S
from tel_ros.recording.run_folder import read_summary, trial_bag
from tel_ros.recording.trial_bag import RecordedTrial, read_trial

TRIES = 3
"""A fault is injected again if something else disturbed it; the last time counts."""
STALL_S = 0.05
"""The arm said nothing for so long, although the fault does not concern its process: the machine stalled."""
UNEXPLAINED_S = 0.9 * SILENCE_S
"""No fault that a trial is to ride out keeps the controller silent for so long; at SILENCE_S it gives up."""
AFTERWARDS_S = 0.4
ZERO_NM = 1e-9
FOREIGN_EFFORTS = "command_duplicate"
"""The kind in which somebody else moves the arm: no reaction of this graph, so it counts from its end."""


@dataclass
class Row:
    """The result of one fault, as it is stored."""

    fault: Fault
    violations: list[str] = field(default_factory=list)
    skipped: str = ""
    outcome: str = ""
    message: str = ""
    exit_code: int | None = None
    trial: int = 0
    reaction_s: float | None = None
    stopped: str = "-"
    effort_share: float = 0.0
    speed_share: float = 0.0
    excursion_rad: float | None = None
    earlier: list[str] = field(default_factory=list)
    """Violations in tries before, which the machine or the end of the run before the fault had disturbed."""
    stall_s: float = 0.0
    bags: int = 0
    wall_s: float = 0.0


class Injection:
    """Injects faults into one running graph."""

    def __init__(self, graph: FaultGraph) -> None:
        self._graph, self._tap = graph, graph.tap
        self._body = Body.of(graph.config)
        self._next_trial = 2  # no other follows an aborted one before one has been completed
        self._verified: set[int] = set()
        self._trial = 0
        self._fault_wall_s = math.inf
        self._fault_ns = 0

    def inject(self, fault: Fault) -> Row:
        """Inject a fault at its moment of the next trial, wait for what comes of it, and judge that."""
        started = time.monotonic()
        kind, row = KINDS[fault.kind], Row(fault)
        self._trial = 0
        ended, wait = self._graph.ended, self._graph.wait
        if kind.window_s is None:
            wait(lambda: self._tap.arm_ns > 0, START_TIMEOUT_S)  # stamps count from it
            self._act(fault, 1)
        else:
            everybody = {*node_names(self._graph.config), "sim_bridge", "tel"}
            wait(lambda: ended() or everybody <= set(self._graph.nodes()), START_TIMEOUT_S)
            begun = self._tap.when(self._next_trial, fault.offset_s, lambda trial: self._act(fault, trial))
            wait(lambda: begun.is_set() or ended(), START_TIMEOUT_S)
        if not self._trial:
            row.message = self._graph.last_words()
            row.violations = [f"no trial came to inject it into: {row.message or 'nothing was said'}"]
            row.wall_s = time.monotonic() - started
            self._give_up()
            return row
        self._await_end(fault, kind, row)
        self._judge(fault, kind, row)
        row.wall_s = round(time.monotonic() - started, 2)
        self._next_trial = max(self._tap.begun, default=0)
        return row

    def _act(self, fault: Fault, trial: int) -> None:
        """Do it. Called in the thread of the observer, between two messages."""
        self._trial, self._fault_ns, self._fault_wall_s = trial, self._tap.arm_ns, time.monotonic()
        try:
            KINDS[fault.kind].inject(self._graph, fault.parameters)
        except (KeyError, psutil.NoSuchProcess):
            self._trial = 0  # the process that it concerns is not there: no trial of this fault

    def _await_end(self, fault: Fault, kind: Kind, row: Row) -> None:
        """Wait until a trial has begun after the fault was over, or the run has ended."""
        over_wall_s = self._fault_wall_s + _lasts_s(fault)  # for good: no other trial counts

        def next_trial() -> bool:
            later = [h for k, h in self._tap.begun.items() if k > self._trial and h.wall_s > over_wall_s]
            return bool(later) and not kind.ends_run

        if not self._graph.wait(lambda: self._graph.ended() or next_trial(), END_TIMEOUT_S):
            row.violations.append(f"neither the run's end nor another trial came in {END_TIMEOUT_S:.0f} s")
            self._give_up()
        if self._graph.ended():
            row.violations += [f"{name} outlives the run" for name in self._graph.left_behind()]
            row.exit_code, row.message = self._graph.tel.returncode, self._graph.last_words()
            time.sleep(AFTERWARDS_S)  # for what the arm does afterwards

    def _give_up(self) -> None:
        """End a run that does not end by itself."""
        if not self._graph.ended():
            self._graph.send("tel", signal.SIGINT)
            self._graph.wait(self._graph.ended, END_TIMEOUT_S)

    def _judge(self, fault: Fault, kind: Kind, row: Row) -> None:
        expects = kind.expectation(fault.parameters)
        trial = self._bag(row)
        row.trial = self._trial
        completed = trial is not None and trial.report.outcome == Outcome.COMPLETED
        row.outcome = trial.report.outcome.text if trial else "no bag"
        said = " ".join(filter(None, [trial.report.message if trial else "", row.message]))
        if kind.name == "kill_tel":
            # Of a trial that had come to its end before, the controller has nothing to say.
            said = f"{self._graph.log('ep_controller')} {row.outcome}"
        row.message = row.message or (trial.report.message if trial else "")
        self._check_message(kind, row, said, completed)
        trace = self._tap.trace(self._fault_wall_s - 1.0)
        row.stall_s = round(self._stall_s(fault, expects), 3)
        fault_ns = self._noticed_ns(fault, trace)
        episode = Episode(
            expects=expects,
            trial=self._trial,
            fault_ns=fault_ns,
            end_ns=int(trace.time_ns[-1]) if len(trace.time_ns) else fault_ns,
            completed=completed,
            work_tolerance_j=self._graph.setup.work_tolerance_j,
            falls=self._graph.setup.falls,
            calm_ns=self._calm_ns(fault, fault_ns),
            body=self._body,
        )
        verdict = judge(trace, episode)
        row.violations += verdict.violations
        row.reaction_s, row.stopped = _number(verdict.reaction_s, 4), verdict.stopped
        row.effort_share, row.speed_share = round(verdict.effort_share, 4), round(verdict.speed_share, 4)
        row.excursion_rad = _number(verdict.excursion_rad, 3)
        if self._graph.ended():
            self._check_end(kind, row, trace)
            logs = {name: self._graph.log(name) for name in self._graph.nodes()}
            row.violations += crashes(logs, row.message, kind.name.removeprefix("kill_"))

    def _noticed_ns(self, fault: Fault, trace: Trace) -> int:
        """Return the arm time from which the fault could be noticed."""
        if fault.kind.endswith("_duplicate"):
            since_ns = self._tap.foreign_since_ns or self._fault_ns
            return since_ns + (round(_lasts_s(fault) * NS_PER_S) if fault.kind == FOREIGN_EFFORTS else 0)
        if fault.kind == "state_frozen":
            since = trace.time_ns >= self._fault_ns
            time_s = (trace.time_ns[since] - self._fault_ns) / NS_PER_S
            told_rad_s = (
                trace.velocity_rad_s[since][:1] if "position" not in fault.parameters["fields"] else 0.0
            )
            off_rad = trace.position_rad[since] - trace.position_rad[since][:1] - time_s[:, None] * told_rad_s
            far = (np.abs(off_rad) > FROZEN_RAD).any(axis=1)
            return int(trace.time_ns[since][np.argmax(far)]) if far.any() else self._fault_ns
        if fault.kind == "state_wiring" and self._tap.begun:
            return self._tap.begun[1].arm_ns
        if not self._graph.setup.in_between and fault.kind in ("kill_ep_controller", "hang_ep_controller"):
            # The observer lags behind an arm in lockstep, whose time stands still once nobody commands it.
            heard = [c.arm_ns for c in trace.controls]
            return max([self._fault_ns, *heard[-1:]])
        return self._fault_ns

    def _calm_ns(self, fault: Fault, fault_ns: int) -> int:
        """Return the arm time from which nothing is disturbed any more.

        A simulation that stood still has to catch up; its states are late until it has.
        """
        if fault.kind == FOREIGN_EFFORTS:
            return fault_ns
        over_ns = fault_ns + round(min(_lasts_s(fault), END_TIMEOUT_S) * NS_PER_S)
        if fault.kind != "pause_sim_bridge":
            return over_ns
        states = [h for h in self._tap.states if h.wall_s >= self._fault_wall_s - 1.0]
        return caught_up_ns(
            np.array([h.arm_ns for h in states]),
            np.array([h.wall_s for h in states]),
            n_before=sum(h.wall_s < self._fault_wall_s for h in states),
            since_ns=over_ns,
        )

    def _stall_s(self, fault: Fault, expects: Expectation) -> float:
        """Return the longest silence of the arm around a fault that does not touch the arm's process.

        Where the trial is to ride a fault out, the controller's counts as well, if it is longer than any that
        the fault explains: its process stood still, then.
        """
        if fault.kind in ("pause_sim_bridge", "kill_sim_bridge") or not self._graph.setup.in_between:
            return 0.0
        stall_s = self._longest_gap_s(self._tap.states)
        controller_s = self._longest_gap_s(self._tap.commands) if expects == "ride" else 0.0
        return max(stall_s, controller_s if controller_s > UNEXPLAINED_S else 0.0)

    def _longest_gap_s(self, messages: Sequence[Heard]) -> float:
        heard = [h.wall_s for h in messages if h.wall_s >= self._fault_wall_s - 1.0]
        return float(np.diff(heard).max()) if len(heard) > 1 else 0.0

    def _check_message(self, kind: Kind, row: Row, said: str, completed: bool) -> None:
        if kind.ends_run and row.exit_code is not None and row.exit_code not in kind.codes:
            row.violations.append(f"exit code {row.exit_code}; expected {kind.codes}")
        if (kind.ends_run or not completed) and not re.search(kind.says, said):
            row.violations.append("the message does not say what happened")
        elif (
            not kind.ends_run
            and row.exit_code is not None
            and not re.search(f"{kind.says}|{ANY_REASON}", said)
        ):
            row.violations.append("the run ended and did not say why")

    def _check_end(self, kind: Kind, row: Row, trace: Trace) -> None:
        """After the run nothing acts, and the last that was commanded is zero."""
        if kind.name == "kill_sim_bridge":
            commands = self._tap.commands
            if commands and np.any(np.array(deserialize_message(commands[-1].raw, Float64MultiArray).data)):
                row.violations.append("the last command that anybody sent was not zero")
        elif not self._graph.setup.in_between:
            return  # time stands still in lockstep once nobody commands: the last effort does not act
        elif len(trace.effort_nm) and np.abs(trace.effort_nm[-1]).max() > ZERO_NM:
            row.violations.append("the motors still acted after the run")

    def _bag(self, row: Row) -> RecordedTrial | None:
        """Read every bag that has appeared; return that of the fault's trial."""
        found = None
        folder = self._graph.run
        try:
            expected = {t["index"] for t in read_summary(folder)["trials"]}
        except TelError:
            expected = set()
        for index in sorted(set(self._tap.begun) | expected | {self._trial}):
            bag = trial_bag(folder, index)
            if (index in self._verified and index != self._trial) or not bag.exists():
                continue
            try:
                trial = read_trial(bag)
            except BagError as error:
                row.violations.append(str(error))
                continue
            self._verified.add(index)
            row.bags += 1
            found = trial if index == self._trial else found
        row.violations += [
            f"the summary has trial {index}, whose bag is not there"
            for index in sorted(expected - self._verified)
        ]
        return found


def _lasts_s(fault: Fault) -> float:
    """Return for how long a fault disturbs; what is for good has its whole effect at once."""
    return float(fault.parameters.get("pause_s", fault.parameters.get("duration_s", 0.0)))


def _number(value: float, digits: int) -> float | None:
    return None if math.isnan(value) else round(value, digits)
