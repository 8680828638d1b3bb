"""The path of the hand in one trial after the other, to step through on the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tel_ros.app.report_data import DrawnTrial
from tel_ros.core.kinematics import SerialChain
from tel_ros.core.types import FloatArray

MOST_STEPS = 16
_POINTS = 400
"""Of a curve: what a screen shows."""


@dataclass(frozen=True)
class Step:
    """One trial.

    Args:
        trial: its index.
        svg: the element to put into the page.
    """

    trial: int
    svg: str


def path_steps(trials: Sequence[DrawnTrial], chain: SerialChain) -> list[Step]:
    """Draw the path of the hand in each trial, all in one frame; nothing for a single trial."""
    if len(trials) < 2:
        return []
    from markupsafe import Markup

    from tel_ros.app.figure_export import figure_style, inline_svg
    from tel_ros.app.figures import path_panels, path_pictures

    panels, _, labels = path_panels(trials, chain)
    thinned = [
        replace(
            panel,
            desired_m=_thinned(panel.desired_m),
            actual_m=_thinned(panel.actual_m),
            equilibrium_m=_thinned(panel.equilibrium_m),
        )
        for panel in panels
    ]
    with figure_style("steps"):
        return [
            Step(trial.summary.index, Markup(inline_svg(figure, f"step-{trial.summary.index}")))
            for trial, figure in zip(trials, path_pictures(thinned, labels), strict=True)
        ]


def _thinned(points_m: FloatArray) -> FloatArray:
    rows = np.unique(np.linspace(0, len(points_m) - 1, _POINTS).round().astype(int))
    thinned: FloatArray = points_m[rows]
    return thinned
