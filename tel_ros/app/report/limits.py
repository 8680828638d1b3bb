"""How near a movement comes to the limits of the arm, and which joint limits it where."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tel_ros.app.fastest import by_run, limited_by
from tel_ros.app.plotting import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIMIT,
    ORANGE,
    PURPLE,
    SOFT,
    WIDTH_IN,
    key,
    legend_below,
)
from tel_ros.app.report.data import DrawnTrial, RunData
from tel_ros.app.report.page import Content, block
from tel_ros.app.report.text import seconds, significant, trial_label
from tel_ros.core.errors import TelError
from tel_ros.core.practice.fastest import AT_THE_LIMIT
from tel_ros.core.practice.learned_timings import VELOCITY_SHARE
from tel_ros.core.types import FloatArray

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK, SOFT, GREY)


def limits(run: RunData) -> Content | None:
    """The last trial that can be drawn, of a run that was to be as fast as the arm can; None for others."""
    if not (run.config.practice.is_fastest and run.drawn):
        return None
    trial = run.drawn[-1]
    rows = limited_by(run.config, *_efforts_and_velocities(trial))
    caption = (
        f"{trial_label(trial.summary)}, {seconds(trial.summary.duration_s)}: commanded torque and desired "
        "velocity of each joint as shares of their limits, over the share of the way through joint space; "
        "dashed: what the movement may use. The strips show which joint uses all of that, and where. "
    )
    caption += _against_bound(run, trial)
    return Content(limits_figure(run, trial), caption, block("run.html.j2", "limits", rows=rows))


def _against_bound(run: RunData, trial: DrawnTrial) -> str:
    """Say how long the movement takes beside what the network, as it is now, believes possible."""
    try:
        found = by_run(run.folder, trial.summary.path or "")
        told = [(share, found.fastest(share).duration_s) for share in found.shares]
    except TelError as error:
        return f"How fast the arm could be is not known: {error}."
    times = " and ".join(
        f"{significant(duration_s)} s with {100 * share:g} % of the torques (it takes "
        f"{significant(trial.summary.duration_s / duration_s)} times as long)"
        for share, duration_s in told
    )
    return f"By what was learned the arm could do it in {times}."


def _efforts_and_velocities(trial: DrawnTrial) -> tuple[FloatArray, FloatArray]:
    recorded, n_joints = trial.recorded, len(trial.recorded.joints)
    return recorded.effort_nm[recorded.run], recorded.desired[recorded.run, n_joints : 2 * n_joints]


def limits_figure(run: RunData, trial: DrawnTrial) -> Figure:
    """Return shares of the limits of effort and velocity along the path, each above its strip."""
    arm, (effort_nm, velocity_rad_s) = run.config.arm, _efforts_and_velocities(trial)
    way = np.cumsum(np.linalg.norm(velocity_rad_s, axis=1))
    way = 100.0 * way / max(float(way[-1]), 1e-12)
    figure = Figure(figsize=(WIDTH_IN, 3.1), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True, height_ratios=(8, 1), squeeze=False)
    for column, (name, values, limit, most) in enumerate(
        (
            ("torque", effort_nm, arm.effort_limit_nm, run.config.practice.effort_share),
            ("velocity", velocity_rad_s, arm.velocity_limit_rad_s, VELOCITY_SHARE),
        )
    ):
        shares, (axes, strip) = np.abs(values) / np.array(limit), grid[:, column]
        for j, share in enumerate(shares.T):
            axes.plot(way, 100.0 * share, color=_COLOURS[j % len(_COLOURS)], linewidth=0.9)
            at_limit = share >= AT_THE_LIMIT * most
            strip.fill_between(
                way, 0.0, 1.0, where=at_limit, color=_COLOURS[j % len(_COLOURS)], linewidth=0.0
            )
        axes.axhline(100.0 * most, **LIMIT)
        axes.set(title=f"{name} [% of its limit]", ylim=(0.0, 105.0))
        strip.set(xlabel="share of the way [%]", ylim=(0.0, 1.0), xlim=(0.0, 100.0), yticks=[])
    handles = [key(j, color=_COLOURS[k % len(_COLOURS)]) for k, j in enumerate(arm.joints)]
    legend_below(figure, handles)
    return figure
