"""What the map of a sweep says about a practice run."""

from __future__ import annotations

from itertools import product

import pytest

from tel_lab.sweep.plan import MapPlan
from tel_lab.sweep.point import failure
from tel_lab.sweep.verdict_map import Verdict, map_figure, verdict

PLAN = MapPlan(x="sim.inertia_scale", y="practice.goal_duration_s", tolerance_rad=0.02)
GOOD = {
    **failure(""),
    "trials": 15,
    "outcome": "completed",
    "goal_reached": True,
    "rms_first_rad": 0.2,
    "rms_final_rad": 0.012,
    "max_error_rad": 0.31,
    "goal_effort_ratio": 0.8,
}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, Verdict.REACHED),
        ({"rms_final_rad": 0.03}, Verdict.ABOVE),
        ({"rms_final_rad": 0.03, "warning": "learning lock-up: …"}, Verdict.LOCKED_UP),
        ({"rms_final_rad": 0.015, "warning": "learning lock-up: …"}, Verdict.REACHED),
        ({"rms_final_rad": 0.3, "warning": "learning diverges: …"}, Verdict.UNSTABLE),
        ({"rms_final_rad": 0.03, "warning": "learning diverges: …"}, Verdict.ABOVE),
        ({"rms_final_rad": None, "outcome": "aborted"}, Verdict.UNSTABLE),
        ({"goal_reached": False, "outcome": "stopped"}, Verdict.STOPPED),
        ({"outcome": "failed", "message": "hardly anything to learn from"}, Verdict.UNSTABLE),
        (failure("no such arm"), Verdict.FAILED),
    ],
)
def test_a_run_is_judged_by_its_last_trial(changed: dict, expected: Verdict) -> None:
    assert verdict({**GOOD, **changed}, PLAN.tolerance_rad) is expected


def rows(seeds: int = 1) -> list[dict]:
    return [
        {
            "case": case,
            PLAN.x: x,
            PLAN.y: y,
            "seed": seed,
            **GOOD,
            "rms_final_rad": 0.01 * seed,
            "goal_effort_ratio": x / y,
        }
        for case, x, y, seed in product(("TEL", "direct"), (1.0, 2.0, 4.0), (6.0, 3.0), range(1, seeds + 1))
    ]


def test_each_case_has_a_panel_and_each_cell_its_numbers() -> None:
    figure = map_figure(rows(), PLAN)
    shown = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title() for axes in shown] == ["TEL", "direct"]
    for axes in shown:
        assert [text.get_text() for text in axes.texts] == ["10", "0.31"] * 6
    # Up is faster: in the order of the grid.
    assert [label.get_text() for label in shown[0].get_yticklabels()] == ["6", "3"]
    assert [label.get_text() for label in shown[0].get_xticklabels()] == ["1", "2", "4"]


def test_the_worst_seed_gives_the_number_and_every_seed_a_stripe() -> None:
    axes = map_figure(rows(seeds=3), PLAN).axes[0]
    assert [text.get_text() for text in axes.texts][::2] == ["30"] * 6
    assert len(axes.patches) == 6 * (3 + 1)


def test_the_line_encloses_what_needs_more_effort_than_there_is() -> None:
    axes = map_figure(rows(), PLAN).axes[0]
    # Beyond is only inertia 4 at 3 s: the cell at the upper right, with four sides.
    sides = {(tuple(line.get_xdata()), tuple(line.get_ydata())) for line in axes.lines}
    assert sides == {((2, 2), (1, 2)), ((3, 3), (1, 2)), ((2, 3), (1, 1)), ((2, 3), (2, 2))}
