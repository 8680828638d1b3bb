"""Saving what a crash has left of a recording: all whole messages of all its files, in a new bag."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import yaml

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError, TelError, counted
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import any_bag, topics
from tel_ros.recording.any_bag import AnyBag, custom_data, information_of
from tel_ros.recording.bag_format import offered_qos
from tel_ros.recording.bag_writer import CUSTOM_DATA_FILE, RECOVERED, UNFINISHED, BagWriter
from tel_ros.recording.data_files import SavedFile, data_kind, save_copy
from tel_ros.recording.trial_bag import check_sums

_EXPECTED = "the folder of a recording that was never closed, or one of its files (.mcap, .db3)"


@dataclass(frozen=True)
class Recovery:
    """What was saved: the folder of the new bag, its messages by topic, and what each file gave.

    ``has_result``: whether the trial had ended, and only the closing of its bag had not.
    """

    bag: Path
    counts: Mapping[str, int]
    files: tuple[SavedFile, ...]
    has_result: bool


def recover(unfinished: Path, out: Path | None = None) -> Recovery:
    """Save what a recording that was never closed, or was damaged, holds; the recording stays as it is.

    The new bag is marked (custom data ``recovered``): nothing is trained on it, and no run is resumed after
    it. ``out`` None: beside a run's bags, where nothing takes it for one of them. BagError: there is no
    recording, it is whole, no message is whole, or the new bag exists or cannot be written.
    """
    files = any_bag.files_in(unfinished)
    if not files:
        raise BagError(unfinished, any_bag.what_is(unfinished), _EXPECTED)
    is_whole = BagError(unfinished, "is whole: there is nothing to recover", _EXPECTED)
    is_staged = unfinished.parent.name == UNFINISHED
    if not is_staged and _is_whole(unfinished, files):
        raise is_whole
    if out is None and is_staged:
        out = unfinished.parent.parent / RECOVERED / unfinished.name
    out = out or unfinished.with_name(f"{unfinished.name.partition('.')[0]}_{RECOVERED}")
    saved, copies = list[SavedFile](), list[Path]()
    try:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            for number, file in enumerate(files):
                copy = folder / str(number) / f"saved_{file.name.removesuffix('.zstd')}"
                try:
                    saved.append(save_copy(file, copy))
                    copies.append(copy)
                except BagError as error:
                    if len(files) == 1:
                        raise
                    saved.append(SavedFile(file.name, 0, file.stat().st_size, False, error.found))
            if files == [unfinished] and saved[0].whole:
                raise is_whole
            if not copies:
                each = "; ".join(f"{file.name} {file.problem}" for file in saved)
                raise BagError(unfinished, f"holds nothing to recover: {each}", "at least one whole chunk")
            reader = AnyBag(folder, copies, stack)
            counts = _rewrite(reader, out, _custom_data(unfinished), data_kind(files[0]))
    except OSError as error:
        raise BagError(unfinished, f"cannot be recovered ({error})", "room on the disk") from error
    has_result = any(n > 0 for name, n in counts.items() if topics.is_named(name, topics.TRIAL_RESULT))
    return Recovery(out, counts, tuple(saved), has_result)


def _is_whole(bag: Path, files: list[Path]) -> bool:
    """Whether the metadata are there, and what they announce is in the data files and nothing else."""
    if not (bag / any_bag.METADATA_FILE).is_file():
        return False
    with suppress(TelError, OSError, ValueError), ExitStack() as stack:
        check_sums(bag)
        found = AnyBag(bag, files, stack)
        announced = {topic: n for topic, _, n in any_bag.announced_topics(bag)}
        return announced == {c.topic: c.msgcount for c in found.connections}
    return False


def _custom_data(unfinished: Path) -> dict[str, str]:
    """Return what was to be stored beside the messages; nothing if that has not reached the disk."""
    if stored := custom_data(information_of(unfinished)):
        return stored
    with suppress(OSError, ValueError, yaml.YAMLError):
        text = (unfinished / CUSTOM_DATA_FILE).read_text(encoding="utf-8")
        return custom_data({"custom_data": yaml.safe_load(text)})
    return {}


def _rewrite(reader: AnyBag, out: Path, metadata: dict[str, str], kind: str) -> dict[str, int]:
    n = sum(connection.msgcount for connection in reader.connections)
    saved = f"{counted(n, 'message')}, up to {(reader.end_time - 1) / NS_PER_S:.3f} s"
    recording = RecordingConfig(storage="mcap" if kind == ".mcap" else "sqlite3")
    with BagWriter(out, metadata | {RECOVERED: saved}, recording) as writer:
        for connection in reader.connections:
            offered = any_bag.profiles(connection) or [offered_qos(connection.topic)]
            writer.add_topic(connection.topic, connection.msgtype, offered, reader.definition(connection))
        for connection, time_ns, raw in reader.messages():
            writer.write(connection.topic, time_ns, raw)
    return writer.counts
