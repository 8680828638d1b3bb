"""Learning again from bags what a practice run has learned from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tel_ros.core.config import Config
from tel_ros.core.errors import BagError, TrainingError
from tel_ros.core.learning.learner import Learner, TrainingOutcome
from tel_ros.core.learning.signals import configured_samples
from tel_ros.core.practice.lessons import has_to_teach, is_learned_from
from tel_ros.recording.bag_writer import RECOVERED
from tel_ros.recording.network_file import revision
from tel_ros.recording.run_folder import CONFIG_FILE, SUMMARY_FILE, trial_bag, trial_bags
from tel_ros.recording.same_arm import require_same_arm
from tel_ros.recording.trial_bag import RecordedTrial, read_metadata, read_trial
from tel_ros.recording.trial_metadata import GO_BACK_TO, REVISION


@dataclass(frozen=True)
class Lesson:
    """What one bag has taught.

    Args:
        trial: as recorded.
        recorded_revision: of the network that commanded the trial; empty if the bag does not tell.
        revision: of the network that was there before this bag, now.
        learner: as it is after this bag.
        training: what learning did; None if the trial was not learned from.
        note: why it was not learned from, or which network was gone back to.
    """

    trial: RecordedTrial
    recorded_revision: str
    revision: str
    learner: Learner
    training: TrainingOutcome | None
    note: str = ""


def bags_of(paths: Sequence[Path]) -> list[Path]:
    """Return the bags that are meant: a run's folder stands for the bags of all its trials, in order.

    Raises:
        BagError: a folder of a run has no trials, or lacks one; a bag is named twice; there is no bag.
    """
    bags: list[Path] = []
    for path in paths:
        is_run = (path / CONFIG_FILE).is_file() or (path / SUMMARY_FILE).is_file()
        bags += _trials_of(path) if is_run else [path]
    for k, bag in enumerate(bags):
        if bag.resolve() in [earlier.resolve() for earlier in bags[:k]]:
            raise BagError(bag, "is named twice", "each bag once")
        require_trainable(bag)
    if not bags:
        raise BagError("(none)", "no bag is named", "bags of trials, or folders of runs")
    return bags


def require_trainable(bag: Path) -> dict[str, str]:
    """Return the metadata of a bag that may be learned from.

    Raises:
        BagError: it was never closed, or what a crash left of it was recovered.
    """
    metadata = read_metadata(bag)
    if metadata.get(RECOVERED):
        found = f"was recovered after a crash ({metadata[RECOVERED]}): its end may be missing"
        raise BagError(bag, found, "a bag that was closed by its recorder")
    return metadata


def relearned(bags: Sequence[Path], config: Config, learner: Learner) -> Iterator[Lesson]:
    """Learn from bags, one after the other, as practice does.

    A trial before which practice had gone back to an earlier network is learned from with that one.

    Args:
        bags: of one arm or of equal ones.
        config: how to learn.
        learner: to begin with.

    Raises:
        BagError: a bag is unfinished, recovered or damaged; it is of another arm than the first; or it goes
            back to the network after a trial whose bag is not among those before it.
        TrainingError: a trial that was completed cannot be learned from, and ``practice.on_abort`` is stop.
    """
    metadata = [require_trainable(bag) for bag in bags]
    require_same_arm(list(zip(bags, metadata, strict=True)))
    wanted = [_gone_back_to(bag, values) for bag, values in zip(bags, metadata, strict=True)]
    kept: dict[tuple[Path, int], Learner] = {}
    for bag, values, back in zip(bags, metadata, wanted, strict=True):
        run = bag.resolve().parent
        kept.setdefault((run, 0), learner)
        note = ""
        if back is not None:
            if (run, back) not in kept:
                found = f"goes back to the network after trial {back}"
                raise BagError(bag, found, f"{trial_bag(bag.parent, back)} among the bags before it")
            learner, note = kept[run, back], f"back to the network {_after(back)}"
        before = revision(learner)
        trial = read_trial(bag)
        if trial.joints != config.arm.joints:
            found = f"is of the joints {', '.join(trial.joints)}"
            raise BagError(bag, found, f"{', '.join(config.arm.joints)}, as in its configuration")
        learner, training, why_not = learned_from(trial, config, learner)
        yield Lesson(
            trial=trial,
            recorded_revision=values.get(REVISION, ""),
            revision=before,
            learner=learner,
            training=training,
            note="; ".join(text for text in (note, why_not) if text),
        )
        if any(back == trial.index for back in wanted):
            kept[run, trial.index] = learner


def learned_from(
    trial: RecordedTrial, config: Config, learner: Learner
) -> tuple[Learner, TrainingOutcome | None, str]:
    """Let a learner learn from one trial, as practice does.

    Returns:
        The learner after the trial, what learning did (None if the trial is not learned from), and why not.

    Raises:
        TrainingError: the trial was completed and cannot be learned from, and ``practice.on_abort`` is stop.
    """
    if not is_learned_from(trial.outcome, bool(trial.run.any()), config.practice.on_abort):
        return learner, None, f"{trial.outcome.name.lower()}: not learned from"
    try:
        samples = configured_samples(trial.signals(), config.learning)
        after, training = learner.trained_on(samples, config.learning.training)
    except TrainingError as error:
        if has_to_teach(trial.outcome, config.practice.on_abort):
            raise TrainingError(f"{trial.bag}: {error}") from None
        return learner, None, f"nothing was learned: {error}"
    return after, training, ""


def _trials_of(run: Path) -> list[Path]:
    bags = trial_bags(run)
    if not bags:
        raise BagError(run, "holds no trials", "the folder of a run with trial_001 and so on")
    for index, bag in enumerate(bags, start=1):
        if bag != trial_bag(run, index):
            raise BagError(trial_bag(run, index), "there is no such folder", f"one, as {bag.name} is there")
    return bags


def _gone_back_to(bag: Path, metadata: dict[str, str]) -> int | None:
    text = metadata.get(GO_BACK_TO, "")
    if not text:
        return None
    if not text.isdigit():
        raise BagError(bag, f"{GO_BACK_TO} in its metadata is {text!r}", "nothing, or the number of a trial")
    return int(text)


def _after(index: int) -> str:
    return f"after trial {index}" if index else "that the run began with"
