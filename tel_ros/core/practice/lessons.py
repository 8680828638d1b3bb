"""Which trials teach something."""

from __future__ import annotations

from typing import Literal

from tel_ros.core.trial import Outcome


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


def has_to_teach(outcome: Outcome, on_abort: Literal["stop", "continue"]) -> bool:
    """Return whether practice ends when nothing can be learned from a trial.

    Of a completed one too little may be left because the effort was clipped, or held back for states that
    came late. A practice that goes on after aborts (``practice.on_abort``) goes on after that, too.

    Args:
        outcome: how the trial ended.
        on_abort: what practice makes of aborted trials.
    """
    return outcome == Outcome.COMPLETED and on_abort == "stop"
