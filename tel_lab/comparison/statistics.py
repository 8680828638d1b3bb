"""Medians over arms with intervals, and whether one method is worse than another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, quantile_test

CONFIDENCE = 0.95
_SIGNIFICANT = 0.05


@dataclass(frozen=True)
class Median:
    """The middle of some values.

    Args:
        value: the median.
        low: lower end of its interval; NaN if there are too few values for one.
        high: upper end.
    """

    value: float
    low: float
    high: float


def median(values: Sequence[float]) -> Median:
    """Return the median with its 95 % interval between order statistics.

    The interval is exact whatever the distribution, and holds for values that are inf ("never") as well,
    which a bootstrap of the mean would not survive. It takes at least six values.

    Args:
        values: at least one; inf is allowed, NaN is not.
    """
    with np.errstate(invalid="ignore"):  # the middle between inf and inf
        middle = float(np.median(values)) if not np.all(np.isinf(values)) else float(values[0])
    interval = quantile_test(values, p=0.5).confidence_interval(CONFIDENCE)
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
    """Return where a method stands among others that went through the same arms; less is better.

    Args:
        method: one of the keys.
        values: of each method, in the order of the arms; none is NaN.
    """
    own = values[method]
    ahead = [
        name for name, other in values.items() if name != method and median(other).value < median(own).value
    ]
    ahead.sort(key=lambda name: median(values[name]).value)
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
    return bool(binomtest(larger, larger + smaller, 0.5, alternative="greater").pvalue < _SIGNIFICANT)
