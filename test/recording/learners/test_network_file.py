"""Networks that are stored whole, or not at all."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_networks import CONTEXT, X, refusal, samples, trained

from tel_ros.core.errors import NetworkFileError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.recording.network_file import load_network, revision, save_network


@pytest.mark.parametrize("trials", [0, 1, 3], ids=["untrained", "one_trial", "grown_to_the_limit"])
def test_a_network_comes_back_bit_by_bit(tmp_path: Path, trials: int) -> None:
    network = trained(trials)
    save_network(network, tmp_path / "network.npz")
    loaded = load_network(tmp_path / "network.npz")
    np.testing.assert_array_equal(loaded.predict(X), network.predict(X))
    np.testing.assert_array_equal(loaded.std(X), network.std(X))
    assert revision(loaded) == revision(network)
    assert (loaded.trials_learned, loaded.subtrees) == (trials, network.subtrees)
    for field in dataclasses.fields(LearnerContext):
        if field.name != "input_range":
            assert getattr(loaded.context, field.name) == getattr(CONTEXT, field.name)
    np.testing.assert_array_equal(loaded.context.input_range.low, CONTEXT.input_range.low)
    np.testing.assert_array_equal(loaded.context.input_range.high, CONTEXT.input_range.high)


def test_the_file_is_laid_out_as_documented(file: Path) -> None:
    with np.load(file, allow_pickle=False) as stored:
        content = dict(stored)
    header = json.loads(str(content.pop("header")))
    assert header["format"] == "tel_ros network 2"
    assert header["learner"] == "lms_tree"
    assert header.keys() == {"format", "learner", "context", "state"}
    assert header["context"].keys() == {
        "joints", "stiffness_nm_per_rad", "damping_nms_per_rad", "learning", "seed", "urdf",
    }  # fmt: skip
    assert header["state"] == {"trials_learned": 2}
    assert content["input_low"].shape == content["input_high"].shape == (6,)
    for joint in range(2):
        assert content[f"state_weights_{joint}"].shape == (5, 6, 6)
        assert content[f"state_parents_{joint}"].shape == (4, 3)
    assert all(name.startswith(("input_", "state_")) for name in content)


def test_a_loaded_network_learns_on_as_if_it_had_never_been_stored(file: Path) -> None:
    (stored, _), (kept, _) = (
        network.trained_on(samples(9), "desired") for network in (load_network(file), trained(2))
    )
    assert revision(stored) == revision(kept)
    np.testing.assert_array_equal(stored.predict(X), kept.predict(X))


def test_another_network_has_another_revision() -> None:
    revisions = [revision(network) for network in (trained(0), trained(1), trained(2), trained(2, seed=2))]
    assert len(set(revisions)) == 4
    assert revision(trained(2)) == revisions[2]


@pytest.mark.parametrize(
    "context",
    [
        {"stiffness_nm_per_rad": (15.0, 12.5)},
        {"damping_nms_per_rad": (1.5, 0.1)},
        {"joints": ("shoulder", "wrist")},
        {"urdf": ""},
        {"input_range": InputRange(CONTEXT.input_range.low, np.nextafter(CONTEXT.input_range.high, 9.0))},
        {"learning": dataclasses.replace(CONTEXT.learning, passes=3)},
    ],
    ids=lambda context: next(iter(context)),
)
def test_the_revision_tells_what_a_network_is_told_apart(context: dict[str, object]) -> None:
    assert revision(trained(0, **context)) != revision(trained(0))


def test_the_revision_tells_single_weights_apart(file: Path, rewrite: Callable[..., None]) -> None:
    before = revision(load_network(file))
    with np.load(file) as stored:
        weights = stored["state_weights_1"]
    weights[0, 0, 0] = np.nextafter(weights[0, 0, 0], 1.0)
    rewrite(state_weights_1=weights)
    assert revision(load_network(file)) != before


def test_folders_on_the_way_are_made(tmp_path: Path) -> None:
    save_network(trained(0), tmp_path / "run" / "network" / "network.npz")
    assert [path.name for path in (tmp_path / "run" / "network").iterdir()] == ["network.npz"]


def test_saving_again_takes_the_place_of_the_old_network(file: Path) -> None:
    save_network(trained(3), file)
    assert revision(load_network(file)) == revision(trained(3))
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("failing", ["fsync", "replace"])
def test_a_failing_save_leaves_the_old_network(
    file: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    before = file.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(*((os, "fsync") if failing == "fsync" else (Path, "replace")), full)
        with pytest.raises(NetworkFileError, match=r"network\.npz: cannot be written .*No space left"):
            save_network(trained(3), file)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file], "a half-written file is left behind"


def test_a_place_that_cannot_be_written_is_refused_by_name(file: Path) -> None:
    with pytest.raises(
        NetworkFileError, match=r"network\.npz/n\.npz: cannot be written .*; expected a file that"
    ):
        save_network(trained(0), file / "n.npz")


def test_a_network_of_torque_says_so_and_one_of_practice_does_not(tmp_path: Path) -> None:
    torque = trained(1, predicts="torque", std_factor=(1.5, 2.5))
    save_network(torque, tmp_path / "torque.npz")
    context = load_network(tmp_path / "torque.npz").context
    assert (context.predicts, context.std_factor) == ("torque", (1.5, 2.5))
    assert revision(torque) != revision(trained(1))


def test_a_network_of_practice_says_nothing_new(file: Path) -> None:
    """Files and revisions of earlier runs stay what they are."""
    with np.load(file) as stored:
        assert "predicts" not in json.loads(str(stored["header"]))["context"]
    assert load_network(file).context.predicts == "equilibrium"


@pytest.mark.parametrize(
    ("key", "value", "part"),
    [
        ("context.predicts", "weather", "predicts 'weather'; expected one of equilibrium, torque"),
        ("context.std_factor", [1.0], "std_factor"),
        ("context.std_factor", [1.0, -1.0], "std_factor"),
    ],
)
def test_what_no_network_predicts_is_refused(
    file: Path, rewrite: Callable[..., None], key: str, value: object, part: str
) -> None:
    rewrite({"context.predicts": "torque", key: value})
    assert part in refusal(file)
