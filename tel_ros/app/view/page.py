"""The page: the arm in 3D, plots, a table and buttons."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
import yourdfpy
from viser import uplot
from viser.extras import ViserUrdf

from tel_ros.app.plane import Viewpoint
from tel_ros.app.view import ViewError
from tel_ros.app.view.live_trial import History, LiveTrial, magnitude, round_up
from tel_ros.app.view.words import status_html, trials_html
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import InputFileError
from tel_ros.core.plain_urdf import plain_urdf
from tel_ros.core.types import FloatArray
from tel_ros.recording.urdf import described, mesh_file

if TYPE_CHECKING:
    from tel_interfaces.action import Practice

    from tel_ros.app.view.graph import GraphView

_COLOURS = ("#1f6fb4", "#d9661f", "#2b8a3e", "#9c36b5", "#c92a2a", "#0b7285", "#846358")
_GREY, _DESIRED, _ACTUAL = (150, 150, 150), (40, 40, 40), (31, 111, 180)
_OLDEST, _YOUNGEST = np.array([252, 220, 190]), np.array([217, 102, 31])
_GHOST = (0.35, 0.75, 0.45, 0.35)
_ROOM = 1.2
"""Range of a plot over its last label, so that the label is not cut off."""
_INSET = "padding:0 10px"
"""viser leaves no room beside HTML."""
_NOTHING: FloatArray = np.zeros((1, 2, 3), dtype=np.float32)
"""Browsers draw nothing from an empty array, and this as nothing."""


class Page:
    """What every browser sees that has the page open; ViewError if the URDF cannot be drawn."""

    def __init__(
        self, server: viser.ViserServer, arm: ArmConfig, view: Viewpoint, controls: GraphView
    ) -> None:
        self._server, self._controls = server, controls
        self._joints = [re.sub(r"[^\w .-]", "?", joint) for joint in arm.joints]  # names from a file
        self._effort_limit_nm = arm.effort_limit_nm
        self._prepare_scene(view)
        self._arm, self._ghost = self._robots(arm)
        names = list(self._arm.get_actuated_joint_names())
        self._places, self._posture = [names.index(joint) for joint in arm.joints], np.zeros(len(names))
        self._equilibrium = self._line("equilibrium", _GREY, 2.0)
        self._desired = self._line("desired", _DESIRED, 1.5)
        self._actual = self._line("actual", _ACTUAL, 4.0)
        self._earlier: list[Any] = []
        self._buttons_and_words()
        self._plots = self._make_plots()
        self._ranges: dict[str, tuple[float, float]] = {}
        self._said = self._tabled = ""

    def show_arm(self, position_rad: FloatArray, ghost: bool = False) -> None:
        """Show the arm, or where it should be, at positions of shape (n_joints,)."""
        self._posture[self._places] = position_rad
        (self._ghost if ghost else self._arm).update_cfg(self._posture)

    def show_ghost(self, position_rad: FloatArray) -> None:
        """Show where the arm should be; with an empty array, nothing."""
        self._ghost_frame.visible = bool(len(position_rad))
        if len(position_rad):
            self.show_arm(position_rad, ghost=True)

    def show_plan(self, trial: LiveTrial) -> None:
        """Show what a trial is to do, once, when it begins."""
        self._desired.points = segments(trial.desired_m)[::2]  # dashed
        self._equilibrium.points = segments(trial.equilibrium_m)
        self._actual.points = _NOTHING
        self._ranges.clear()

    def show_progress(self, trial: LiveTrial) -> None:
        """Show what a trial has done so far."""
        self._actual.points = segments(trial.hand_m)
        time_s = trial.error_rad.time_s
        band = [column for std in trial.std_rad.T for column in (2.0 * std, -2.0 * std)]
        self._plot("error", time_s, *(1e3 * values for values in (*trial.error_rad.values.T, *band)))
        self._plot("speed", time_s, *trial.speed_rad_s.values.T, *trial.desired_speed_rad_s.T)
        full = np.full_like(time_s, 100.0)
        self._plot("effort", time_s, *(100.0 * trial.effort_share.values.T), full, -full)

    def show_history(self, history: History) -> None:
        """Show the trials that have ended: a table, and their paths, older ones paler."""
        table = trials_html(history.trials, self._effort_limit_nm)
        if table == self._tabled:
            return
        self._tabled = table
        self._table.content = _inset(table)
        for line in self._earlier:
            line.remove()
        self._earlier = []
        for place, (index, hand_m) in enumerate(history.paths):
            share = (place + 1) / len(history.paths)
            colour = tuple(int(c) for c in _OLDEST + share * (_YOUNGEST - _OLDEST))
            self._earlier.append(self._line(f"trial_{index}", colour, 2.0, segments(hand_m)))

    def show_status(self, graph: GraphView, said: Practice.Feedback) -> None:
        """Show the status in words, and enable the buttons that make sense."""
        self._bar.value = 100.0 * said.progress
        text = status_html(graph, said)
        if text == self._said:
            return
        self._said = text
        self._words.content = _inset(text)
        self._reset.disabled = not graph.stopped
        self._pause.visible, self._go_on.visible = not graph.paused, graph.paused

    def _plot(self, name: str, time_s: FloatArray, *series: FloatArray) -> None:
        """Plot series over time, NaN where nothing is known yet; with NaN, uPlot finds no ranges."""
        ends = (float(time_s[-1]), _ROOM * round_up(max(magnitude(values) for values in series)))
        if self._ranges.get(name) != ends:
            self._ranges[name] = ends
            self._plots[name].scales = _scales(*ends)
        self._plots[name].data = (time_s, *series)

    def _prepare_scene(self, view: Viewpoint) -> None:
        server = self._server
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=_ACTUAL
        )
        # Without a graphics card, a browser would spend most of its time on reflections and shadows.
        server.scene.configure_environment_map(hdri=None)
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_light_ambient("/light/everywhere", intensity=4.0)
        position = tuple(view.position_m)
        server.scene.add_light_directional("/light/from_camera", intensity=3.0, position=position)
        server.scene.add_grid(
            "/grid", width=4.0 * view.size_m, height=4.0 * view.size_m, cell_size=view.size_m / 5.0,
            section_size=view.size_m, position=(0.0, 0.0, -0.1 * view.size_m),
        )  # fmt: skip
        server.scene.set_up_direction(tuple(view.up))
        camera = server.initial_camera
        camera.position, camera.look_at, camera.up = position, tuple(view.target_m), tuple(view.up)

    def _robots(self, arm: ArmConfig) -> tuple[ViserUrdf, ViserUrdf]:
        try:
            text = plain_urdf(described(arm), mesh=partial(mesh_file, Path(arm.urdf)))
            urdf = yourdfpy.URDF.load(
                io.BytesIO(text.encode()), filename_handler=str, build_collision_scene_graph=False
            )
            self._server.scene.add_frame("/arm", show_axes=False)
            self._ghost_frame = self._server.scene.add_frame("/ghost", show_axes=False, visible=False)
            drawn = ViserUrdf(self._server, urdf, root_node_name="/arm")
            return drawn, ViserUrdf(self._server, urdf, root_node_name="/ghost", mesh_color_override=_GHOST)
        except InputFileError:
            raise
        except Exception as error:  # its mesh readers raise anything
            raise ViewError(f"{arm.urdf} cannot be drawn: {error!r}") from error

    def _line(self, name: str, colour: tuple[int, ...], width: float, points: FloatArray = _NOTHING) -> Any:
        return self._server.scene.add_line_segments(
            f"/paths/{name}", points, colour,
            thickness=width, thickness_units="screen",
        )  # fmt: skip

    def _buttons_and_words(self) -> None:
        gui, controls = self._server.gui, self._controls

        def button(label: str, action: Callable[[], None], **look: Any) -> Any:
            made = gui.add_button(label, **look)
            made.on_click(lambda _: action())
            return made

        button("EMERGENCY STOP", controls.emergency_stop, color="red", icon=viser.Icon.ALERT_OCTAGON)
        self._words = gui.add_html("")
        self._bar = gui.add_progress_bar(0.0)
        pause, go_on = partial(controls.pause, True), partial(controls.pause, False)
        self._pause = button("Pause after this trial", pause, icon=viser.Icon.PLAYER_PAUSE)
        self._go_on = button("Go on", go_on, visible=False, icon=viser.Icon.PLAYER_PLAY)
        button("Stop the run", controls.end_run, color="gray", icon=viser.Icon.PLAYER_STOP)
        self._reset = button("Reset the emergency stop", controls.reset, color="gray", disabled=True)
        gui.add_html(
            f'<div style="font-size:12px;color:#777;{_INSET}">The buttons need this computer, the network and'
            " ep_controller to be well. They are no emergency stop by wire.</div>"
        )

    def _make_plots(self) -> dict[str, Any]:
        n, gui = len(self._joints), self._server.gui
        colours = [_COLOURS[k % len(_COLOURS)] for k in range(n)]
        joints = list(zip(self._joints, colours, strict=True))
        solid = [uplot.Series(label=joint, stroke=colour, width=1.5) for joint, colour in joints]
        faint = [uplot.Series(show=True, stroke="transparent", width=0) for _ in range(2 * n)]
        dashed = [uplot.Series(stroke=colour, width=1, dash=(6, 4)) for colour in colours]
        limit = [uplot.Series(stroke="#c92a2a", width=1, dash=(6, 4))] * 2
        bands = tuple(
            uplot.Band(series=(1 + n + 2 * k, 2 + n + 2 * k), fill=f"{colours[k]}22") for k in range(n)
        )
        made = {}
        for name, title, series, extra in (
            ("error", "error [mrad], band: ±2 σ expected of the command", [*solid, *faint], bands),
            ("speed", "speed [rad/s], dashed: desired", [*solid, *dashed], None),
            ("effort", "torque [% of its limit]", [*solid, *limit], None),
        ):
            made[name] = gui.add_uplot(
                tuple(np.array([0.0, 1.0]) if k == 0 else np.full(2, np.nan) for k in range(1 + len(series))),
                (uplot.Series(label="t [s]"), *series), bands=extra, title=title, scales=_scales(1.0, _ROOM),
                legend=uplot.Legend(show=False), aspect=3.2,
                axes=(uplot.Axis(size=34), uplot.Axis(size=56, space=16)),  # px: room for three labels
            )  # fmt: skip
        key = " ".join(f'<span style="color:{c};font-weight:700">{j}</span>' for j, c in joints)
        gui.add_html(
            f'<div style="font-size:12px;{_INSET}">{key}<br>hand: <b style="color:#1f6fb4">this trial</b>, '
            '<b style="color:#d9661f">earlier ones</b>, dashed: desired, <b style="color:#888">grey: EP</b>'
            "</div>"
        )
        self._table = gui.add_html("")
        return made


def _inset(html: str) -> str:
    return f'<div style="{_INSET}">{html}</div>'


def segments(points_m: FloatArray) -> FloatArray:
    """Return the segments between points (n, 3), none at NaN. Shape (n_segments, 2, 3), at least one."""
    segments: Any = np.stack([points_m[:-1], points_m[1:]], axis=1).astype(np.float32)
    segments = segments[np.isfinite(segments).all(axis=(1, 2))]
    return segments if len(segments) else _NOTHING


def _scales(end_s: float, most: float) -> dict[str, uplot.Scale]:
    return {
        "x": uplot.Scale(time=False, auto=False, range=(0.0, end_s)),
        "y": uplot.Scale(auto=False, range=(-most, most)),
    }
