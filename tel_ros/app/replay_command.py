"""``tel replay``: a bag's topics, published at the pace at which they were recorded."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tel_ros.app.config_argument import namespace_option
from tel_ros.app.errors import EXIT_BAD_INPUT, EXIT_INTERRUPTED, end
from tel_ros.app.keyboard import SpaceBar
from tel_ros.core.errors import TelError

if TYPE_CHECKING:
    from tel_ros.nodes.bag_player import BagPlayer

_LATE_S = 0.02
"""Latency that is worth a word: more than a loop of 50 Hz would notice."""


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
    listening; the joint states do with --states-to-nodes, recorded commands never do. The space bar, or the
    service /replay/pause, stops and continues.

    Exit codes: 0 done, 2 wrong input, or somebody is there for whom the replay is a danger, 130 interrupted.
    """  # noqa: D301 - click wants the character, not its name
    # Late: `tel --help` needs no ROS.
    from tel_ros.nodes.bag_player import BagPlayer
    from tel_ros.recording.bag_format import open_any_bag, reading
    from tel_ros.recording.replay import Replay, ReplayOptions
    from tel_ros.recording.trial_bag import check_sums

    # Also where a script has started this in the background, which makes it ignore SIGINT.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
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
                on_pause=_say_pause,
                namespace=namespace,
            ) as player:
                _say_what_comes(bag, player, space_bar.works)
                player.play(rate)
                while loop:
                    player.play(rate)
            _say_what_was(player)
    except TelError as error:
        end(str(error), EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        end("interrupted: nothing is published any more", EXIT_INTERRUPTED)


def _say_what_comes(bag: Path, player: BagPlayer, has_keyboard: bool) -> None:
    for line in player.skipped:
        click.echo(f"tel: {line}", err=True)
    if not player.played:
        raise TelError(f"{bag}: nothing of it can be published here")
    for topic in player.played:
        count, name = topic.connection.msgcount, player.node.resolve_topic_name(topic.name)
        click.echo(f"{topic.connection.topic} → {name} ({count} message{'s' * (count != 1)})")
    if has_keyboard:
        click.echo("space bar: pause and continue; Ctrl-C: end")


def _say_pause(paused: bool) -> None:
    click.echo("paused" if paused else "goes on")


def _say_what_was(player: BagPlayer) -> None:
    click.echo(f"{player.published} messages published")
    if player.stood_still_s > 0.0:
        click.echo(f"tel: the replay stood still for {player.stood_still_s:.1f} s in all", err=True)
    if player.most_late_s > _LATE_S:
        click.echo(f"tel: messages were up to {1e3 * player.most_late_s:.0f} ms late", err=True)


if __name__ == "__main__":
    replay()
