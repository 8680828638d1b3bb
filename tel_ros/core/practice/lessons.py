"""Which trials teach something."""

from __future__ import annotations

from typing import Literal

from tel_ros.core.control.records import Outcome


def is_learned_from(outcome: Outcome, reached_run: bool, on_abort: Literal["stop", "continue"]) -> bool:
    """Return whether a trial is learned from.

    One that was aborted may still teach too little; it is then passed over.

    Args:
        outcome: how the trial ended.
        reached_run: whether it reached its movement.
        on_abort: what practice makes of aborted trials (``practice.on_abort``).
    """
    if outcome == Outcome.COMPLETED:
        return True
    return outcome == Outcome.ABORTED and on_abort == "continue" and reached_run
