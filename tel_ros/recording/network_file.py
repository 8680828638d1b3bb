"""Storing a network in a file.

Format ``tel_ros network 1``: a NumPy ``.npz`` archive (no pickles) with

- ``header``: JSON text with ``format``, ``joints``, ``learning`` (the learner's configuration), ``seed`` and
  ``trials_learned``;
- ``input_low``, ``input_high``: ranges of the 3 * n_joints inputs, shape (3 * n_joints,);
- for each joint j: ``weights_j``, shape (1 + subtrees, 3 * n_joints, gaussians), and ``parents_j``, shape
  (subtrees, 3): subtree, input and Gaussian that each subtree hangs under.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from pathlib import Path

import numpy as np

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import NetworkFileError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.inverse_dynamics import LmsTreeInverseDynamics
from tel_ros.core.learning.lms_tree import Leaf

FORMAT = "tel_ros network 1"
_EXPECTED = "a network saved by tel_ros"


def revision(network: LmsTreeInverseDynamics) -> str:
    """Return a hash of everything that the network's answers depend on."""
    digest = hashlib.sha256(_header(network).encode())
    for array in _arrays(network).values():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def save_network(network: LmsTreeInverseDynamics, path: Path) -> None:
    """Write a network so that a reader finds the old file or the new one, never half of one.

    Raises:
        NetworkFileError: the file cannot be written.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with beside.open("wb") as file:
                # The variadic parameter is typed for options, too, which mypy cannot tell from array names.
                np.savez(file, header=np.array(_header(network)), **_arrays(network))  # type: ignore[arg-type]
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise NetworkFileError(path, f"cannot be written ({error})", "a file that can be written") from error


def load_network(path: Path) -> LmsTreeInverseDynamics:
    """Read a network and check that it is whole.

    Raises:
        NetworkFileError: the file is missing, is no such network, or holds values that are not finite or
            ranges without width.
    """
    if not path.is_file():
        raise NetworkFileError(path, "there is no such file", _EXPECTED)
    try:
        with np.load(path, allow_pickle=False) as stored:
            return _restored(stored, path)
    except NetworkFileError:
        raise
    except Exception as error:  # damaged bytes make NumPy and its libraries raise whatever they raise
        found = f"not readable ({' '.join(str(error).split())})"
        raise NetworkFileError(path, found, _EXPECTED) from error


def _header(network: LmsTreeInverseDynamics) -> str:
    return json.dumps(
        {
            "format": FORMAT,
            "joints": list(network.joints),
            "learning": dataclasses.asdict(network.learning),
            "seed": network.seed,
            "trials_learned": network.trials_learned,
        },
        sort_keys=True,
    )


def _arrays(network: LmsTreeInverseDynamics) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {
        "input_low": network.input_range.low,
        "input_high": network.input_range.high,
    }
    for j, tree in enumerate(network.trees):
        arrays[f"weights_{j}"], arrays[f"parents_{j}"] = tree.weights, tree.parents_array
    return arrays


def _restored(stored: np.lib.npyio.NpzFile, path: Path) -> LmsTreeInverseDynamics:
    header = json.loads(str(stored["header"]))
    if header["format"] != FORMAT:
        raise NetworkFileError(path, f"has the format {header['format']!r}", repr(FORMAT))
    joints = tuple(header["joints"])
    n_inputs = 3 * len(joints)
    low, high = stored["input_low"], stored["input_high"]
    network = LmsTreeInverseDynamics(
        joints, InputRange(low, high), LearningConfig(**header["learning"]), header["seed"]
    )
    network.trials_learned = int(header["trials_learned"])
    checked = [("input_low", low, (n_inputs,)), ("input_high", high, (n_inputs,))]
    for j, tree in enumerate(network.trees):
        weights, parents = stored[f"weights_{j}"], stored[f"parents_{j}"]
        for row in parents:
            leaf = Leaf(*(int(value) for value in row))
            if not (0 <= leaf.subtree <= tree.n_subtrees and 0 <= leaf.input < n_inputs
                    and 0 <= leaf.gaussian < tree.n_gaussians):  # fmt: skip
                raise NetworkFileError(path, f"a subtree hangs under {leaf}", "a leaf of an earlier subtree")
            tree.grow(leaf)
        checked.append((f"weights_{j}", weights, tree.weights.shape))
        tree.weights = weights
    for name, array, shape in checked:
        if array.shape != shape or not np.all(np.isfinite(array)):
            raise NetworkFileError(
                path, f"{name} has shape {array.shape}", f"finite numbers of shape {shape}"
            )
    if not np.all(low < high):
        raise NetworkFileError(path, "input_high is not above input_low", "ranges with a width")
    return network
