"""What a comparison says as text: the same numbers everywhere, and no more than was measured."""

from __future__ import annotations

import csv
import io
import json

import pytest
from made_up_comparison import N_ARMS, made_up_comparison
from rich.console import Console

from tel_lab.comparison.comparison_table import (
    csv_text,
    json_text,
    page,
    rows,
    speed_text,
    standings,
    table,
)


def by_title() -> dict[str, list[str]]:
    return {row[0]: row[1:] for row in rows(made_up_comparison())}


def test_a_cell_has_the_median_and_its_interval() -> None:
    """Final errors are 1 mrad times 1.01 … 1.10: median 1.055, second and ninth 1.02 and 1.09."""
    assert by_title()["TEL adaptive, least-squares tree"][2] in ("1.05 [1.02, 1.09]", "1.06 [1.02, 1.09]")


def test_what_was_never_reached_aborted_or_cannot_be_is_said_in_words() -> None:
    found = by_title()
    assert found["no learning"][:2] == ["never", "never"]
    assert found["direct, desired training"][2] == "aborted"
    assert found["direct, desired training"][3] == "never"
    assert found["direct, desired training"][5] == "1"
    assert found["iterative learning control"][3] == "3"  # 4.5 s over a bound of 1.5 s
    assert found["iterative learning control"][6] == "–"
    assert found["iterative learning control"][:2] == ["2", "14"]


def test_who_is_told_the_model_is_marked() -> None:
    assert "exact inverse dynamics ³" in by_title()
    assert "TEL adaptive, least-squares tree" in by_title()


def test_the_family_stands_first_where_none_is_better_and_behind_where_one_is() -> None:
    ((title, *places),) = standings(made_up_comparison(), "tel_adaptive")
    assert title == "TEL adaptive, least-squares tree"
    assert places[0] == "first"
    assert places[2] == "behind: iterative learning control"  # not of the exact model, which was told more
    assert places[6] == "first"  # who cannot follow a new path is no rival there


def test_csv_has_a_line_a_method_and_arm_in_si_units() -> None:
    lines = list(csv.DictReader(io.StringIO(csv_text(made_up_comparison()))))
    assert len(lines) == 5 * N_ARMS
    first = {line["method"]: line for line in lines if line["seed"] == "1"}
    assert float(first["tel_adaptive_least_squares"]["final_error_rad"]) == pytest.approx(1.01e-3)
    assert first["no_learning"]["trials_to_tolerance"] == "inf"
    assert first["iterative_learning"]["new_path_error_rad"] == ""
    assert first["no_learning"]["message"] == "said, by the strategy"


def test_json_is_strict_and_has_every_trial() -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    found = json.loads(json_text(made_up_comparison()), parse_constant=refuse)
    method = found["methods"]["no_learning"]
    assert method["median"]["trials_to_tolerance"] == {"value": None, "low": None, "high": None}
    assert found["methods"]["iterative_learning"]["median"]["new_path_error_rad"] is None
    assert len(method["runs"]) == N_ARMS
    assert len(method["runs"][0]["trials"]) == 2


def test_the_page_shows_the_table_the_figure_and_the_command() -> None:
    text = page(made_up_comparison(), "tel compare x.yaml", "comparison.svg")
    assert "`tel compare x.yaml`" in text
    assert "](comparison.svg)" in text
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    assert len({line.count("|") for line in lines}) == 1
    assert "behind: iterative learning control" in text


def test_the_speed_is_arm_time_over_elapsed_time() -> None:
    """Four tests and trials of 7 s, three for the method without a new path: 190 runs of them in 10 s."""
    assert speed_text(made_up_comparison()).startswith(
        "1330 s of arm time in 10 s: 133 times real time (53 times"
    )


def test_the_terminal_shows_every_method() -> None:
    console = Console(width=240, record=True, file=io.StringIO())
    console.print(table(made_up_comparison()).terminal())
    text = console.export_text()
    assert all(title in text for title in by_title())
