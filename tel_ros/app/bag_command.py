"""``tel bag``: looking at bags, a trial's or anybody's."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click
from rich.console import Console

from tel_ros.app.bag_export_command import export_command
from tel_ros.app.bag_recover_command import recover_command
from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_NOT_COMPLETED, end
from tel_ros.core.errors import BagError, TelError
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE

_OUT = Console()
_LOG_WIDTH = 160


@click.group()
def bag() -> None:
    """Look at bags: what they hold, whether they are whole, a figure; export them; recover what is left."""


bag.add_command(export_command)
bag.add_command(recover_command)


@bag.command()
@click.argument("path", metavar="BAG|RUN", type=click.Path(path_type=Path))
@click.option(
    "--json", "as_json", is_flag=True, help="Print everything as JSON, and nothing else, on stdout."
)
def info(path: Path, as_json: bool) -> None:
    """Tell what a bag, or each bag of a practice run, holds, and whether it is whole.

    All messages are read: what a bag announces and what it yields are compared, and checksums where there
    are any. Works with bags of other recorders, too: rosbag2 with MCAP or sqlite3, and rosbag1.

    Exit codes: 0 whole, 1 something is missing or has changed, 2 no bag.
    """
    # Late: `tel --help` needs none of it.
    from tel_ros.app.bag_text import head_lines, plain, run_table, topic_table
    from tel_ros.recording.bag_inspection import bags_of_run, inspect_bag

    try:
        is_run = (path / CONFIG_FILE).is_file() or (path / SUMMARY_FILE).is_file()
        bags = [inspect_bag(each) for each in bags_of_run(path)] if is_run else [inspect_bag(path)]
        if not bags:
            raise BagError(path, "has no trial", "a run with at least one")
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    if not _OUT.is_terminal:
        _OUT.width = _LOG_WIDTH
    if as_json:
        told = [plain(each) for each in bags]
        click.echo(json.dumps({"run": str(path), "bags": told} if is_run else told[0], indent=2))
    elif is_run:
        _OUT.print(run_table(bags))
        for each in bags:
            if not each.wholeness.is_good:
                text = f"{each.path.name}  {each.wholeness.value} ({each.problem})"
                _OUT.print(text, highlight=False, soft_wrap=True, markup=False)
    else:
        for heading, text in head_lines(bags[0]):
            _OUT.print(f"{heading:<17} {text}", highlight=False, soft_wrap=True, markup=False)
        if bags[0].topics:
            _OUT.print(topic_table(bags[0]))
    sys.exit(0 if all(each.wholeness.is_good for each in bags) else EXIT_NOT_COMPLETED)


@bag.command()
@click.argument("path", metavar="BAG", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File of the figure: .png, .svg, .pdf or .html. Default: NAME.png in the current folder.",
)
@click.option("--topic", default="", help="Draw the joint states of this topic, even from a bag of a trial.")
def plot(path: Path, out: Path | None, topic: str) -> None:
    """Draw the curves of a bag.

    Of a trial: desired, actual and equilibrium position, error and torque of each joint. Of any other bag
    with sensor_msgs/JointState: position, velocity and effort.
    """
    from tel_ros.app.bag_plot import plot_bag  # late: plotting takes a second to import

    file = out or Path(f"{path.resolve().stem}.png")
    try:
        note = plot_bag(path, file, topic)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    if note:
        click.echo(f"tel: {note}", err=True)
    click.echo(file)


if __name__ == "__main__":
    bag()
