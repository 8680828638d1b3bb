"""The learner that a practice run begins with, and storing a learner in a file.

Format ``tel_ros network 2``: a NumPy ``.npz`` archive (no pickles) with

- ``header``: JSON text with ``format``, ``learner`` (its name), ``context`` (joints, K, B, the learner's
  configuration, seed, URDF; of a learner of torque also ``predicts`` and ``std_factor``) and ``state`` (what
  else the learner has to say, by its own rules);
- ``input_low``, ``input_high``: ranges of the 3 * n_joints inputs, shape (3 * n_joints,);
- ``state_…``: the learner's arrays. For trees: for each joint j ``state_weights_j``, shape (1 + subtrees,
  3 * n_joints, gaussians), and ``state_parents_j``, shape (subtrees, 3): subtree, input and Gaussian that
  each subtree hangs under. For rigid links: ``state_parameters`` (see
  :mod:`tel_ros.core.learning.rigid_body`).
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from pathlib import Path
from typing import Any, get_args

import numpy as np

from tel_ros.core.config import Config, LearningConfig
from tel_ros.core.errors import ConfigError, NetworkFileError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner, LearnerContext, Predicts, StoredLearner
from tel_ros.core.learning.registry import learner_kind, require_extrapolating
from tel_ros.core.practice.movement_path import desired_trajectory
from tel_ros.core.practice.strategies import make_strategy
from tel_ros.recording.shared_files import missing, replacing
from tel_ros.recording.urdf import described, urdf_text
from tel_ros.recording.waypoint_file import load_known_path, load_path

FORMAT = "tel_ros network 2"
_EXPECTED = "a network saved by tel_ros"
_STATE = "state_"
_USUAL: Predicts = "equilibrium"
PREDICTS_TORQUE = "a network of practice, which predicts equilibrium points; this one predicts torque"


def revision(learner: Learner) -> str:
    """Return a hash of everything that the learner's answers depend on."""
    stored = learner.stored()
    digest = hashlib.sha256(_header(learner, stored).encode())
    for name, array in sorted(_arrays(learner, stored).items()):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def save_network(learner: Learner, path: Path) -> None:
    """Write a learner so that a reader finds the old file or the new one, never half of one."""
    stored = learner.stored()
    arrays = _arrays(learner, stored)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            # The variadic parameter is typed for options, too, which mypy cannot tell from array names.
            np.savez(file, header=np.array(_header(learner, stored)), **arrays)  # type: ignore[arg-type]
    except OSError as error:
        raise NetworkFileError(path, f"cannot be written ({error})", "a file that can be written") from error


def load_network(path: Path) -> Learner:
    """Read a learner; NetworkFileError if it is none, or its numbers cannot be used."""
    if not path.is_file():
        raise NetworkFileError(path, missing(path), _EXPECTED)
    try:
        # Opened here: NumPy leaves a damaged archive open.
        with path.open("rb") as file:
            if file.read(2) != b"PK":  # of every .npz; NumPy would speak of pickles
                raise NetworkFileError(path, "not readable (it is no .npz)", _EXPECTED)
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                return _restored(arrays, path)
    except NetworkFileError:
        raise
    except Exception as error:  # damaged bytes make NumPy and its libraries raise whatever they raise
        found = f"not readable ({' '.join(str(error).split())})"
        raise NetworkFileError(path, found, _EXPECTED) from error


def _header(learner: Learner, stored: StoredLearner) -> str:
    context = dataclasses.asdict(learner.context)
    del context["input_range"]
    if learner.context.predicts == _USUAL:
        # Named only where it differs, so that the files and revisions of practice stay what they are.
        del context["predicts"], context["std_factor"]
    header = {"format": FORMAT, "learner": learner.context.learning.name, "context": context}
    return json.dumps(header | {"state": dict(stored.header)}, sort_keys=True)


def _arrays(learner: Learner, stored: StoredLearner) -> dict[str, np.ndarray]:
    input_range = learner.context.input_range
    arrays = {"input_low": input_range.low, "input_high": input_range.high}
    return arrays | {f"{_STATE}{name}": array for name, array in stored.arrays.items()}


def _restored(file: np.lib.npyio.NpzFile, path: Path) -> Learner:
    header = json.loads(str(file["header"]))
    if header["format"] != FORMAT:
        raise NetworkFileError(path, f"has the format {header['format']!r}", repr(FORMAT))
    arrays = {name: file[name] for name in file.files if name != "header"}
    for name, array in arrays.items():
        if not np.all(np.isfinite(array)):
            raise NetworkFileError(path, f"{name} holds numbers that are not finite", "finite numbers")
    described = header["context"]
    joints = tuple(described["joints"])
    low, high = arrays.pop("input_low"), arrays.pop("input_high")
    if low.shape != (3 * len(joints),) or high.shape != low.shape or not np.all(low < high):
        expected = "a range with a width for each input"
        raise NetworkFileError(path, "input_high is not above input_low", expected)
    stiffness, damping = described["stiffness_nm_per_rad"], described["damping_nms_per_rad"]
    if not (
        len(stiffness) == len(damping) == len(joints)
        and all(0.0 < value < math.inf for value in stiffness)
        and all(0.0 <= value < math.inf for value in damping)
    ):
        found = f"has the springs K = {stiffness}, B = {damping}"
        raise NetworkFileError(path, found, f"a finite K > 0 and B >= 0 for each of {', '.join(joints)}")
    made: dict[str, Any] = {
        "input_range": InputRange(low, high),
        "learning": LearningConfig(**described["learning"]),
        "seed": int(described["seed"]),
        "urdf": described["urdf"],
    }
    plain = {key: tuple(value) if isinstance(value, list) else value for key, value in described.items()}
    context = LearnerContext(**plain | made)
    if context.predicts not in get_args(Predicts):
        expected = f"one of {', '.join(get_args(Predicts))}"
        raise NetworkFileError(path, f"predicts {context.predicts!r}", expected)
    factors = context.std_factor
    if len(factors) not in (0, len(joints)) or not all(0.0 < factor < math.inf for factor in factors):
        raise NetworkFileError(path, f"has the std_factor {factors}", "a finite number > 0 a joint")
    state = {name.removeprefix(_STATE): array for name, array in arrays.items()}
    return learner_kind(header["learner"]).restored(context, StoredLearner(header["state"], state))


def learner_context(config: Config) -> LearnerContext:
    """Return what a learner is told: among it, input ranges that cover all that practice may ask for."""
    path, known_path = load_path(config.path, config.arm), load_known_path(config.path, config.arm)
    ranges = [
        InputRange.covering(
            desired_trajectory(path, known_path, movement, config.control.rate_hz),
            config.learning.input_margin,
        )
        for movement in make_strategy(config).movements_to_cover()
    ]
    return LearnerContext(
        joints=config.arm.joints,
        stiffness_nm_per_rad=config.arm.stiffness_nm_per_rad,
        damping_nms_per_rad=config.arm.damping_nms_per_rad,
        input_range=InputRange(
            low=np.min([covered.low for covered in ranges], axis=0),
            high=np.max([covered.high for covered in ranges], axis=0),
        ),
        learning=config.learning,
        seed=config.seed,
        urdf=urdf_text(described(config.arm)),
    )


def new_network(config: Config) -> Learner:
    """Return the learner that a configuration asks for: an untrained one, or that of an earlier run."""
    if config.learning.start_from:
        learner = _earlier(config)
        if config.practice.is_fastest:
            require_extrapolating(learner.context.learning.name)
        return learner
    try:
        if config.practice.is_fastest:
            require_extrapolating(config.learning.name)
        return learner_kind(config.learning.name).new(learner_context(config))
    except ConfigError as error:
        raise error if error.key.startswith("learning.") else error.inside("learning") from None


def _earlier(config: Config) -> Learner:
    file, arm = config.learning.start_from, config.arm
    learner = load_network(Path(file))
    context = learner.context
    if context.predicts == "torque":
        raise ConfigError("learning.start_from", file, PREDICTS_TORQUE)
    for name in ("joints", "stiffness_nm_per_rad", "damping_nms_per_rad"):
        if (found := getattr(context, name)) != (expected := getattr(arm, name)):
            wanted = f"a network for {name} {list(expected)}, not {list(found)}"
            raise ConfigError("learning.start_from", file, wanted)
    return learner
