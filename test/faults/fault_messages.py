"""What faults do to the messages of a channel, and how their parameters are drawn."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from fault_setups import RATE_HZ
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tel_ros.core.types import NS_PER_S
from tel_ros.nodes.conversions import time_ns, to_time

Parameters = dict[str, Any]
Draw = Callable[[np.random.Generator], Parameters]
Message = JointState | Float64MultiArray
Passed = list[tuple[float, Message]]
"""Messages with the delay in s that each of them gets."""
Corruption = Callable[[Message], Passed]
"""Gets every message while a fault lasts, may change it in place, and returns what is passed on."""


_PERIOD_S = 1.0 / RATE_HZ


def draw_lasting(duration_s: float) -> Draw:
    return lambda rng: {"duration_s": duration_s}


def draw_evenly(name: str, low: float, high: float, digits: int = 3, **fixed: float) -> Draw:
    return lambda rng: {**fixed, name: round(float(rng.uniform(low, high)), digits)}


def draw_brief_or_long(rng: np.random.Generator) -> Parameters:
    """One message, some, or a second of them."""
    duration_s = float(rng.choice([_PERIOD_S, 5 * _PERIOD_S, 0.5, 1.0]))
    return {"duration_s": duration_s, "joint": int(rng.integers(2))}


def draw_huge(rng: np.random.Generator) -> Parameters:
    field = str(rng.choice(["position", "velocity"]))
    where = {"duration_s": float(rng.choice([1, 3])) * _PERIOD_S, "joint": int(rng.integers(2))}
    value = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(2.0, 12.0))
    return {**where, "field": field, "value": value}


def draw_huge_effort(rng: np.random.Generator) -> Parameters:
    value = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(3.0, 12.0))
    duration_s = float(rng.integers(1, 6)) * _PERIOD_S
    return {"duration_s": duration_s, "joint": int(rng.integers(2)), "value": value}


def draw_jump(sign: float) -> Draw:
    def draw(rng: np.random.Generator) -> Parameters:
        shift_s = sign * round(float(np.exp(rng.uniform(np.log(0.15), np.log(3600.0)))), 3)
        return {"duration_s": float(rng.choice([_PERIOD_S, 0.2, 0.5])), "shift_s": shift_s}

    return draw


def draw_drop(rng: np.random.Generator) -> Parameters:
    share = round(float(rng.uniform(0.2, 0.6)), 2)
    return {"duration_s": 1.0, "share": share, "seed": int(rng.integers(2**31))}


def draw_stutter(rng: np.random.Generator) -> Parameters:
    return {"duration_s": 1.0, "every": int(rng.integers(5, 24))}


FOR_GOOD_S = 3600.0
WHOLE = ("position", "velocity")


def draw_frozen(rng: np.random.Generator) -> Parameters:
    fields, n = [(WHOLE, None), (WHOLE, 0), (WHOLE, 1), (WHOLE[:1], None), (WHOLE[1:], None)], rng.integers(5)
    return {"duration_s": FOR_GOOD_S, "fields": list(fields[n][0]), "joint": fields[n][1]}


def draw_wiring(rng: np.random.Generator) -> Parameters:
    wrong = str(rng.choice(["flipped", "swapped", "degrees"]))
    return {"duration_s": FOR_GOOD_S, "wrong": wrong, "joint": int(rng.integers(2))}


def overwritten(field: str, joint: int, value: float) -> Corruption:
    """Write a value over one joint's number in a field: ``position``, ``velocity`` or ``data``."""

    def corrupt(message: Message) -> Passed:
        getattr(message, field)[joint] = value
        return [(0.0, message)]

    return corrupt


def shortened(fields: Sequence[str], joint: int = -1) -> Corruption:
    """Take the last joint out of some fields, whichever was drawn."""

    def corrupt(message: Message) -> Passed:
        for field in fields:
            setattr(message, field, getattr(message, field)[:-1])
        return [(0.0, message)]

    return corrupt


def reordered() -> Corruption:
    """Let every second message be overtaken by the next."""
    held: list[Message] = []

    def corrupt(message: Message) -> Passed:
        if not held:
            held.append(message)
            return []
        return [(0.0, message), (0.0, held.pop())]

    return corrupt


def delayed(delay_s: float) -> Corruption:
    return lambda message: [(delay_s, message)]


def dropped(share: float, seed: int = 0) -> Corruption:
    """Lose a share of the messages; 1 loses all of them."""
    rng = np.random.default_rng(seed)
    return lambda message: [] if rng.random() < share else [(0.0, message)]


def thinned(every: int) -> Corruption:
    """Pass only every n-th message on, as a computer does that keeps standing still."""
    numbers = itertools.count(1)
    return lambda message: [] if next(numbers) % every else [(0.0, message)]


def stood(fields: Sequence[str], joint: int | None) -> Corruption:
    """Keep what fields of one joint, or of all, said first; stamps go on."""
    first: dict[str, list[float]] = {}

    def corrupt(message: Message) -> Passed:
        for field in fields:
            told = getattr(message, field)
            kept = first.setdefault(field, list(told))
            for j in range(len(told)) if joint is None else [joint]:
                told[j] = kept[j]
        return [(0.0, message)]

    return corrupt


def rewired(wrong: str, joint: int) -> Corruption:
    """Tell a joint with the other sign or in degrees, or exchange the first two."""

    def corrupt(message: Message) -> Passed:
        for field in WHOLE:
            told = getattr(message, field)
            if wrong == "swapped":
                told[0], told[1] = told[1], told[0]
            else:
                told[joint] *= -1.0 if wrong == "flipped" else 180.0 / np.pi
        return [(0.0, message)]

    return corrupt


def limited(most_nm: float) -> Corruption:
    """Let no joint get more than so much."""

    def corrupt(message: Message) -> Passed:
        message.data = np.clip(message.data, -most_nm, most_nm).tolist()
        return [(0.0, message)]

    return corrupt


def repeated() -> Corruption:
    """Repeat the first message."""
    first: list[Message] = []

    def corrupt(message: Message) -> Passed:
        first.append(message)
        return [(0.0, first[0])]

    return corrupt


def shifted(shift_s: float) -> Corruption:
    """Move the stamps, not below zero: the clock that makes them is wrong."""
    shift_ns = round(shift_s * NS_PER_S)

    def corrupt(message: Message) -> Passed:
        message.header.stamp = to_time(max(0, time_ns(message.header.stamp) + shift_ns))
        return [(0.0, message)]

    return corrupt
