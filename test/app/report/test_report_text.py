"""The numbers and sentences of a report."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from made_up_run import MakeRun, Trial

from tel_ros.app.report.data import RunData, read_run
from tel_ros.app.report.text import ending, enumeration, result, run_line, significant, tracking_caption
from tel_ros.core.trial import Outcome


def test_the_lines_about_a_run_tell_what_it_was_and_what_came_out(good_run: RunData) -> None:
    assert run_line(good_run) == (
        "test_arm (simulated arm) · path planar_loops · trajectory extension, even steps in duration · "
        "lms_tree (lms) · actual trajectory training · seed 77"
    )
    assert result(good_run).replace("\N{NO-BREAK SPACE}", " ") == (
        "RMS tracking error: 0.0500 rad (trial 1, 2.0 s) at first, 0.0167 rad (trial 3, 1.33 s) at best, "
        "0.0167 rad (trial 3, 1.33 s) in the end. From 2.0 s to 1.33 s, the movement became 1.5 times as "
        "fast."
    )


def test_half_a_movement_is_neither_the_best_nor_the_fastest(good_run: RunData) -> None:
    whole, half, _ = good_run.trials
    run = replace(good_run, trials=(whole, replace(half, outcome=Outcome.ABORTED)))
    text = result(run).replace("\N{NO-BREAK SPACE}", " ")
    assert "0.0500 rad (trial 1, 2.0 s) at best, 0.0250 rad (trial 2, 1.67 s, aborted) in the end." in text
    assert "times as fast" not in text


@pytest.mark.parametrize(
    ("outcome", "message", "expected"),
    [
        ("completed", "", "3 of 3 trials completed."),
        ("cancelled", "the run was cancelled", "The run was cancelled. 3 of 3"),
        ("failed", "ep_controller died.", "The run failed: ep_controller died. 3 of 3"),
        ("running", "", "The run did not come to its end"),
    ],
)
def test_how_a_run_ended_is_said_plainly(
    good_run: RunData, outcome: str, message: str, expected: str
) -> None:
    assert ending(replace(good_run, outcome=outcome, message=message)).startswith(expected)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.0681005, "0.0681"), (0.05, "0.0500"), (11.5, "11.5"), (20.0, "20.0"), (123.4, "123"), (0.0, "0.00"),
     (0.09999, "0.100"), (math.nan, "–")],
)  # fmt: skip
def test_numbers_have_three_digits_that_say_something(value: float, expected: str) -> None:
    assert significant(value) == expected


@pytest.mark.parametrize(("words", "expected"), [("a", "a"), ("ab", "a and b"), ("abc", "a, b and c")])
def test_words_are_put_into_one_phrase(words: str, expected: str) -> None:
    assert enumeration(list(words)) == expected


def test_the_caption_says_how_much_of_each_trials_error_lay_within_its_band(make_run: MakeRun) -> None:
    made_of = [Trial(1), Trial(2, std_rad=(0.02,) * 13 + (0.03,) * 13), Trial(3, std_rad=(0.03,) * 26)]
    caption = tracking_caption(read_run(make_run(made_of)).drawn)
    assert caption.endswith(
        "Found within: 50\N{NO-BREAK SPACE}% in trial 2 and 100\N{NO-BREAK SPACE}% in trial 3."
    )


def test_the_caption_says_nothing_of_bands_that_there_are_not(good_run: RunData) -> None:
    expected = "Tracking error of each joint over the movement, for the same trials."
    assert tracking_caption(good_run.drawn) == expected
