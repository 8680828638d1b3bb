"""``tel replay``: a bag's topics, published at the pace at which they were recorded."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tel_ros.app.config_argument import namespace_option
from tel_ros.app.errors import EXIT_INTERRUPTED, EXIT_NOT_COMPLETED, Interruption, end
from tel_ros.core.errors import TelError, counted

if TYPE_CHECKING:
    from tel_ros.nodes.bag_player import BagPlayer


@click.command()
@click.argument("bag", type=click.Path(path_type=Path))
@click.option("--rate", type=float, default=1.0, show_default=True, help="Seconds of the bag in a second.")
@click.option("--loop", is_flag=True, help="Begin again at the end, until Ctrl-C.")
@click.option(
    "--start-offset", "start_offset_s", type=float, default=0.0, help="Where in the bag to begin, in s."
)
@click.option(
    "--topics",
    "patterns",
    metavar="TOPIC",
    multiple=True,
    help="Only these: a name or a pattern such as '/joint_*'. May be given several times.",
)
@click.option("--clock/--no-clock", "with_clock", default=True, help="Publish /clock, too (default).")
@click.option(
    "--states-to-nodes",
    is_flag=True,
    help="Publish the recorded joint states on joint_states, where live nodes listen. Refused while an arm "
    "is there.",
)
@namespace_option
def replay(
    bag: Path,
    rate: float,
    loop: bool,
    start_offset_s: float,
    patterns: tuple[str, ...],
    with_clock: bool,
    states_to_nodes: bool,
    namespace: str,
) -> None:
    """Publish the topics of BAG, at its pace, below /replay.

    \b
    tel replay bags/RUN/trial_003                          everything, e.g. /replay/joint_states
    tel replay BAG --rate 0.25 --start-offset 4 --loop     slowly, from 4 s on, again and again
    tel replay BAG --states-to-nodes                       recorded joint states for a live ep_controller

    BAG is any rosbag2: a folder, or its .mcap or .db3 file. No topic keeps its name, because an arm may be
    listening; joint states keep theirs with --states-to-nodes, recorded commands never do. The space bar and
    the service /replay/pause pause and continue.

    Exit codes: 0 done, 1 not all messages of the bag could be published, 2 wrong input, or the replay is
    refused as a danger to an arm, 130 interrupted.
    """  # noqa: D301 - click wants the character, not its name
    # Late: `tel --help` needs no ROS.
    from tel_ros.nodes.bag_player import BagPlayer
    from tel_ros.recording.any_bag import open_any_bag, reading
    from tel_ros.recording.replay import Replay, ReplayOptions
    from tel_ros.recording.trial_bag import check_sums

    Interruption.watch()
    try:
        options = ReplayOptions(
            rate=rate, start_offset_s=start_offset_s, patterns=patterns, states_to_nodes=states_to_nodes
        )
        with reading(bag):
            check_sums(bag)
        with open_any_bag(bag) as reader, SpaceBar() as space_bar:
            plan = Replay(bag, reader, options)
            with BagPlayer(
                plan,
                with_clock=with_clock,
                toggled=space_bar.pressed,
                on_pause=lambda paused: click.echo("paused" if paused else "continues"),
                namespace=namespace,
            ) as player:
                _announce(bag, player, space_bar.works)
                player.play(rate)
                there = sum(reader.announced[name] for name in {t.connection.topic for t in player.played})
                while loop:
                    player.play(rate)
    except KeyboardInterrupt:
        end("interrupted: nothing is published any more", EXIT_INTERRUPTED)
    click.echo(f"{counted(player.published, 'message')} published")
    if player.stood_still_s > 0.0:
        click.echo(f"tel: the replay stood still for {player.stood_still_s:.1f} s in all", err=True)
    if player.most_late_s > 0.02:  # a loop at 50 Hz would notice
        click.echo(f"tel: messages were up to {1e3 * player.most_late_s:.0f} ms late", err=True)
    expected = 1 if start_offset_s else there
    if player.published < expected:
        end(
            f"{bag}: yields {counted(player.published, 'message')}; expected {expected} or more",
            EXIT_NOT_COMPLETED,
        )


def _announce(bag: Path, player: BagPlayer, has_keyboard: bool) -> None:
    for line in player.skipped:
        click.echo(f"tel: {line}", err=True)
    if not player.played:
        raise TelError(f"{bag}: none of its topics can be published here")
    for topic in player.played:
        count, name = topic.connection.msgcount, player.node.resolve_topic_name(topic.name)
        click.echo(f"{topic.connection.topic} → {name} ({counted(count, 'message')})")
    if has_keyboard:
        click.echo("space bar: pause and continue; Ctrl-C: end")


class SpaceBar:
    """Tells whether the space bar was pressed; without a terminal it never is. Ctrl-C and Ctrl-Z work."""

    def __init__(self) -> None:
        self._terminal = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
        self._before: list | None = None

    def __enter__(self) -> SpaceBar:
        """Have keys come one by one."""
        # Touching the terminal would stop a process in the background.
        if self._terminal >= 0 and os.tcgetpgrp(self._terminal) == os.getpgrp():
            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the terminal as it was."""
        if self._before is not None:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    @property
    def works(self) -> bool:
        """Whether there is a terminal to listen to."""
        return self._before is not None

    def pressed(self) -> bool:
        """Return whether it was pressed an odd number of times since the last call."""
        if self._before is None or os.tcgetpgrp(self._terminal) != os.getpgrp():
            return False
        spaces = 0
        while select.select([self._terminal], [], [], 0.0)[0] and (keys := os.read(self._terminal, 64)):
            spaces += keys.count(b" ")
        return spaces % 2 == 1
