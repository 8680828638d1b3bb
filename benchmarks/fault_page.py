"""What a fault campaign found, as a table on the terminal and as a page."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from fault_campaign import STALL_S, TRIES, UNEXPLAINED_S, Row
from fault_judge import CAUGHT_AT, DELAY_S, REACTION_LIMIT_S
from fault_kinds import EXPECTATIONS, KINDS, Kind
from fault_setups import PRIORITY, RATE_HZ, RUN_S, SETUPS, SWING_RAD

MANY = 20
"""Violations that the page tells in full."""


def table(rows: Sequence[Row]) -> str:
    """Return the results, one line a kind."""
    header = ("kind", "faults", "violated", "completed", "stopped", "reaction ms", "effort", "speed", "bags")
    lines = [header, *(_cells(kind, _of(kind, rows)) for kind in KINDS.values() if _of(kind, rows))]
    lines.append(_cells(None, rows))
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    return "\n".join(
        "  ".join(f"{cell:<{w}}" for cell, w in zip(line, widths, strict=True)) for line in lines
    )


def write_page(rows: Sequence[Row], file: Path, command: str, planned: int) -> None:
    """Write the page about a campaign, of which so many faults were planned."""
    judged = [row for row in rows if not row.skipped]
    violated = [row for row in judged if row.violations]
    parts = [
        "# Faults",
        f"Made by `{command}`." + ("" if len(rows) == planned else f" So far {len(rows)} of {planned}."),
        _summary(rows, judged, violated),
        *("## Graphs", _setups(rows)),
        *("## What is judged", _rules()),
        *("## Results", _markdown(rows)),
        *("## What was done, and what is right then", _kinds(rows)),
    ]
    if violated:
        parts += ["## Violations", _violations(violated)]
    if any(row.earlier for row in judged):
        parts += ["## Found before a fault was injected again", _earlier(judged)]
    parts += ["## What this does not show", _limits()]
    file.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _of(kind: Kind, rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row.fault.kind == kind.name]


def _cells(kind: Kind | None, rows: Sequence[Row]) -> tuple[str, ...]:
    """Return the cells of a line about faults of a kind, or about all of them."""
    skipped = sum(bool(row.skipped) for row in rows)
    reactions_ms = [1e3 * row.reaction_s for row in rows if row.reaction_s is not None]
    ways = [row.stopped for row in rows if row.stopped != "-"]
    stopped = ", ".join(f"{ways.count(way)} {way}" for way in ("held", "zero") if way in ways)
    return (
        kind.name if kind else "all",
        f"{len(rows)}" + (f" ({skipped} skipped)" if skipped else ""),
        str(sum(bool(row.violations) for row in rows)),
        str(sum(row.outcome == "completed" for row in rows)),
        stopped or "-",
        f"{np.median(reactions_ms):.0f} / {max(reactions_ms):.0f}" if reactions_ms else "-",
        f"{max(row.effort_share for row in rows):.2f}",
        f"{max(row.speed_share for row in rows):.2f}",
        str(sum(row.bags for row in rows)),
    )


def _markdown(rows: Sequence[Row]) -> str:
    header = (
        "| fault | faults | violated | trial completed | stopped | reaction, ms, median / largest "
        "| effort | speed | bags read |\n|---|---|---|---|---|---|---|---|---|"
    )
    lines = [_cells(kind, _of(kind, rows)) for kind in KINDS.values() if _of(kind, rows)]
    lines.append(_cells(None, rows))
    text = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return (
        f"{header}\n{text}\n\nReaction: from the fault (or, where the trial may go on, from the "
        f"controller's STOP) to "
        "the moment from which the motors only brake, hold or do nothing. Effort and speed: largest share "
        "of the "
        "limit after a fault. Held: springs brake, then hold; zero: no effort from 0.1 s on."
    )


def _summary(rows: Sequence[Row], judged: Sequence[Row], violated: Sequence[Row]) -> str:
    repeated = sum(bool(row.earlier) for row in judged)
    text = (
        f"{len(judged)} faults were injected into the running graph (real processes over DDS), "
        f"{len(violated)} of "
        f"them led to a violation. {sum(row.bags for row in judged)} bags of finished trials were read "
        f"back and "
        "checked against their checksums and counts."
    )
    if repeated:
        text += (
            f" {repeated} faults were injected again, {TRIES - 1} times at most, because something else had "
            f"disturbed them: the machine stood still for more than {1e3 * STALL_S:.0f} ms (where the trial "
            f"should ride the fault out, the controller's process for {1e3 * UNEXPLAINED_S:.0f} ms), or the "
            "run ended before "
            "the fault came; or because the judge was mended. The last time counts; what was found before is "
            "below."
        )
    if len(judged) < len(rows):
        reasons = sorted({row.skipped for row in rows if row.skipped})
        text += f" {len(rows) - len(judged)} were skipped: {'; '.join(reasons)}."
    return text


def _setups(rows: Sequence[Row]) -> str:
    lines = []
    for setup in SETUPS.values():
        n = sum(row.fault.setup == setup.name for row in rows)
        if n:
            how = (
                "real time, `run.arm: external`; the campaign stands between arm and graph"
                if setup.in_between
                else "lockstep, `run.arm: sim`; the campaign listens"
            )
            lines.append(f"- `{setup.name}`: `config/{setup.config_file.name}`, {how}. {n} faults.")
    return (
        "\n".join(lines)
        + f"\n\nTrials of {RUN_S} s, in which each joint swings {SWING_RAD} rad to one side and back, at "
        f"{RATE_HZ:.0f} Hz; `practice.on_abort: continue`; in real time `control.realtime_priority: "
        f"{PRIORITY}`, as `config/real_arm.yaml` has it, where it is permitted. A graph that survives a "
        "fault gets the next one in its next "
        "trial. Only in real time does silence mean what it means on an arm; in lockstep the arm's time "
        "stands still "
        "while nobody commands it, so there the process faults are injected that do not need a clock."
    )


def _rules() -> str:
    meanings = "\n".join(f"- **{name}**: {text}." for name, text in EXPECTATIONS.items())
    tolerances = ", ".join(f"{s.work_tolerance_j:g} J (`{s.name}`)" for s in SETUPS.values())
    return (
        "What the arm itself says its motors and joints did; never the controller's word. An arm is "
        "*braked, held or "
        "without effort* from the moment from which its motors put no more than a small work into it, "
        "whatever the "
        "interval: no effort does none, springs that brake do negative work, springs that hold a resting "
        "arm none. "
        f"Tolerances: {tolerances}, under gravity and half of the largest kinetic energy, which "
        f"springs that catch a falling arm may give back, and, if it had been let go and fell, half of what "
        f"its weight does until they have turned it round, 2 g² / K a joint, and what lifts joints that "
        f"fell beyond their soft limits back to these; an undisturbed trial of the "
        f"planar arm takes 0.4 to 0.9 J. A brake that gives way to a weight would pass. So, as soon as "
        f"nothing is disturbed any more, a joint on which motors act may go no further than "
        f"(g + √(g² + 2 K E)) / K: the whole "
        f"kinetic energy E of the arm in its spring K, and its weight g. "
        f"This has to "
        f"hold {REACTION_LIMIT_S} s after the fault, plus the {1e3 * DELAY_S:.0f} ms that the arm contract "
        f"allows a "
        "command to show.\n\n"
        f"{meanings}\n\n"
        "Always: no effort, speed or joint range passed (speed and range of an arm under gravity count "
        "while its "
        "motors act: without effort it falls, and may be "
        f"{CAUGHT_AT - 1.0:.0%} faster yet while it is caught); "
        "every bag under its own name whole, and one for each trial in the "
        "summary; no process outlives its run; exit code and message say what happened; after the run no "
        "effort."
    )


def _kinds(rows: Sequence[Row]) -> str:
    lines = ["| fault | what | right | judged as |", "|---|---|---|---|"]
    for kind in KINDS.values():
        ours = _of(kind, rows)
        if ours:
            ways = sorted({kind.expects(row.fault.parameters) for row in ours})
            lines.append(f"| {kind.name} | {kind.what} | {kind.right} | {', '.join(ways)} |")
    return "\n".join(lines)


def _violations(violated: Sequence[Row]) -> str:
    def tell(row: Row) -> str:
        fault = row.fault
        return (
            f"- {fault.index}, {fault.kind} in `{fault.setup}`, {fault.offset_s} s into trial {row.trial}, "
            f"{fault.parameters}: {'; '.join(row.violations)}."
        )

    rest = [f"- and {len(violated) - MANY} more"] if len(violated) > MANY else []
    return "\n".join([*map(_plainly(tell), violated[:MANY]), *rest])


def _earlier(judged: Sequence[Row]) -> str:
    def tell(row: Row) -> str:
        return f"- {row.fault.index}, {row.fault.kind} in `{row.fault.setup}`: {' | '.join(row.earlier)}."

    told = [row for row in judged if row.earlier]
    rest = [f"- and {len(told) - MANY} more"] if len(told) > MANY else []
    return "\n".join([*map(_plainly(tell), told[:MANY]), *rest])


def _plainly(tell: Callable[[Row], str]) -> Callable[[Row], str]:
    """Keep the folders that a message quotes from the machine out of the page."""
    return lambda row: re.sub(r"(?<![\w.])/(?:[\w.+-]+/){2,}", "…/", tell(row))


def _limits() -> str:
    return (
        "- A channel that corrupts every command on its way to the drive: nothing behind the controller "
        "can mend that. "
        "Here a few commands at a time are wrong.\n"
        "- What a drive does when its own driver dies (`kill_sim_bridge`): only that nobody commands "
        "anything any more.\n"
        "- Encoders that stand still while their stamps go on; `tel check` looks for that before a run.\n"
        "- A real arm."
    )
