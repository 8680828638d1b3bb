"""``tel replay``: a bag's topics, published at the pace at which they were recorded."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    bag: Path, loop: bool, start_offset_s: float, with_clock: bool, namespace: str, **options: Any
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
    from tel_ros.recording.replay import Replay
    from tel_ros.recording.trial_bag import check_sums

    Interruption.watch()
    try:
        with reading(bag):
            check_sums(bag)
        with open_any_bag(bag) as reader, _space_bar() as pressed:
            replayed = Replay(reader, start_offset_s=start_offset_s, **options)
            with BagPlayer(
                replayed,
                with_clock=with_clock,
                toggled=pressed or (lambda: False),
                on_pause=lambda paused: click.echo("paused" if paused else "continues"),
                namespace=namespace,
            ) as player:
                _announce(bag, player)
                if pressed:
                    click.echo("space bar: pause and continue; Ctrl-C: end")
                player.play(replayed.rate)
                there = sum(reader.announced[name] for name in {t.connection.topic for t in player.played})
                while loop:
                    player.play(replayed.rate)
    except Interruption.errors():
        end("interrupted: nothing is published any more", EXIT_INTERRUPTED)
    click.echo(f"{counted(player.published, 'message')} published")
    if player.stood_still_s > 0.0:
        click.echo(f"tel: the replay stood still for {player.stood_still_s:.1f} s in all", err=True)
    if player.most_late_s > 0.02:  # a loop at 50 Hz would notice
        click.echo(f"tel: messages were up to {1e3 * player.most_late_s:.0f} ms late", err=True)
    expected = 1 if start_offset_s else there
    if player.published < expected:
        yields = f"yields {counted(player.published, 'message')}"
        end(f"{bag}: {yields}; expected {expected} or more", EXIT_NOT_COMPLETED)


def _announce(bag: Path, player: BagPlayer) -> None:
    for line in player.skipped:
        click.echo(f"tel: {line}", err=True)
    if not player.played:
        raise TelError(f"{bag}: none of its topics can be published here")
    for topic in player.played:
        count, name = topic.connection.msgcount, player.node.resolve_topic_name(topic.name)
        click.echo(f"{topic.connection.topic} → {name} ({counted(count, 'message')})")


@contextmanager
def _space_bar() -> Iterator[Callable[[], bool] | None]:
    """Yield what tells whether the space bar was pressed an odd number of times since the last call.

    None without a terminal to listen to. Ctrl-C and Ctrl-Z work.
    """
    terminal = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1

    def is_ours() -> bool:
        return os.tcgetpgrp(terminal) == os.getpgrp()

    def pressed() -> bool:
        spaces = 0
        while is_ours() and select.select([terminal], [], [], 0.0)[0] and (keys := os.read(terminal, 64)):
            spaces += keys.count(b" ")
        return spaces % 2 == 1

    if terminal < 0 or not is_ours():  # touching the terminal would stop a process in the background
        yield None
        return
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)  # keys come one by one
    try:
        yield pressed
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
