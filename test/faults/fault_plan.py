"""The faults of a campaign, drawn from a seed, and how they are shared out among graphs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from fault_kinds import KINDS
from fault_messages import Parameters
from fault_setups import SETUPS

_END_SHARE = 0.3
"""Of all faults that end a run: each of these costs a graph that has to come up."""


@dataclass(frozen=True)
class Fault:
    """One fault of a campaign, reproducible from its fields; so long after the first tick of a trial."""

    index: int
    kind: str
    setup: str
    offset_s: float
    parameters: Parameters = field(default_factory=dict)


def plan(n: int, seed: int, kinds: Sequence[str] = (), setups: Sequence[str] = ()) -> list[Fault]:
    """Draw a campaign: the same faults for the same arguments.

    Every kind (of these, if any are named) comes first once, as far as ``n`` goes; then they are drawn by
    weight.
    """
    rng = np.random.default_rng(seed)
    graphs = tuple(setups) or tuple(SETUPS)
    pool = [k for k in KINDS.values() if (not kinds or k.name in kinds) and set(k.setups) & set(graphs)]
    ending = np.array([kind.ends_run for kind in pool])
    weights = np.array([kind.weight for kind in pool])
    for group, share in ((ending, _END_SHARE), (~ending, 1.0 - _END_SHARE)):
        if group.any():
            weights[group] *= share / weights[group].sum()
    order = list(rng.permutation(len(pool)))
    faults = []
    for index in range(1, n + 1):
        k = order.pop() if order else rng.choice(len(pool), p=weights / weights.sum())
        kind = pool[int(k)]
        names = [name for name in graphs if name in kind.setups]
        share = np.array([SETUPS[name].weight for name in names])
        setup = str(rng.choice(names, p=share / share.sum()))
        offset_s = round(float(rng.uniform(*(kind.window_s or (0.0, 0.0)))), 3)
        faults.append(Fault(index, kind.name, setup, offset_s, kind.draw(rng)))
    return faults


def batches(faults: Sequence[Fault], longest: int = 10) -> list[list[Fault]]:
    """Share faults out among graphs: some that a run survives, then one that ends it.

    One that is there from the start comes first; the others get another graph.
    """
    shared: list[list[Fault]] = []
    for setup in dict.fromkeys(fault.setup for fault in faults):
        ours = [fault for fault in faults if fault.setup == setup]
        ends = [fault for fault in ours if KINDS[fault.kind].ends_run]
        rides = [fault for fault in ours if not KINDS[fault.kind].ends_run]
        n_graphs = max(len(ends), -(-len(rides) // (longest - 1)), 1)
        parts = [rides[k::n_graphs] for k in range(n_graphs)]
        for k, end in enumerate(ends):
            parts[k].insert(len(parts[k]) if KINDS[end.kind].window_s else 0, end)
        shared += [part for part in parts if part]
    return shared
