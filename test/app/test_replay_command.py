"""``tel replay`` as typed, with a player that publishes as much as a test wants: no graph."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

pytest.importorskip("rclpy")
sys.path.insert(0, str(Path(__file__).parents[1] / "recording"))

from small_bags import TEXT, text, write_bag  # noqa: E402

from tel_ros.app.cli import main  # noqa: E402


class Player:
    """Publishes nothing, and says how much it has published."""

    published = 0

    def __init__(self, replay: Any, **options: Any) -> None:
        self.played, self.skipped, self.stood_still_s, self.most_late_s = replay.topics, [], 0.0, 0.0
        self.node = SimpleNamespace(resolve_topic_name=lambda name: name)

    def __enter__(self) -> Player:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def play(self, rate: float) -> None:
        pass


@pytest.mark.parametrize(
    ("published", "options", "code"),
    [
        (0, [], 1),
        (2, [], 1),
        (3, [], 0),
        (0, ["--start-offset", "0.1"], 1),
        (1, ["--start-offset", "0.1"], 0),
    ],
)
def test_a_replay_that_publishes_less_than_there_is_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, published: int, options: list[str], code: int
) -> None:
    bag = write_bag(tmp_path / "bag", [("/note", TEXT, k * 10**9, text("x")) for k in range(1, 4)])
    monkeypatch.setattr(Player, "published", published)
    monkeypatch.setattr("tel_ros.nodes.bag_player.BagPlayer", Player)
    done = CliRunner().invoke(main, ["replay", str(bag), *options])
    assert done.exit_code == code, done.output
    assert (f"yields {published} message" in done.output) == (code != 0)


def test_the_folder_of_a_run_is_called_that(tmp_path: Path) -> None:
    (tmp_path / "run.yaml").write_text("x")
    (tmp_path / "trial_002").mkdir()
    done = CliRunner().invoke(main, ["replay", str(tmp_path)])
    assert done.exit_code == 2
    assert (
        f"is the folder of a practice run, which holds a bag a trial ({tmp_path / 'trial_002'})"
        in done.output
    )
