"""What a fault campaign found, as a table on the terminal and as a page."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from fault_injection import STALL_S, TRIES, UNEXPLAINED_S, Row
from fault_judge import CAUGHT_AT, DELAY_S, EXPECTATIONS, REACTION_LIMIT_S
from fault_kinds import KINDS
from fault_setups import PRIORITY, RATE_HZ, RUN_S, SETUPS, SWING_RAD

from tel_lab.tables import of_texts

TEMPLATE = Path(__file__).with_name("fault_page.md")
MANY = 20
"""Violations that the page tells in full."""
HEADER = ("fault", "faults", "violated", "completed", "stopped", "reaction, ms", "effort", "speed", "bags")


def table(rows: Sequence[Row]) -> str:
    """Return the results, one line a kind."""
    kinds = _of_kinds(rows)
    return of_texts(HEADER, [_cells(name, ours) for name, ours in {**kinds, "all": rows}.items()]).markdown()


def write_page(rows: Sequence[Row], file: Path, command: str, planned: int) -> None:
    """Write the page about a campaign, of which so many faults were planned."""
    judged = [row for row in rows if not row.skipped]
    page = TEMPLATE.read_text(encoding="utf-8").format(
        command=command,
        so_far="" if len(rows) == planned else f" So far {len(rows)} of {planned}.",
        summary=_summary(rows, judged),
        setups=_setups(rows),
        **{"run_s": RUN_S, "swing_rad": SWING_RAD, "rate_hz": RATE_HZ, "priority": PRIORITY},
        **{"reaction_limit_s": REACTION_LIMIT_S, "delay_ms": 1e3 * DELAY_S, "caught": CAUGHT_AT - 1.0},
        tolerances=", ".join(f"{s.work_tolerance_j:g} J (`{s.name}`)" for s in SETUPS.values()),
        expectations="\n".join(f"- **{name}**: {text}." for name, text in EXPECTATIONS.items()),
        results=table(rows),
        kinds=of_texts(("fault", "what", "right", "judged as"), _kinds(rows), 4).markdown(),
        violations=_told("Violations", [row for row in judged if row.violations], _violation),
        earlier=_told("Found before a fault was injected again", [r for r in judged if r.earlier], _earlier),
    )
    file.write_text(page, encoding="utf-8")


def _of_kinds(rows: Sequence[Row]) -> dict[str, list[Row]]:
    kinds = {name: [row for row in rows if row.fault.kind == name] for name in KINDS}
    return {name: ours for name, ours in kinds.items() if ours}


def _cells(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    """Return the cells of a line about faults of a kind, or about all of them."""
    skipped = sum(bool(row.skipped) for row in rows)
    reactions_ms = [1e3 * row.reaction_s for row in rows if row.reaction_s is not None]
    ways = [row.stopped for row in rows if row.stopped != "-"]
    stopped = ", ".join(f"{ways.count(way)} {way}" for way in ("held", "zero") if way in ways)
    return (
        name,
        f"{len(rows)}" + (f" ({skipped} skipped)" if skipped else ""),
        str(sum(bool(row.violations) for row in rows)),
        str(sum(row.outcome == "completed" for row in rows)),
        stopped or "-",
        f"{np.median(reactions_ms):.0f} / {max(reactions_ms):.0f}" if reactions_ms else "-",
        f"{max(row.effort_share for row in rows):.2f}",
        f"{max(row.speed_share for row in rows):.2f}",
        str(sum(row.bags for row in rows)),
    )


def _kinds(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    lines = []
    for name, ours in _of_kinds(rows).items():
        kind = KINDS[name]
        ways = sorted({kind.expectation(row.fault.parameters) for row in ours})
        lines.append((name, kind.what, kind.right, ", ".join(ways)))
    return lines


def _summary(rows: Sequence[Row], judged: Sequence[Row]) -> str:
    repeated = sum(bool(row.earlier) for row in judged)
    text = (
        f"{len(judged)} faults were injected into the running graph (real processes over DDS), "
        f"{sum(bool(row.violations) for row in judged)} of them led to a violation. "
        f"{sum(row.bags for row in judged)} bags of finished trials were read back and checked against their "
        "checksums and counts."
    )
    if repeated:
        text += (
            f" {repeated} faults were injected again, {TRIES - 1} times at most, because something else had "
            f"disturbed them: the machine stood still for more than {1e3 * STALL_S:.0f} ms (where the trial "
            f"should ride the fault out, the controller's process for {1e3 * UNEXPLAINED_S:.0f} ms), or the "
            "run ended before the fault came. The last time counts; what was found before is below."
        )
    if len(judged) < len(rows):
        reasons = sorted({row.skipped for row in rows if row.skipped})
        text += f" {len(rows) - len(judged)} were skipped: {'; '.join(reasons)}."
    return text


def _setups(rows: Sequence[Row]) -> str:
    lines = []
    for setup in SETUPS.values():
        how = "lockstep, `run.arm: sim`; the campaign listens"
        if setup.in_between:
            how = "real time, `run.arm: external`; the campaign stands between arm and graph"
            how += "" if setup.guarded else "; without `arm_guard`"
        n = sum(row.fault.setup == setup.name for row in rows)
        lines += [f"- `{setup.name}`: `config/{setup.config_file.name}`, {how}. {n} faults."] if n else []
    return "\n".join(lines)


def _told(title: str, rows: Sequence[Row], tell: Callable[[Row], str]) -> str:
    """Return a section about some faults, without the folders that messages quote from the machine."""
    if not rows:
        return ""
    lines = [re.sub(r"(?<![\w.])/(?:[\w.+-]+/){2,}", "…/", f"- {tell(row)}.") for row in rows[:MANY]]
    lines += [f"- and {len(rows) - MANY} more"] if len(rows) > MANY else []
    return f"\n## {title}\n\n" + "\n".join(lines) + "\n"


def _violation(row: Row) -> str:
    fault = row.fault
    where = f"{fault.index}, {fault.kind} in `{fault.setup}`, {fault.offset_s} s into trial {row.trial}"
    return f"{where}, {fault.parameters}: {'; '.join(row.violations)}"


def _earlier(row: Row) -> str:
    return f"{row.fault.index}, {row.fault.kind} in `{row.fault.setup}`: {' | '.join(row.earlier)}"
