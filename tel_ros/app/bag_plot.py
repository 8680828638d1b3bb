"""``tel bag plot``: from a bag to a file with a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from tel_ros.app.bag_text import trial_text
from tel_ros.app.report_text import seconds
from tel_ros.core.errors import BagError, InputFileError, TelError
from tel_ros.recording.bag_inspection import InspectedBag, inspect_bag
from tel_ros.recording.config_file import config_from
from tel_ros.recording.joint_states import read_joint_states
from tel_ros.recording.run_folder import write_atomically
from tel_ros.recording.trial_bag import RecordedTrial, read_trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf", ".html")
_PAGE = "bag_plot.html.j2"


def plot_bag(bag: Path, out: Path, topic: str = "") -> str:
    """Write the figure of a bag.

    Args:
        bag: of a trial, or any with joint states.
        out: the file; its ending says which format.
        topic: of joint states to draw, even from a bag of a trial; empty: the trial, or the only topic.

    Returns:
        What there is to say about the figure; mostly nothing.

    Raises:
        BagError: the bag cannot be read, or has nothing to draw.
        InputFileError: the format is unknown, or the file cannot be written.
        TelError: a library that figures need is not installed.
    """
    if out.suffix not in FORMATS:
        raise InputFileError(out, f"ends in {out.suffix or 'nothing'}", f"an ending {', '.join(FORMATS)}")
    try:
        import matplotlib  # noqa: F401 - only to know whether it is there
    except ModuleNotFoundError as error:
        raise TelError(
            f"a figure needs {error.name}, which is not installed: pip install 'tel_ros[report]'"
        ) from error
    from tel_ros.app.figure_export import figure_style

    with figure_style("bag"):
        figure, note = _figure(bag, topic)
        try:
            _save(figure, bag, out)
        except OSError as error:
            raise InputFileError(out, f"cannot be written ({error.strerror})", "room for it") from error
    return note


def _figure(bag: Path, topic: str) -> tuple[Figure, str]:
    from tel_ros.app.bag_figures import states_figure, trial_figure

    inspected = inspect_bag(bag)
    if inspected.trial is not None and not topic and bag.is_dir():
        trial = read_trial(bag, recovered=True)
        if not len(trial.time_ns):
            raise BagError(bag, "holds no control state of its trial", "some to draw; or --topic")
        limits_nm, note = _limits(trial)
        return trial_figure(trial, limits_nm, _title(inspected, trial)), note
    states = read_joint_states(bag, topic)
    title = f"{bag.resolve().name}: {states.topic}, {len(states.time_s)} joint states in "
    title += seconds(float(states.time_s[-1]))
    note = "" if inspected.wholeness.is_good else f"the bag is {inspected.wholeness.value}"
    return states_figure(states, title), note


def _title(inspected: InspectedBag, trial: RecordedTrial) -> str:
    name = f"{trial.bag.resolve().parent.name}/{trial.bag.resolve().name}"
    return f"{name}\ntrial {trial_text(inspected.trial)}" if inspected.trial else name


def _limits(trial: RecordedTrial) -> tuple[tuple[float, ...] | None, str]:
    """Return the effort limits that are stored with a trial, or why there are none."""
    try:
        arm = config_from(yaml.safe_load(trial.metadata["config"])).arm
        places = [arm.joints.index(joint) for joint in trial.joints]
        return tuple(arm.effort_limit_nm[place] for place in places), ""
    except (TelError, yaml.YAMLError, KeyError, ValueError, TypeError) as error:
        return None, f"the figure has no effort limits: the bag's configuration cannot be used ({error})"


def _save(figure: Figure, bag: Path, out: Path) -> None:
    from tel_ros.app.figure_export import PALETTE, inline_svg, save_figure

    if out.suffix == ".html":
        from tel_ros.app.report import page_environment

        page = page_environment().get_template(_PAGE)
        name = bag.resolve().name
        write_atomically(out, page.render(name=name, palette=PALETTE, svg=inline_svg(figure, "bag")) + "\n")
    else:
        save_figure(figure, out)
