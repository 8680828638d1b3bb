"""Practice of several paths: a strategy for each, and one network that learns all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tel_ros.core.config import Config
from tel_ros.core.practice.strategy import Ending, Forecaster, Movement, PlannedTrial, Strategy
from tel_ros.core.trial import Outcome, TrialReport


@dataclass
class _Practised:
    """A path under practice; plan and report are numbered by its own strategy."""

    strategy: Strategy
    plan: PlannedTrial | None = None
    report: TrialReport | None = None
    """Of the last trial."""
    at: int = 0
    """The run's number of that trial."""
    ending: Ending | None = None
    """How the strategy has ended; None: it goes on."""


class Library:
    """Gives each path a strategy of its own and asks them by turns.

    A path that has come within the tolerance is tried again if the network has gone on learning others since;
    if it has forgotten, practice of that path goes on. So at the end one network knows all of them.

    After an abort practice goes back to the network of the last completed trial of any path, and not, as with
    one path, to that of an earlier movement: what was learned of the others stays.
    """

    def __init__(self, config: Config, make: Callable[[Config], Strategy]) -> None:
        self._practice = config.practice
        self._paths = {name: _Practised(make(config)) for name in config.path.names}
        self._current = ""
        self._index = self._completed = 0
        self._learning_until = 0
        """The last trial that may have changed what the network knows of other paths."""
        self._tries_left = config.practice.trials
        """How often a path may be tried again."""

    def preview(self) -> Sequence[Movement]:
        """Return the movements still to come, as far as the strategies know now."""
        going = {name: path for name, path in self._paths.items() if path.ending is None}
        return [replace(m, path=name) for name, path in going.items() for m in path.strategy.preview()]

    def movements_to_cover(self) -> Sequence[Movement]:
        """Return those of all paths."""
        return [
            replace(m, path=name)
            for name, path in self._paths.items()
            for m in path.strategy.movements_to_cover()
        ]

    def fastest_movements(self) -> Sequence[Movement]:
        """Return those of all paths."""
        return [
            replace(m, path=name)
            for name, path in self._paths.items()
            for m in path.strategy.fastest_movements()
        ]

    def next(self, last: TrialReport | None, forecast: Forecaster) -> PlannedTrial | Ending:
        """Return the next trial, or the end of practice and its reason."""
        if last is not None:
            path = self._paths[self._current]
            assert path.plan is not None  # it has been executed
            path.report, path.at = replace(last, index=path.plan.index), last.index
            path.ending = None
            if last.outcome == Outcome.CANCELLED:
                return Ending("cancelled", "the run was cancelled")
            if last.outcome == Outcome.COMPLETED:
                self._completed = last.index
        while name := self._whose_turn():
            decision = self._asked(name, forecast)
            if isinstance(decision, PlannedTrial):
                return self._planned(name, decision)
            if decision.outcome == "aborted":
                return Ending("aborted", self._said())
        outcomes = {path.ending.outcome for path in self._paths.values() if path.ending}
        return Ending("stopped" if "stopped" in outcomes else "completed", self._said())

    def _whose_turn(self) -> str:
        """Return the path to go on with, the one that has waited longest; empty: none is left."""
        going = [name for name, path in self._paths.items() if path.ending is None]
        if not going and self._tries_left:
            going = [
                name
                for name, path in self._paths.items()
                if self._is_reached(path) and path.at < self._learning_until
            ]
        return min(going, key=lambda name: self._paths[name].at, default="")

    def _asked(self, name: str, forecast: Forecaster) -> PlannedTrial | Ending:
        path = self._paths[name]
        if path.ending is not None:
            assert path.plan is not None  # it was reached
            self._tries_left -= 1
            return replace(path.plan, go_back_to=None, reason="once more: others were practised since")
        decision = path.strategy.next(path.report, lambda movement: forecast(replace(movement, path=name)))
        if isinstance(decision, Ending):
            path.ending = decision
        if not self._is_reached(path):
            self._learning_until = max(self._learning_until, path.at)
        return decision

    def _planned(self, name: str, plan: PlannedTrial) -> PlannedTrial:
        self._current, self._index = name, self._index + 1
        self._paths[name].plan = plan
        return replace(
            plan,
            index=self._index,
            movement=replace(plan.movement, path=name),
            go_back_to=None if plan.go_back_to is None else self._completed,
            reason=f"{name}, {plan.index}: {plan.reason}".removesuffix(": "),
        )

    def _is_reached(self, path: _Practised) -> bool:
        """Return whether a path was practised to its goal, and its last trial was within the tolerance."""
        is_over = path.ending is not None and path.ending.outcome == "completed"
        return (
            is_over and path.report is not None and path.report.rms_error_rad <= self._practice.tolerance_rad
        )

    def _said(self) -> str:
        """Say of each path how its practice ended."""
        return "; ".join(f"{name}: {self._end_of(path)}" for name, path in self._paths.items())

    def _end_of(self, path: _Practised) -> str:
        if path.ending is None:
            return "not practised to its end"
        words = [path.ending.message or path.ending.outcome]
        if path.ending.outcome == "completed" and path.report is not None:
            error_mrad, most_mrad = 1e3 * path.report.rms_error_rad, 1e3 * self._practice.tolerance_rad
            if not path.ending.message:
                words = [f"{error_mrad:.2f} mrad RMS in the end"]
            if not self._is_reached(path):
                words.append(f"more than {most_mrad:g} mrad")
            elif path.at < self._learning_until:
                words.append("others were practised since")
        return ", ".join(words)
