"""One kind of fault: what it does, where, how often, and what is right after it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import fault_messages as m
from fault_judge import Expectation
from fault_setups import SETUPS, TRIAL_S

if TYPE_CHECKING:
    from fault_graph import FaultGraph

Act = Callable[["FaultGraph", m.Parameters], None]
IN_BETWEEN = tuple(name for name, setup in SETUPS.items() if setup.in_between)
GUARDED = tuple(name for name in IN_BETWEEN if SETUPS[name].guarded)


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Args:
        name: as in results; what begins with ``state_`` or ``command_`` disturbs that channel.
        what: what is done, for the page.
        right: what is right then, and why, for the page.
        draw: makes the parameters of one fault.
        expects: what is right, for all parameters or as a function of them.
        says: what has to be said, as a regular expression, if the trial is not completed.
        change: makes what happens to the messages of the channel, from all parameters but the duration.
        act: injects a fault that does not change messages.
        setups: names of the graphs that it is injected into.
        codes: with what ``tel practice`` may exit; empty if the run survives.
        weight: how often it is drawn.
        window_s: when in a trial it is injected; None: before the first one, as the graph comes up.
    """

    name: str
    what: str
    right: str
    draw: m.Draw
    expects: Expectation | Callable[[m.Parameters], Expectation]
    says: str
    change: Callable[..., m.Corruption] | None = None
    act: Act | None = None
    setups: tuple[str, ...] = IN_BETWEEN
    codes: tuple[int, ...] = ()
    weight: float = 1.0
    window_s: tuple[float, float] | None = (0.05, TRIAL_S - 0.3)

    @property
    def ends_run(self) -> bool:
        return bool(self.codes)

    def expectation(self, parameters: m.Parameters) -> Expectation:
        return self.expects(parameters) if callable(self.expects) else self.expects

    def corruption(self, parameters: m.Parameters) -> m.Corruption | None:
        """Return what happens to messages, if anything does."""
        values = {name: value for name, value in parameters.items() if name != "duration_s"}
        return self.change(**values) if self.change else None

    def inject(self, graph: FaultGraph, parameters: m.Parameters) -> None:
        corruption = self.corruption(parameters)
        if corruption:
            channel = "states" if self.name.startswith("state_") else "commands"
            graph.tap.corrupt(channel, corruption, parameters["duration_s"])
        elif self.act:
            self.act(graph, parameters)
