"""Medians over arms with intervals, and whether one method is worse than another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, quantile_test


@dataclass(frozen=True)
class Median:
    """The middle of some values, and the ends of its interval; NaN if there are too few values for one."""

    value: float
    low: float
    high: float


def median(values: Sequence[float]) -> Median:
    """Return the median with its 95 % interval between order statistics.

    The interval is exact whatever the distribution, and holds for values that are inf ("never") as well,
    which a bootstrap of the mean would not survive. It takes at least six values; none may be NaN.
    """
    with np.errstate(invalid="ignore"):  # the middle between inf and inf
        middle = float(np.median(values)) if not np.all(np.isinf(values)) else float(values[0])
    interval = quantile_test(values, p=0.5).confidence_interval(0.95)
    return Median(middle, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Standing:
    """How a method compares with its rivals in one column.

    Args:
        rank: ``first``: none has a lower median; ``tied``: one has, but the sign test over the arms does not
            tell them apart; ``behind``: it does.
        rivals: those with a lower median that are told apart (``behind``), or all that have one (``tied``),
            the lowest first.
    """

    rank: str
    rivals: tuple[str, ...] = ()


def standing(method: str, values: Mapping[str, Sequence[float]]) -> Standing:
    """Return where a method stands among others; less is better. Values: in the order of the arms."""
    own, medians = values[method], {name: median(found).value for name, found in values.items()}
    ahead = sorted((name for name in values if medians[name] < medians[method]), key=medians.__getitem__)
    clearly = tuple(name for name in ahead if is_worse(own, values[name]))
    if clearly:
        return Standing("behind", clearly)
    return Standing("tied", tuple(ahead)) if ahead else Standing("first")


def is_worse(one: Sequence[float], other: Sequence[float]) -> bool:
    """Return whether values are larger than others of the same arms, by a one-sided sign test at 5 %."""
    larger = sum(a > b for a, b in zip(one, other, strict=True))
    smaller = sum(a < b for a, b in zip(one, other, strict=True))
    if larger + smaller == 0:
        return False
    return bool(binomtest(larger, larger + smaller, 0.5, alternative="greater").pvalue < 0.05)
