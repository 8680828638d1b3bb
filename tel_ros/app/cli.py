"""The command ``tel``: its commands, and one exit for whatever goes wrong in them."""

from __future__ import annotations

from functools import partial

import click

from tel_ros import __version__
from tel_ros.app.command_group import CommandGroup, extensions

COMMANDS = {
    "bag": "tel_ros.app.bag.command:bag",
    "check": "tel_ros.app.check.command:check",
    "configs": "tel_ros.app.config_argument:configs",
    "deploy": "tel_ros.app.deploy_command:deploy",
    "fastest": "tel_ros.app.fastest_command:fastest",
    "predict": "tel_ros.app.predict_command:predict",
    "practice": "tel_ros.app.practice_command:practice",
    "replay": "tel_ros.app.replay_command:replay",
    "report": "tel_ros.app.report.command:report",
    "reset": "tel_ros.app.stop_command:reset",
    "serve": "tel_ros.app.serve_command:serve",
    "stop": "tel_ros.app.stop_command:stop",
    "train": "tel_ros.app.train:train",
    "view": "tel_ros.app.view.command:view",
}
"""Where each command is. Other packages add theirs as entry points of the group ``tel_ros.commands``."""


@click.group(
    cls=CommandGroup,
    own=COMMANDS,
    places=partial(extensions, "tel_ros.commands"),
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="tel")
def main() -> None:
    """Robot arms that get better at a movement by practice.

    \b
    tel configs                         the configurations to start from
    tel practice planar_arm             a practice run: slow at first, faster with each trial
    tel practice --resume bags/RUN      resume one that was interrupted
    tel stop                            brake the arm now, from any terminal; `tel reset` ends the stop
    tel report bags/RUN                 its report again; several runs side by side
    tel check my_arm.yaml               does the arm match its configuration? before it moves far
    tel deploy bags/RUN --out DIR       the practised movement for the stock joint_trajectory_controller
    tel serve CONFIG --folder DIR       the trajectories of others, e.g. of MoveIt, better each time
    tel fastest planar_arm              how fast the path could be run, by its URDF or by a run
    tel compare planar_arm              other methods beside it: one table, one figure
    tel sweep planar_arm …              many practice runs over grids of values, one table
    tel study NAME                      the tables and figures of the documentation, made again

    \b
    tel bag info bags/RUN               what bags hold, and whether they are complete
    tel bag plot bags/RUN/trial_001     a figure of a bag
    tel bag export bags/RUN --out DIR   all of its trials in one file, for Foxglove and PlotJuggler
    tel bag recover bags/RUN/.unfinished/trial_004   save what a crash left of a bag
    tel replay bags/RUN/trial_001       publish its topics again, below /replay, at any rate
    tel train bags/RUN --out NETWORK    the network again, from bags alone; with --import, the torques of
                                        any arm, from recordings of other programs
    tel view my_arm.yaml                watch a running graph in the browser (or: tel practice --view)
    tel predict NETWORK MOVEMENT        the torques that a movement needs, and how certain they are

    \b
    A first run, then one of your own:
      tel practice planar_arm
      tel practice planar_arm --set path.file=my_waypoints.csv --set practice.goal_duration_s=3.5

    `tel COMMAND --help` explains each. Results go to stdout (as JSON with --json), progress to stderr.
    Tab completion: eval "$(_TEL_COMPLETE=bash_source tel)", or zsh_source, fish_source. TEL_DEBUG=1 shows
    the traceback of an error.

    Exit codes: 0 done, 1 the goal was not reached, or a check found something wrong, 2 wrong input (nothing
    moved), 3 the node graph failed, or a part of the software is missing, 130 interrupted.
    """  # noqa: D301 - click wants the character, not its name


if __name__ == "__main__":
    main()
