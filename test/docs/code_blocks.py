"""The fenced code blocks of a page in Markdown, and how they are run.

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
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]

_BLOCK = re.compile(
    r"^(?:<!-- not run: (?P<reason>[^\n]+?) -->\n)?"
    r"```(?P<language>\w*)(?: title=\"(?P<title>[^\"]+)\")?[^\n]*\n"
    r"(?P<text>.*?)^```$",
    flags=re.DOTALL | re.MULTILINE,
)
_GIVEN = re.compile(r"<!-- given: (\S+) -->")
_ANYTHING = "…"


@dataclass(frozen=True)
class Block:
    """One block: its language, its file name if it is a file, its text, why it is not run if it is not."""

    language: str
    title: str
    text: str
    not_run: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [
        Block(
            found["language"],
            found["title"] or "",
            found["text"],
            found["reason"] or "",
            text.count("\n", 0, found.start()) + 1,
        )
        for found in _BLOCK.finditer(text)
    ]


def given_by(page: Path) -> list[str]:
    return _GIVEN.findall(page.read_text(encoding="utf-8"))


def run_page(page: Path, folder: Path, timeout_s: float) -> list[str]:
    """Do in a folder what a page says; return what is not as it says, one text each."""
    for name in given_by(page):
        shutil.copytree(ROOT / name, folder / name)
    wrong: list[str] = []
    printed = ""
    for block in blocks_of(page):
        where = f"{page.name}:{block.line}"
        if block.not_run:
            printed = ""
        elif block.title:
            file = folder / block.title
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block.text, encoding="utf-8")
        elif block.language == "output":
            wrong += [f"{where}: {text}" for text in differences(block.text, printed)]
        else:
            done = run_text(block.language, block.text, folder, timeout_s)
            printed = done.stdout
            if done.returncode != 0:
                return [*wrong, f"{where}: exit code {done.returncode}\n{done.stdout}{done.stderr[-3000:]}"]
    return wrong


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


def differences(shown: str, printed: str) -> list[str]:
    """Return where a page shows something else than what was printed.

    Lines are compared word by word, numbers within 10 % and half of their last digit, because the last digits
    differ from machine to machine. A line of "…" stands for any lines, "…" in a line for any text.
    """
    expected = [line.split() for line in shown.splitlines() if line.strip()]
    found = [line.split() for line in printed.splitlines() if line.strip()]
    return [] if _match(expected, found) else [f"shows\n{shown}but what was printed is\n{printed}"]


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
