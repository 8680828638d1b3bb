"""The tutorial and the how-to pages do what they say: their code blocks run, and print what is shown.

The graph of ROS nodes runs in lockstep, so the results do not depend on how fast the machine is.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from code_blocks import ROOT, blocks_of, differences, run_page

DOCS = ROOT / "docs"
PAGES = [DOCS / "tutorial.md", *sorted((DOCS / "how-to").glob("*.md"))]
ON_AN_ARM = [DOCS / "real-arm.md", DOCS / "position-drives.md"]
TIMEOUT_S = 900.0

NOT_RUN = {"install.md": 3, "sweep.md": 1}
"""How many blocks of each page are left out; one more is a decision."""


@pytest.mark.timeout(2 * TIMEOUT_S)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_does_what_it_says(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ros_domains: Iterator[int]
) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(next(ros_domains)))
    folder = tmp_path / "page"
    folder.mkdir()
    run_page(page, folder, TIMEOUT_S)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_blocks_that_are_not_run_are_counted(page: Path) -> None:
    left_out = [block for block in blocks_of(page) if block["not_run"]]
    assert len(left_out) == NOT_RUN.get(page.name, 0)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_block_is_a_file_or_of_a_kind_that_is_run(page: Path) -> None:
    for block in blocks_of(page):
        assert block["title"] or block["language"] in ("bash", "python", "output"), block
    fences = sum(line.lstrip().startswith("```") for line in page.read_text().splitlines())
    assert fences == 2 * len(blocks_of(page))  # none is hidden from the test by the way it is written


@pytest.mark.parametrize("page", ON_AN_ARM, ids=lambda page: page.stem)
def test_every_block_for_a_real_arm_says_why_it_is_not_run(page: Path) -> None:
    # A block that is indented instead of fenced could not give a reason.
    assert not any(paragraph.startswith("    ") for paragraph in page.read_text().split("\n\n"))
    assert blocks_of(page)
    assert all(block["not_run"] for block in blocks_of(page))


@pytest.mark.parametrize(
    ("shown", "printed", "alike"),
    [
        ("error 0.0681 rad", "error 0.0684 rad", True),
        ("error 0.0681 rad", "error 0.0881 rad", False),
        ("trial 1 completed", "trial 1 aborted", False),
        ("first\n…\nlast", "first\nsecond\nthird\nlast", True),
        ("first\n…\nlast", "first\nsecond", False),
        ("report  …/report.html", "report  runs/1/report.html", True),
        ("one line", "one line\nand another", False),
        ("3 trials", "4 trials", False),
        ("nothing", "", False),
    ],
)
def test_what_is_shown_is_compared_with_what_is_printed(shown: str, printed: str, alike: bool) -> None:
    assert (differences(shown, printed) == "") is alike
