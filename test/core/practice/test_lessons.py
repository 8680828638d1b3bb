"""Which trials teach something, and which have to."""

from __future__ import annotations

import pytest

from tel_ros.core.practice.lessons import has_to_teach, is_learned_from
from tel_ros.core.trial import Outcome


@pytest.mark.parametrize("outcome", list(Outcome))
@pytest.mark.parametrize("on_abort", ["stop", "continue"])
def test_completed_trials_teach_and_aborted_ones_only_where_practice_goes_on(outcome, on_abort) -> None:  # noqa: ANN001
    learned = is_learned_from(outcome, True, on_abort)
    assert learned == (
        outcome == Outcome.COMPLETED or (outcome == Outcome.ABORTED and on_abort == "continue")
    )
    # Practice that goes on after an abort goes on after a completed trial of which nothing is left, too.
    assert has_to_teach(outcome, on_abort) == (outcome == Outcome.COMPLETED and on_abort == "stop")


def test_an_abort_before_the_movement_teaches_nothing() -> None:
    assert not is_learned_from(Outcome.ABORTED, False, "continue")
