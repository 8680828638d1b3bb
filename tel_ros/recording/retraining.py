"""Learning again from bags what a practice run has learned from them."""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

from tel_ros.core.config import ArmConfig, Config
from tel_ros.core.errors import BagError, InputFileError, TrainingError
from tel_ros.core.learning.learner import Learner, TrainingOutcome
from tel_ros.core.practice.session import learned_or_passed_over, trained
from tel_ros.recording.config_file import with_overrides
from tel_ros.recording.network_file import new_network, revision, save_network
from tel_ros.recording.provenance import stored_config, stored_urdf, unpacked_config
from tel_ros.recording.run_folder import (
    is_run_folder,
    json_ready,
    require_all_before_last,
    trial_bag,
    trial_bags,
)
from tel_ros.recording.trial_bag import GO_BACK_TO, REVISION, read_metadata, read_trial

_CHANGEABLE = ("learning", "seed")


def train(
    paths: Sequence[Path],
    out: Path,
    overrides: Sequence[str] = (),
    *,
    force: bool = False,
    on_lesson: Callable[[Path], None] = lambda bag: None,
) -> dict[str, Any]:
    """Learn from bags or runs, in their order, write the network, and return what came out, ready for JSON.

    Configuration, URDF, waypoints and the network that the run began with are taken from the first bag.
    ``overrides``: other settings of the learner. ``force``: whether an existing file may be replaced.
    TrainingError: a trial cannot be learned from.

    Returns:
        ``bags``: one row a bag, with the keys of a row of ``summary.json``. ``as_recorded``: whether each
        trial is known to be commanded by the network that there was here before it. ``differs_at``: the first
        bag that another one had commanded; empty: none.
    """
    if out.exists() and not force:
        raise InputFileError(out, "exists already", "a file that is new (option --out), or --force")
    bags, rows = bags_of(paths), []
    with tempfile.TemporaryDirectory(prefix="tel_train_") as folder:
        config = unpacked_config(bags[0], read_metadata(bags[0]), Path(folder))
        config = with_overrides(config, overrides, _CHANGEABLE, str(bags[0]))
        learner = new_network(config)
        for after, row in _relearned(bags, config, learner):
            learner = after
            rows.append(row)
            on_lesson(Path(row["bag"]))
    save_network(learner, out)
    differ = [row for row in rows if row["network_before"] != row["commanded_by"]]
    return {
        "network": str(out),
        "revision": revision(learner),
        "as_recorded": not differ,
        "differs_at": next((row["bag"] for row in differ if row["commanded_by"]), ""),
        "bags": rows,
    }


def bags_of(paths: Sequence[Path]) -> list[Path]:
    """Return the bags that are meant, all of a run, in order; BagError if one is missing or twice."""
    bags: list[Path] = []
    for path in paths:
        of_run = trial_bags(path) if is_run_folder(path) else None
        if of_run == []:
            raise BagError(path, "holds no trials", "the folder of a run with trial_001 and so on")
        require_all_before_last(path, of_run or ())
        bags += of_run or [path]
    for k, bag in enumerate(bags):
        if bag.resolve() in [earlier.resolve() for earlier in bags[:k]]:
            raise BagError(bag, "is named twice", "each bag once")
        read_metadata(bag)
    if not bags:
        raise BagError("(none)", "no bag is named", "bags of trials, or folders of runs")
    return bags


def _relearned(
    bags: Sequence[Path], config: Config, learner: Learner
) -> Iterator[tuple[Learner, dict[str, Any]]]:
    """Learn from bags, one after the other, as practice does; yield the learner and a row after each.

    A trial before which practice had gone back to an earlier network is learned from with that one.
    """
    metadata = [read_metadata(bag) for bag in bags]
    require_same_arm(list(zip(bags, metadata, strict=True)))
    wanted = [_gone_back_to(bag, values) for bag, values in zip(bags, metadata, strict=True)]
    kept: dict[tuple[Path, int], Learner] = {}
    for bag, values, back in zip(bags, metadata, wanted, strict=True):
        run = bag.resolve().parent
        kept.setdefault((run, 0), learner)
        notes = []
        if back is not None:
            if (run, back) not in kept:
                found = f"goes back to the network after trial {back}"
                raise BagError(bag, found, f"{trial_bag(bag.parent, back)} among the bags before it")
            learner = kept[run, back]
            notes = [f"back to the network {f'after trial {back}' if back else 'that the run began with'}"]
        before = revision(learner)
        trial = read_trial(bag)
        report = trial.report
        if trial.joints != config.arm.joints:
            found = f"is of the joints {', '.join(trial.joints)}"
            raise BagError(bag, found, f"{', '.join(config.arm.joints)}, as in its configuration")
        learn = partial(trained, learner, trial, config)
        try:
            after, why_not = learned_or_passed_over(
                report.outcome, bool(trial.run.any()), config.practice.on_abort, learn
            )
        except TrainingError as error:
            raise TrainingError(f"{bag}: {error}") from None
        learner, training = after or (learner, None)
        error_rad = trial.position_rad[trial.run] - trial.desired[trial.run, : len(trial.joints)]
        nothing = dict.fromkeys(field.name for field in fields(TrainingOutcome)) | {"grown": ()}
        row = {
            "bag": str(bag),
            "index": report.index,
            "path": values.get("path"),
            "duration_s": report.duration_s,
            "outcome": report.outcome.text,
            "rms_error_rad": math.sqrt((error_rad**2).mean()) if error_rad.size else None,
            **json_ready(asdict(training) if training else nothing),
            "commanded_by": values.get(REVISION, ""),
            "network_before": before,
            "note": "; ".join(filter(None, [*notes, why_not])),
        }
        yield learner, row
        if report.index in wanted:
            kept[run, report.index] = learner


_ARM_KEYS = ("name", "joints", "command_interface", "stiffness_nm_per_rad", "damping_nms_per_rad")


def require_same_arm(bags: Sequence[tuple[Path, Mapping[str, str]]], arm: ArmConfig | None = None) -> None:
    """Raise BagError unless all bags are of one arm: ``arm``, or that of the first bag.

    Compared are its name, its joints in their order, its command interface, its springs (those of the
    configuration: what a single trial varies is accounted for) and the text of its URDF.
    """
    origin = "the configuration" if arm else str(bags[0][0]) if bags else ""
    reference = _facts(arm, Path(arm.urdf).read_bytes()) if arm else {}
    for bag, metadata in bags:
        facts = _facts(stored_config(bag, metadata).arm, stored_urdf(bag, metadata))
        for key, value in facts.items():
            expected = reference.setdefault(key, value)
            if value != expected:
                raise BagError(bag, f"{key} is {value!r}", f"{expected!r}, as in {origin}")


def _facts(arm: ArmConfig, urdf: bytes) -> dict[str, Any]:
    facts: dict[str, Any] = {f"arm.{key}": getattr(arm, key) for key in _ARM_KEYS}
    text = urdf.replace(b"\r\n", b"\n")  # as bags of earlier versions hold it
    facts["arm.urdf"] = f"a text with the SHA-256 {hashlib.sha256(text).hexdigest()[:16]}"
    return facts


def _gone_back_to(bag: Path, metadata: dict[str, str]) -> int | None:
    text = metadata.get(GO_BACK_TO, "")
    if not text:
        return None
    if not text.isdigit():
        raise BagError(bag, f"{GO_BACK_TO} in its metadata is {text!r}", "nothing, or the number of a trial")
    return int(text)
