"""A fault campaign: graphs side by side, results stored as they come, and a line about each fault."""

from __future__ import annotations

import itertools
import json
import multiprocessing
import shutil
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from pathlib import Path

from fault_graph import DiskUnavailableError, FaultGraph
from fault_injection import STALL_S, TRIES, Injection, Row
from fault_plan import Fault, batches
from fault_setups import SETUPS

PROCESSES = 3
"""So many a batch may use up."""
DOMAINS_PER_JOB = 20
"""A graph gets another domain than the one before it: what that has left behind must not answer."""


def run_batch(
    faults: Sequence[Fault], folder: Path, domains: Sequence[int], keep: bool, results: Path
) -> list[Row]:
    """Inject some faults of one kind of graph; a new graph comes up whenever a run has ended.

    Each row is appended to the results (JSON lines) at once. The folder for the graphs' files must not exist;
    those of graphs without a violation go unless they are to be kept.
    """
    waiting, rows, earlier = list(faults), [], defaultdict(list)
    for n_graphs in itertools.count():
        if not waiting:
            return rows
        graph_folder = folder / f"graph_{n_graphs + 1}"
        done = _run_graph(waiting, earlier, graph_folder, domains[n_graphs % len(domains)], results)
        rows += done
        if not keep and not any(row.violations for row in done):
            shutil.rmtree(graph_folder, ignore_errors=True)


def _run_graph(
    waiting: list[Fault], earlier: dict[int, list[str]], folder: Path, domain: int, results: Path
) -> list[Row]:
    """Inject waiting faults until the run ends, and take them off the list; note what a stall spoiled."""
    small_disk = any(fault.kind == "disk_full" for fault in waiting)
    rows = []
    try:
        setup = SETUPS[waiting[0].setup]
        with FaultGraph(setup, folder, domain, 3 * len(waiting) + 5, small_disk) as graph:
            injection = Injection(graph)
            while waiting and not graph.ended():
                fault = waiting[0]
                row = injection.inject(fault)
                row.earlier = list(earlier[fault.index])
                disturbed = row.stall_s > STALL_S or not row.trial
                if disturbed and row.violations and len(row.earlier) < TRIES - 1:
                    earlier[fault.index].append(f"{'; '.join(row.violations)} (stall of {row.stall_s} s)")
                    continue
                rows.append(row)
                with results.open("a", encoding="utf-8") as file:  # one write: others append as well
                    file.write(json.dumps(asdict(row)) + "\n")
                waiting.pop(0)
    except DiskUnavailableError as error:
        # Not stored: a campaign that is gone on with where it is permitted injects them.
        full = [fault for fault in waiting if fault.kind == "disk_full"]
        rows += [Row(fault, skipped=f"no small disk can be mounted here: {error}") for fault in full]
        waiting[:] = [fault for fault in waiting if fault.kind != "disk_full"]
    return rows


def stored(results: Path, faults: Sequence[Fault]) -> list[Row]:
    """Return the rows of these very faults that are in the file already."""
    if not results.exists():
        return []
    wanted = {fault.index: asdict(fault) for fault in faults}
    rows = []
    for line in results.read_text(encoding="utf-8").splitlines():
        values = json.loads(line)
        fault = values.pop("fault")
        if wanted.get(fault["index"]) == fault:
            rows.append(Row(Fault(**fault), **values))
    return rows


def run_apart(
    part: Sequence[Fault], folder: Path, domains: Sequence[int], keep: bool, results: Path
) -> list[Row]:
    """Run a batch in a process of its own.

    The middleware has been seen to take that process down with a graph. That costs no other batch anything,
    and what is left of this one is gone on with on another domain.

    Raises:
        BrokenProcessPool: it happens again and again.
    """
    for attempt in itertools.count():
        done = stored(results, part)
        indices = {row.fault.index for row in done}
        left = [fault for fault in part if fault.index not in indices]
        moved_on = [*domains[attempt:], *domains[:attempt]]
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            future = pool.submit(run_batch, left, folder / f"process_{attempt + 1}", moved_on, keep, results)
            try:
                return done + future.result()
            except BrokenProcessPool:
                if attempt == PROCESSES - 1:
                    raise
                print(f"the process of {folder.name} has died; another goes on", file=sys.stderr, flush=True)


def campaign(
    faults: Sequence[Fault], jobs: int, domain: int, work: Path, keep: bool, results: Path
) -> Iterator[Row]:
    """Inject the faults, and give their rows as they come."""
    done_alone = [fault for fault in faults if SETUPS[fault.setup].alone]
    side_by_side = [fault for fault in faults if not SETUPS[fault.setup].alone]
    for some, n_jobs in ((side_by_side, jobs), (done_alone, 1)):
        with ThreadPoolExecutor(n_jobs) as pool:
            futures = []
            for k, part in enumerate(batches(some)):
                # Neighbours in the list run at the same time.
                first = domain + (k % (2 * n_jobs)) * (DOMAINS_PER_JOB // 2)
                domains = range(first, first + DOMAINS_PER_JOB // 2)
                folder = work / f"batch_{part[0].index:04d}"
                futures.append(pool.submit(run_apart, part, folder, domains, keep, results))
            for future in as_completed(futures):
                yield from future.result()


def line(row: Row) -> str:
    """Return one line about a fault."""
    fault = row.fault
    verdict = f"SKIPPED {row.skipped}" if row.skipped else "; ".join(row.violations) or "ok"
    reaction = "" if row.reaction_s is None else f"{1e3 * row.reaction_s:.0f} ms"
    return (
        f"{fault.index:4d}  {fault.kind:24s} {fault.setup:9s} {fault.offset_s:5.2f} s  {row.outcome:10s} "
        f"{reaction:>7s} {row.stopped:5s} {row.wall_s:5.1f} s  {verdict}  [{row.message}]"
    )
