"""Layouts of Foxglove and PlotJuggler for an exported file, made for the joints of its arm.

Neither program documents the format of its layout files; both were learned from sources.

- Foxglove: the tree of panels and their settings as in Lichtblick, which goes on from the last open version
  of Foxglove Studio (``packages/suite-base/src``: ``types/layouts.ts``, ``panels/Plot/utils/config.ts``,
  ``panels/RawMessages/types.ts``, ``panels/ThreeDeeRender/IRenderer.ts``). The settings have the names that
  ``foxglove.layouts`` of foxglove-sdk 0.30 gives them, too, apart from titles and two of the older program:
  there, the links' axes have ``axisSize`` instead of ``axisScale``, and no grid is ``frameLocked``. Message
  paths: https://docs.foxglove.dev/docs/visualization/message-path-syntax
- PlotJuggler 3: ``plotjuggler_app`` (``mainwindow.cpp``, ``tabbedplotwidget.cpp``, ``plot_docker.cpp``,
  ``plotwidget.cpp``: ``xmlLoadState``). Names of curves: ``/topic/field[0]``, from ``rosx_introspection``.
  What it loads, and with which time: ``plotjuggler_plugins/DataLoadMCAP/dataload_mcap.cpp``.
"""

from __future__ import annotations

from pathlib import Path

from tel_ros.app.templates import template
from tel_ros.core.errors import InputFileError
from tel_ros.recording import topics
from tel_ros.recording.export import added_messages
from tel_ros.recording.export.run_export import Export
from tel_ros.recording.run_folder import write_atomically

FOXGLOVE_LAYOUT = "foxglove_layout.json"
PLOTJUGGLER_LAYOUT = "plotjuggler_layout.xml"

_COLOURS = {
    "desired": "#009e73",
    "actual": "#0072b2",
    "equilibrium": "#8a919c",
    "error": "#a3327a",
    "limit": "#d55e00",
}
"""Visible on a dark and on a light background."""
_CAMERA, _GRID, _LINE, _AXIS = 3.0, 4.0, 0.008, 0.05
"""Distance of the camera, side of the grid, thickness of paths, length of the links' axes, in arm reaches."""
_UNIT_AXIS_M = 0.2
"""Length of an axis of scale 1 (``AXIS_LENGTH`` in ``panels/ThreeDeeRender``)."""


def write_layouts(export: Export) -> tuple[Path, Path]:
    """Write the layouts beside the exported file, and return that of Foxglove and that of PlotJuggler."""
    reach_m = max(export.arm.reach_m, 0.05)
    values = {
        "joints": export.arm.config.joints,
        "root": export.arm.root,
        "file": export.file.name,
        "states": _name_in(export, topics.CONTROL_STATES),
        "result": _name_in(export, topics.TRIAL_RESULT),
        "topics": added_messages,
        "colours": _COLOURS,
        "camera_m": round(_CAMERA * reach_m, 3),
        "grid_m": round(_GRID * reach_m, 3),
        "line_m": round(_LINE * reach_m, 5),
        "axis_m": round(_AXIS * reach_m, 4),
        "axis_scale": round(_AXIS * reach_m / _UNIT_AXIS_M, 3),
    }
    foxglove, plotjuggler = (export.folder / name for name in (FOXGLOVE_LAYOUT, PLOTJUGGLER_LAYOUT))
    for file in (foxglove, plotjuggler):
        try:
            write_atomically(file, template(f"{file.name}.j2").render(values) + "\n")
        except OSError as error:
            raise InputFileError(file, f"cannot be written ({error.strerror})", "room on the disk") from error
    return foxglove, plotjuggler


def _name_in(export: Export, topic: str) -> str:
    return next((name for name in export.counts if topics.is_named(name, topic)), topics.absolute(topic))
