"""Networks that are stored whole, or not at all."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import NetworkFileError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import LearnerContext
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.signals import TrainingSamples
from tel_ros.recording.network_file import load_network, revision, save_network

X = np.random.default_rng(5).uniform(-2.0, 2.0, (30, 6))


def samples(seed: int) -> TrainingSamples:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-2.0, 2.0, (60, 6))
    return TrainingSamples(actual=x, desired=x + 0.01, offset_rad=np.sin(x[:, :2] * x[:, 2:4]))


CONTEXT = LearnerContext(
    joints=("shoulder", "elbow"),
    stiffness_nm_per_rad=(15.0, 12.0),
    damping_nms_per_rad=(1.5, 0.0),
    input_range=InputRange(low=np.full(6, -2.1), high=np.linspace(2.1, 2.2, 6)),
    learning=LearningConfig(max_subtrees=4, growth_per_trial=2, rate=0.3, gaussians_per_input=6),
    seed=5,
    urdf='<robot name="straße"/>',
)


def trained(trials: int, **context: object) -> LmsLearner:
    network = LmsLearner(dataclasses.replace(CONTEXT, **context))
    for trial in range(trials):
        network, _ = network.trained_on(samples(trial), "actual")
    return network


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A stored network that has learned from two trials."""
    save_network(trained(2), tmp_path / "network.npz")
    return tmp_path / "network.npz"


@pytest.fixture
def rewrite(file: Path) -> Callable[..., None]:
    """Replace arrays in the file, or keys of its header, ``part.key`` of a part; None takes them away."""

    def change(header: dict[str, Any] | None = None, **arrays: Any) -> None:
        with np.load(file) as stored:
            content = dict(stored)
        text = json.loads(str(content["header"]))
        for path, value in (header or {}).items():
            *parts, key = path.split(".")
            inner = text[parts[0]] if parts else text
            inner[key] = value
            if value is None:
                del inner[key]
        content["header"] = np.array(json.dumps(text))
        content |= arrays
        np.savez(file, **{name: array for name, array in content.items() if array is not None})

    return change


def refusal(file: Path) -> str:
    with pytest.raises(NetworkFileError) as error:
        load_network(file)
    assert str(error.value).startswith(f"{file}: ")
    assert "; expected " in str(error.value)
    return str(error.value)


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


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    text = refusal(tmp_path / "no.npz")
    assert text.endswith("no.npz: there is no such file; expected a network saved by tel_ros")


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(file: Path, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    assert "not readable" in refusal(file)


@pytest.mark.parametrize("content", [b"words", b"\x80\x04N.", b"PK\x03\x04", b"\x93NUMPY"], ids=repr)
def test_a_file_of_another_kind_is_refused(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    assert "not readable" in refusal(file)


def test_a_single_array_is_refused(file: Path) -> None:
    with file.open("wb") as stream:
        np.save(stream, np.zeros(3))
    assert "not readable" in refusal(file)


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_file_is_refused_or_read_unharmed(file: Path, seed: int) -> None:
    rng, whole, before = np.random.default_rng(seed), file.read_bytes(), revision(load_network(file))
    for place in rng.choice(len(whole), 60, replace=False):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << rng.integers(8)
        file.write_bytes(damaged)
        try:
            network = load_network(file)
        except NetworkFileError:
            continue
        assert revision(network) == before


@pytest.mark.parametrize("name", ["tel_ros network 1", "tel_ros network 3", ""])
def test_another_format_is_refused_by_name(file: Path, rewrite: Callable[..., None], name: str) -> None:
    rewrite({"format": name})
    assert refusal(file).endswith(f"has the format {name!r}; expected 'tel_ros network 2'")


def test_a_learner_that_is_not_installed_is_refused_by_name(file: Path, rewrite: Callable[..., None]) -> None:
    rewrite({"learner": "somebody's"})
    assert "somebody's" in refusal(file)
    assert "lms_tree" in refusal(file)


@pytest.mark.parametrize(
    "name",
    [
        "format", "learner", "context", "state", "context.joints", "context.stiffness_nm_per_rad",
        "context.damping_nms_per_rad", "context.learning", "context.seed", "context.urdf",
        "state.trials_learned",
    ],
)  # fmt: skip
def test_a_header_without_one_of_its_keys_is_refused(
    file: Path, rewrite: Callable[..., None], name: str
) -> None:
    rewrite({name: None})
    assert name.split(".")[-1] in refusal(file)


@pytest.mark.parametrize(
    "header",
    [
        {"context.learning": {"rate": 7.0}},
        {"context.learning": {"speed": 1.0}},
        {"context.learning": "lms"},
        {"context.joints": 3},
        {"context.joints": ["shoulder"]},
        {"context.seed": "one"},
        {"context.stiffness_nm_per_rad": [15.0]},
        {"context.stiffness_nm_per_rad": [15.0, float("nan")]},
        {"context.stiffness_nm_per_rad": [15.0, 0.0]},
        {"context.damping_nms_per_rad": [1.5, 1.5, 1.5]},
        {"context.damping_nms_per_rad": [1.5, float("inf")]},
        {"state.trials_learned": "many"},
        {"state.trials_learned": -1},
        {"state": 3},
        {"context": []},
    ],
    ids=str,
)
def test_a_header_with_a_wrong_value_is_refused(
    file: Path, rewrite: Callable[..., None], header: dict[str, Any]
) -> None:
    rewrite(header)
    refusal(file)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "3"])
def test_a_header_that_is_no_object_is_refused(file: Path, text: str) -> None:
    with np.load(file) as stored:
        content = dict(stored)
    np.savez(file, **(content | {"header": np.array(text)}))
    assert "not readable" in refusal(file)


@pytest.mark.parametrize("name", ["state_weights_1", "state_parents_0", "input_low", "header"])
def test_a_missing_array_is_refused(file: Path, name: str) -> None:
    with np.load(file) as stored:
        content = {key: array for key, array in stored.items() if key != name}
    np.savez(file, **content)
    assert name.removeprefix("state_") in refusal(file)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("state_weights_0", np.zeros((2, 6, 6))),
        ("state_weights_1", np.zeros((5, 6, 7))),
        ("state_weights_1", np.zeros(5)),
        ("input_low", np.zeros(5)),
        ("input_high", np.zeros((6, 1))),
    ],
)
def test_an_array_of_a_wrong_shape_is_refused(
    file: Path, rewrite: Callable[..., None], name: str, array: np.ndarray
) -> None:
    rewrite(**{name: array})
    text = refusal(file)
    if name.startswith("state_"):
        assert f"{name.removeprefix('state_')} has shape {array.shape}, not (5, 6, 6)" in text
    else:
        assert "input_" in text


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["state_weights_0", "state_seen_1", "input_low"])
def test_values_that_are_not_finite_are_refused(
    file: Path, rewrite: Callable[..., None], name: str, bad: float
) -> None:
    with np.load(file) as stored:
        array = stored[name]
    array.flat[3] = bad
    rewrite(**{name: array})
    assert f"{name} holds numbers that are not finite; expected finite numbers" in refusal(file)


def test_ranges_without_width_are_refused(file: Path, rewrite: Callable[..., None]) -> None:
    """Inputs are divided by the width of their range."""
    with np.load(file) as stored:
        rewrite(input_high=stored["input_low"])
    assert "input_high is not above input_low" in refusal(file)


@pytest.mark.parametrize("leaf", [(2, 0, 0), (0, 6, 0), (0, 0, 6), (-1, 0, 0)])
def test_a_subtree_under_a_leaf_that_is_not_there_is_refused(
    file: Path, rewrite: Callable[..., None], leaf: tuple[int, int, int]
) -> None:
    with np.load(file) as stored:
        parents = stored["state_parents_0"]
    parents[1] = leaf
    rewrite(state_parents_0=parents)
    said = f"Leaf(subtree={leaf[0]}, input={leaf[1]}, gaussian={leaf[2]})"
    assert f"a subtree hangs under {said}, which is no leaf of an earlier subtree" in refusal(file)


def test_pickled_objects_are_refused(file: Path, rewrite: Callable[..., None]) -> None:
    rewrite(state_weights_0=np.array([{"a": 1}], dtype=object))
    assert "not readable" in refusal(file)


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
