"""Trials lie one after another in an exported file, at their recorded times if those let them."""

from __future__ import annotations

from tel_ros.recording.export.run_export import GAP_NS, Timeline


def test_recorded_times_are_kept_as_long_as_they_do_not_go_back() -> None:
    timeline = Timeline()
    assert [timeline.place(*span) for span in ((5, 10), (10, 12), (10**12, 10**12 + 1))] == [0, 0, 0]


def test_a_trial_that_would_lie_on_the_one_before_comes_behind_it() -> None:
    timeline = Timeline()
    timeline.place(100, 200)
    assert timeline.place(199, 300) == 1 + GAP_NS


def test_what_follows_a_clock_that_began_anew_keeps_its_distance() -> None:
    timeline = Timeline()
    timeline.place(0, 200)
    shift_ns = timeline.place(0, 100)
    assert shift_ns == 200 + GAP_NS
    assert timeline.place(150, 250) == shift_ns
    assert timeline.place(0, 10) == shift_ns + 250 + GAP_NS
