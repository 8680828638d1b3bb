"""SIGKILL for the recorder at random moments of a trial: what is whole, what can be recovered, what is lost.

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

import json
import os
import sys
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from tel_lab.recorder_stream import Client, Sent, Stream, beside, in_bag, is_same, record
from tel_lab.studies.realtime_loop import ON_THIS_MACHINE
from tel_lab.study import StudyOptions, study
from tel_lab.tables import NONE, of_texts
from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError, TelError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.recover import recover
from tel_ros.recording.trial_bag import read_trial

FIRST, SECOND = "trial_001", "trial_002"
N_JOINTS, N_POINTS = 7, 1000
FIRST_S, SECOND_S, AFTERWARDS_S = 0.1, 2.0, 0.1
N_DOMAINS = 40


@dataclass(frozen=True)
class Kill:
    """What one kill left behind, so long after the call of *start* for the second trial.

    ``found``: whole, recovered, not begun (no recording yet), or nothing (no whole chunk). ``sent``: messages
    before the kill; ``saved``: of these in the bag; ``lost_s``: from its newest joint state to the newest
    that was sent; ``violations``: what must not be.
    """

    storage: str
    moment_s: float
    found: str
    sent: int
    saved: int
    lost_s: float
    violations: tuple[str, ...]


def kill_once(
    folder: Path, recording: RecordingConfig, moment_s: float, domain: int, rate_hz: float, seed: int
) -> Kill:
    """Record a trial, begin another one, kill the recorder, and look what is there.

    In a ROS domain that is new, because the others take a process that was killed for a living one for many
    seconds.
    """
    with (
        beside(domain, record, recording.storage, recording.chunk_s) as (process, client),
        Stream(client, rate_hz, N_JOINTS, (topics.EFFORT_COMMANDS,), seed) as stream,
    ):
        sent, begun = sent_until_kill(client, stream, process, folder, moment_s)
    found, saved, lost_s, violations = judge(folder, sent)
    if begun and found in ("not begun", "nothing"):
        violations.append("nothing is left of a recording that had begun")
    return Kill(recording.storage, moment_s, found, len(sent), saved, lost_s, tuple(violations))


def sent_until_kill(
    client: Client, stream: Stream, process: Any, folder: Path, moment_s: float
) -> tuple[list[Sent], bool]:
    """Return what was sent until the kill, and whether the recorder had said that the recording has begun."""
    client.wait_for_recorder()
    client.answer(client.call_start(folder / FIRST, stream.goal(1, N_POINTS)))
    stream.begin(1)
    client.spin_for(FIRST_S)
    client.answer(client.call_stop(stream.end(1)))
    goal = stream.goal(2, N_POINTS)
    stream.begin(2)
    started = client.call_start(folder / SECOND, goal)
    client.spin_for(min(moment_s, SECOND_S))
    if moment_s > SECOND_S:
        client.call_stop(stream.end(2))
        client.spin_for(moment_s - SECOND_S)
    process.kill()
    return list(stream.sent), started.done()


def judge(folder: Path, sent: list[Sent]) -> tuple[str, int, float, list[str]]:
    """Return what is there after a kill, how many messages, what was lost in s, and what must not be."""
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
        return "not begun", 0, 0.0, violations
    else:
        found = "recovered"
        try:
            bag = recover(unfinished).bag
        except BagError as error:
            if "no whole chunk" not in str(error) and "no transaction" not in str(error):
                violations.append(str(error))
            return "nothing", 0, 0.0, violations
        with suppress(BagError):
            read_trial(bag)
            violations.append("a recovered bag passes for a whole one")
    saved = in_bag(bag)
    violations += compared(saved, sent)
    n_saved = sum(len(stamps) for stamps in saved.values())
    states = [stamp for topic, stamp, _ in sent if topic == topics.JOINT_STATES]
    newest = max(saved.get(topics.JOINT_STATES, {states[0]: b""}))
    lost_s = max(0, states[-1] - newest) / NS_PER_S
    return found, n_saved, lost_s, violations


def compared(saved: dict[str, dict[int, bytes]], sent: list[Sent]) -> list[str]:
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


FOUND = ("whole", "recovered", "not begun", "nothing")
HEADINGS = ("storage", "chunk s", "kills", *FOUND, "lost s, median", "most", "saved %, median", "violations")


def row(recording: RecordingConfig, kills: list[Kill]) -> list[str]:
    counts = [sum(kill.found == found for kill in kills) for found in FOUND]
    of_recovered = [(k.lost_s, 100.0 * k.saved / k.sent) for k in kills if k.found == "recovered"]
    figures = [NONE] * 3
    if of_recovered:
        lost_s, saved = zip(*of_recovered, strict=True)
        figures = [f"{np.median(lost_s):.2f}", f"{max(lost_s):.2f}", f"{np.median(saved):.0f}"]
    violations = sum(bool(kill.violations) for kill in kills)
    counted = map(str, (len(kills), *counts))
    return [recording.storage, f"{recording.chunk_s:g}", *counted, *figures, str(violations)]


@study()
@click.option("--kills", "n_kills", default=100, show_default=True, help="All storages together.")
@click.option("--seed", default=1, show_default=True)
@click.option("--rate-hz", default=500.0, show_default=True, help="Of the arm.")
@click.option("--chunk-s", default=RecordingConfig().chunk_s, show_default=True)
@click.option("--first-domain", default=60, show_default=True, help=f"Of {N_DOMAINS} ROS domains to use.")
def recorder_kills(
    options: StudyOptions, n_kills: int, seed: int, rate_hz: float, chunk_s: float, first_domain: int
) -> None:
    """SIGKILL for the recorder at random moments of a trial; stderr gets a line of JSON for each."""
    os.environ.update(ON_THIS_MACHINE)
    storages: list[Any] = options.selected(["mcap", "sqlite3"])
    rng = np.random.default_rng(seed)
    all_kills = [(RecordingConfig(storage=name, chunk_s=chunk_s), list[Kill]()) for name in storages]
    with tempfile.TemporaryDirectory() as root:
        for k in range(n_kills):
            recording, kills = all_kills[k % len(all_kills)]
            moment_s = float(rng.uniform(0.0, SECOND_S + AFTERWARDS_S))
            where, domain = Path(root) / f"{k:03d}", first_domain + k % N_DOMAINS
            try:
                kill = kill_once(where, recording, moment_s, domain, rate_hz, seed + k)
            except (TimeoutError, RuntimeError) as error:
                # Before anything was killed: the machine is too busy for a recorder to keep up.
                print(f"kill {k} did not come about: {error}", file=sys.stderr, flush=True)
                continue
            kills.append(kill)
            print(json.dumps(asdict(kill)), file=sys.stderr, flush=True)
    print(of_texts(HEADINGS, [row(*each) for each in all_kills]).markdown())
    if any(kill.violations for _, kills in all_kills for kill in kills):
        raise TelError("something happened that must not")
