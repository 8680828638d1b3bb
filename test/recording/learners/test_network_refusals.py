"""Files that are no network, or not a whole one, are refused by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_networks import refusal

from tel_ros.core.errors import NetworkFileError
from tel_ros.recording.network_file import load_network, revision


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
