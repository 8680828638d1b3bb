"""``tel bag``: looking at bags, a trial's or anybody's."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import click

from tel_ros.app.errors import EXIT_NOT_COMPLETED
from tel_ros.app.tables import show
from tel_ros.core.errors import BagError, counted
from tel_ros.recording import topics
from tel_ros.recording.run_folder import is_run_folder

_PATH = click.Path(path_type=Path)


@click.group()
def bag() -> None:
    """Look at bags: what they hold, whether they are whole, a figure; export and recover them."""


@bag.command()
@click.argument("path", metavar="BAG|RUN", type=_PATH)
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON on stdout, and nothing else.")
def info(path: Path, as_json: bool) -> None:
    """Tell what a bag, or each bag of a practice run, holds, and whether it is whole.

    All messages are read: the counts that a bag announces are compared with what can be read, and checksums
    are verified where there are any. Works with bags of other recorders, too: rosbag2 with MCAP or sqlite3,
    and rosbag1.

    Exit codes: 0 whole, 1 something is missing or has changed, 2 no bag.
    """
    # Imported late: `tel --help` needs none of it.
    from tel_ros.app.bag.text import head_lines, plain, run_table, topic_table
    from tel_ros.recording.bag_inspection import bags_of_run, inspect_bag

    is_run = is_run_folder(path)
    bags = [inspect_bag(each) for each in (bags_of_run(path) if is_run else [path])]
    if not bags:
        raise BagError(path, "has no trial", "a run with at least one")
    if as_json:
        told = [plain(each) for each in bags]
        click.echo(json.dumps({"run": str(path), "bags": told} if is_run else told[0], indent=2))
    elif is_run:
        show(run_table(bags))
        for each in bags:
            if not each.wholeness.is_good:
                click.echo(f"{each.path.name}  {each.wholeness.value} ({each.problem})")
    else:
        for heading, text in head_lines(bags[0]):
            click.echo(f"{heading:<17} {text}")
        if bags[0].topics:
            show(topic_table(bags[0]))
    sys.exit(0 if all(each.wholeness.is_good for each in bags) else EXIT_NOT_COMPLETED)


@bag.command()
@click.argument("path", metavar="BAG", type=_PATH)
@click.option(
    "--out",
    type=_PATH,
    help="File of the figure: .png, .svg, .pdf or .html. Default: NAME.png here.",
)
@click.option("--topic", default="", help="Draw the joint states of this topic, even from a bag of a trial.")
def plot(path: Path, out: Path | None, topic: str) -> None:
    """Draw the curves of a bag.

    Of a trial: desired, actual and equilibrium position, error and torque of each joint. Of any other bag
    with sensor_msgs/JointState: position, velocity and effort.
    """
    from tel_ros.app.bag.figures import plot_bag  # imported late: plotting takes a second to import

    file = out or Path(f"{path.resolve().stem}.png")
    note = plot_bag(path, file, topic)
    if note:
        click.echo(f"tel: {note}", err=True)
    click.echo(file)


@bag.command()
@click.argument("path", metavar="RUN|BAG", type=_PATH)
@click.option("--out", required=True, type=_PATH, help="Folder to make for the file and the layouts.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON on stdout.")
def export(path: Path, out: Path, as_json: bool) -> None:
    """Put a run, or one trial, into one MCAP file for Foxglove and PlotJuggler, with a layout for each.

    It has all recorded messages unchanged, trial after trial, and what a 3D view needs: /robot_description,
    /tf and /tf_static, paths of the hand, the error, the effort limits. The description is the recorded one;
    mesh files that it names are not copied.

    Times are the recorded ones. Where they go back from one trial to the next, as after a restart of a
    simulated arm, that trial and all later ones are moved to 1 s after the trial before; stamps inside the
    recorded messages stay.

    Trials that are not whole, or were never closed, are left out.

    Exit codes: 0 done, 1 done, but a trial was left out, 2 wrong input.
    """
    # Imported late: `tel --help` needs none of it. The layouts first: without jinja2 nothing is written.
    from tel_ros.app.bag.layouts import write_layouts
    from tel_ros.recording.export.run_export import export

    made = export(path, out)
    layouts = write_layouts(made)
    if as_json:
        written = {
            "folder": str(made.folder),
            "file": str(made.file),
            "foxglove_layout": str(layouts[0]),
            "plotjuggler_layout": str(layouts[1]),
            "trials": [{**vars(trial), "bag": str(trial.bag)} for trial in made.trials],
            "left_out": [{"bag": str(bag), "problem": problem} for bag, problem in made.left_out.items()],
            "topics": made.counts,
            "meshes": list(made.arm.meshes),
        }
        click.echo(json.dumps(written, indent=2))
    else:
        for trial in made.trials:
            moved = f", moved by {trial.shift_s:+.3f} s" if trial.shift_s else ""
            click.echo(f"trial {trial.index:3d}  {trial.begin_s:.3f} s to {trial.end_s:.3f} s{moved}")
        if made.arm.meshes:
            click.echo(f"the arm's description names {len(made.arm.meshes)} mesh files; they are not copied")
        for file in (made.file, *layouts):
            click.echo(file)
    for left, problem in made.left_out.items():
        click.echo(f"tel: {left.name} is left out: it {problem}", err=True)
    sys.exit(EXIT_NOT_COMPLETED if made.left_out else 0)


@bag.command()
@click.argument("unfinished", type=_PATH)
@click.option("--out", type=_PATH, help="Folder of the new bag. Default: recovered/NAME in the run's folder.")
@click.option("--json", "as_json", is_flag=True, help="Print what was saved as JSON on stdout.")
def recover(unfinished: Path, out: Path | None, as_json: bool) -> None:
    """Save what a crash has left of a recording.

    UNFINISHED is a folder below a run's .unfinished, any rosbag2 folder without metadata.yaml or with damaged
    data, or a data file; it stays as it is. Every whole chunk of every file goes into a new bag, which is
    marked as recovered: it can be looked at, but is not used for training.
    """
    from tel_ros.recording.recover import recover

    found = recover(unfinished, out)
    if as_json:
        lost_bytes = sum(file.lost_bytes for file in found.files)
        of_paths = {"bag": str(found.bag), "unfinished": str(unfinished)}
        click.echo(json.dumps({**asdict(found), "lost_bytes": lost_bytes, **of_paths}, indent=2))
        return
    for topic, n in found.counts.items():
        click.echo(f"{n:8d}  {topic}")
    for file in found.files:
        lost = f"{counted(file.lost_bytes, 'byte')} of it are lost" if file.lost_bytes else "nothing is lost"
        state = "" if file.whole else f" ({file.problem or 'it was not closed, or is damaged'})"
        click.echo(f"{file.name}: {counted(file.messages, 'message')} saved, {lost}{state}")
    if any(topics.is_named(topic, topics.CONTROL_STATES) for topic in found.counts):
        click.echo("the trial had ended" if found.has_result else "the end of the trial is missing")
    click.echo(f"recovered into {found.bag}, from {unfinished}")
