"""Showing a practice run in the terminal while it goes on."""

from __future__ import annotations

import math
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from tel_interfaces.action import Practice

from tel_ros.core.trial import Outcome


class ProgressView:
    """A line that moves on a terminal; in a log file one line a trial. Use it with ``with``.

    Args:
        console: where to show it.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("starting the nodes", total=1.0)

    def __enter__(self) -> ProgressView:
        """Show the line."""
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the line away."""
        self._progress.stop()

    def update(self, feedback: Practice.Feedback) -> None:
        """Take in a message about the progress of the run."""
        # A strategy that gives reasons decides as it goes: how many trials it will be is a guess.
        about = "~" if feedback.reason else ""
        trial = f"trial {feedback.trial:2d}/{about}{feedback.trials}  α {feedback.alpha:.3f}"
        text = f"{trial}  {feedback.stage:<10}"
        if not math.isnan(feedback.max_error_rad):
            text += f"  error up to {feedback.max_error_rad:.3f} rad"
        self._progress.update(self._task, description=text, completed=feedback.progress)
        for result in feedback.last:
            before, after = feedback.training_rms_rad
            outcome = Outcome(result.outcome).text
            self._console.print(
                f"{trial}  {feedback.duration_s:6.3f} s  error {result.rms_error_rad:.4f} rad RMS, "
                f"{result.max_error_rad:.3f} max  training {before:.4f} → {after:.4f}  {outcome}"
                f"{f' ({feedback.reason})' if feedback.reason else ''}"
                f"{self._time_left()}",
                highlight=False,
                soft_wrap=True,
            )
            if result.timing_warning:
                self._console.print(
                    f"{trial}  {result.timing_warning}", highlight=False, soft_wrap=True, markup=False
                )

    def _time_left(self) -> str:
        left_s = self._progress.tasks[0].time_remaining
        return "" if left_s is None else f"  about {left_s:.0f} s left"
