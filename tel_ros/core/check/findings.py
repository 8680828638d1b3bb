"""What a check says: measured, expected, and what to mend."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Verdict(Enum):
    """How one check ended."""

    OK = "ok"
    WARNING = "warning"
    """Nothing that forbids to go on, but somebody should know."""
    NOT_CHECKED = "not checked"
    WRONG = "wrong"


@dataclass(frozen=True)
class Finding:
    """One line of the table.

    Args:
        check: what was looked at.
        verdict: how it ended.
        measured: in words, with units.
        expected: in words, with units.
        mend: what to do about it; empty if there is nothing to do.
        joint: which joint; empty: the arm as a whole.
        blocks: whether the arm must not be moved before this is mended.
    """

    check: str
    verdict: Verdict
    measured: str
    expected: str
    mend: str = ""
    joint: str = ""
    blocks: bool = False


def judged(
    check: str,
    good: bool,
    measured: str,
    expected: str,
    mend: str,
    *,
    joint: str = "",
    otherwise: Verdict = Verdict.WRONG,
    blocks: bool = False,
) -> Finding:
    """Return a finding that is OK, or ``otherwise`` with what to mend."""
    if good:
        return Finding(check, Verdict.OK, measured, expected, "", joint)
    return Finding(check, otherwise, measured, expected, mend, joint, blocks and otherwise is Verdict.WRONG)


def worst(findings: Iterable[Finding]) -> Verdict:
    """Return the verdict on all of it: wrong if anything is, else a warning if there is one, else OK."""
    verdicts = {finding.verdict for finding in findings}
    for verdict in (Verdict.WRONG, Verdict.WARNING):
        if verdict in verdicts:
            return verdict
    return Verdict.OK
