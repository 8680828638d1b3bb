"""Which trials teach something, and which have to."""

from __future__ import annotations

import pytest

from tel_ros.core.errors import TrainingError
from tel_ros.core.practice.session import learned_or_passed_over
from tel_ros.core.trial import Outcome


def too_little() -> None:
    raise TrainingError("all clipped")


@pytest.mark.parametrize("outcome", list(Outcome))
@pytest.mark.parametrize("on_abort", ["stop", "continue"])
def test_completed_trials_teach_and_aborted_ones_only_where_practice_goes_on(outcome, on_abort) -> None:  # noqa: ANN001
    learned, why_not = learned_or_passed_over(outcome, True, on_abort, lambda: "a lesson")
    expected = outcome == Outcome.COMPLETED or (outcome == Outcome.ABORTED and on_abort == "continue")
    assert (learned == "a lesson") == expected
    assert why_not == ("" if expected else f"{outcome.text}: not learned from")
    # Practice that goes on after an abort goes on after a completed trial of which nothing is left, too.
    if outcome == Outcome.COMPLETED and on_abort == "stop":
        with pytest.raises(TrainingError):
            learned_or_passed_over(outcome, True, on_abort, too_little)
    elif expected:
        passed_over = (None, "nothing was learned: all clipped")
        assert learned_or_passed_over(outcome, True, on_abort, too_little) == passed_over


def test_an_abort_before_the_movement_teaches_nothing() -> None:
    assert learned_or_passed_over(Outcome.ABORTED, False, "continue", lambda: "a lesson")[0] is None
