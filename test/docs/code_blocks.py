"""How the fenced code blocks of a page in Markdown are run; sybil finds them.

A block with a title is a file. Blocks of bash and Python run, in their order, in one folder; an ``output``
block says what the one before it prints. ``<!-- not run: REASON -->`` above a block leaves it alone, and
``<!-- given: PATH -->`` copies something of the checkout into the folder first.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from sybil import Document, Example, Region
from sybil.parsers.markdown.lexers import DirectiveInHTMLCommentLexer, RawFencedCodeBlockLexer

ROOT = Path(__file__).parents[2]
_FENCES = RawFencedCodeBlockLexer(re.compile(r"(?P<language>\w*)(?: title=\"(?P<title>[^\"]+)\")?[^\n]*\n"))
_COMMENTS = DirectiveInHTMLCommentLexer("given|not run")
_ANYTHING = "…"


class PageRun:
    """Blocks and comments of a page as sybil's examples: evaluate them in their order.

    Args:
        folder: in which the page runs.
        timeout_s: of one block.
    """

    def __init__(self, folder: Path, timeout_s: float) -> None:
        self._folder, self._timeout_s = folder, timeout_s
        self._printed, self._not_run = "", False

    def __call__(self, document: Document) -> Iterator[Region]:
        """Return everything that is found on a page."""
        for found, evaluate in ((_FENCES(document), self._block), (_COMMENTS(document), self._comment)):
            for region in found:
                yield Region(region.start, region.end, region.lexemes, evaluate)

    def _comment(self, example: Example) -> None:
        if example.parsed["directive"] == "given":
            name = example.parsed["arguments"].strip()
            shutil.copytree(ROOT / name, self._folder / name)
        self._not_run = example.parsed["directive"] == "not run"

    def _block(self, example: Example) -> str:
        block, not_run, self._not_run = example.parsed, self._not_run, False
        if not_run:
            self._printed = ""
        elif block["title"]:
            file = self._folder / block["title"]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block["source"], encoding="utf-8")
        elif block["language"] == "output":
            return differences(block["source"], self._printed)
        else:
            done = run_text(block["language"], block["source"], self._folder, self._timeout_s)
            self._printed = done.stdout
            if done.returncode != 0:
                return f"exit code {done.returncode}\n{done.stdout}{done.stderr[-3000:]}"
        return ""


def blocks_of(page: Path) -> list[dict[str, str]]:
    """Return the blocks of a page: language, title, source, and why it is not run, if it is not."""
    blocks, reason = [], ""
    for example in Document.parse(str(page), PageRun(page.parent, 0.0)).examples():
        if "directive" in example.parsed:
            reason = example.parsed["arguments"] if example.parsed["directive"] == "not run" else ""
        else:
            blocks.append({**example.parsed, "not_run": reason})
            reason = ""
    return blocks


def run_page(page: Path, folder: Path, timeout_s: float) -> None:
    """Do in a folder what a page says; sybil raises where something is not as it says."""
    for example in Document.parse(str(page), PageRun(folder, timeout_s)).examples():
        example.evaluate()


def run_text(language: str, text: str, folder: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """Run a block of bash or Python with the `tel` and the package of this checkout."""
    command = {"bash": ["bash", "-euo", "pipefail", "-c"], "python": [sys.executable, "-c"]}[language]
    environment = {
        **os.environ,
        "PATH": f"{_commands(folder)}:{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": f"{folder}:{ROOT}",
        "COLUMNS": "80",
    }
    return subprocess.run(
        [*command, text], cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout_s
    )


def _commands(folder: Path) -> Path:
    """Return a folder with the command `tel` of this checkout, wherever another one may be installed."""
    commands = folder.parent / f"{folder.name}-commands"
    commands.mkdir(exist_ok=True)
    tel = commands / "tel"
    program = "from tel_ros.app.cli import main\nif __name__ == '__main__':\n    main(prog_name='tel')\n"
    tel.write_text(f"#!{sys.executable}\n{program}")
    tel.chmod(0o755)
    return commands


def differences(shown: str, printed: str) -> str:
    """Return how a page shows something else than what was printed; empty if it does not.

    Lines are compared word by word, numbers within 10 % and half of their last digit, because the last digits
    differ from machine to machine. A line of "…" stands for any lines, "…" in a line for any text.
    """
    expected = [line.split() for line in shown.splitlines() if line.strip()]
    found = [line.split() for line in printed.splitlines() if line.strip()]
    return "" if _match(expected, found) else f"the page shows\n{shown}but what was printed is\n{printed}"


def _match(expected: list[list[str]], found: list[list[str]]) -> bool:
    if not expected:
        return not found
    if expected[0] == [_ANYTHING]:
        return any(_match(expected[1:], found[k:]) for k in range(len(found) + 1))
    return bool(found) and _line_matches(expected[0], found[0]) and _match(expected[1:], found[1:])


def _line_matches(expected: list[str], found: list[str]) -> bool:
    if any(_ANYTHING in word for word in expected):
        pattern = ".*".join(map(re.escape, " ".join(expected).split(_ANYTHING)))
        return re.fullmatch(pattern, " ".join(found)) is not None
    return len(expected) == len(found) and all(map(_word_matches, expected, found))


def _word_matches(expected: str, found: str) -> bool:
    try:
        number, other = float(expected), float(found)
    except ValueError:
        return expected == found
    decimals = len(expected.partition(".")[2])
    return math.isclose(number, other, rel_tol=0.1, abs_tol=0.5 * 10**-decimals)
