"""Writing one trial to one rosbag2 folder that is either whole or not there."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import TracebackType

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError

from tel_ros.core.errors import BagError
from tel_ros.recording import topics
from tel_ros.recording.message_types import typestore

UNFINISHED = ".unfinished"
"""Folder beside the bags in which a bag lies until it is closed."""

CHECKSUMS = "SHA256SUMS"
"""File in a bag with the sums of its data files, as ``sha256sum -c`` reads it.

MCAP has a place for checksums of its own, but rosbags leaves it empty.
"""


def sha256(file: Path) -> str:
    """Return the checksum of a file as ``sha256sum`` prints it."""
    with file.open("rb") as data:
        return hashlib.file_digest(data, "sha256").hexdigest()


class TrialBagWriter:
    """Writes serialised messages as they come, without touching their bytes.

    The bag grows in a folder of its own and gets its name only when it has been closed: a bag under its own
    name is whole. What a crash leaves behind stays under ``.unfinished``.

    Args:
        bag: folder of the bag.
        metadata: stored with the bag as custom data.

    Raises:
        BagError: the bag or an unfinished one of that name exists, or the folder cannot be written.
    """

    def __init__(self, bag: Path, metadata: Mapping[str, str]) -> None:
        self.bag = bag
        self._staging = bag.parent / UNFINISHED / bag.name
        if bag.exists():
            raise BagError(bag, "exists already", "a name that is free: bags are never overwritten")
        if self._staging.exists():
            raise BagError(self._staging, "an unfinished bag of that name is there", "a name that is free")
        self._writer = Writer(self._staging, version=9, storage_plugin=StoragePlugin.MCAP)
        # Chunk by chunk inside the file, as rosbag2 does it: every reader of MCAP knows it.
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in metadata.items():
            self._writer.set_custom_data(key, value)
        try:
            self._writer.open()
        except (OSError, WriterError) as error:
            raise BagError(bag, f"cannot be written ({error})", "a folder that can be written") from error
        types = {**topics.RECORDED_LIVE, **topics.RECORDED_ONCE}
        store = typestore()
        self._connections = {
            topic: self._writer.add_connection(topic, kind, typestore=store) for topic, kind in types.items()
        }
        # Which of the topics of commands a trial has shows when the first one comes.
        self._add_command = partial(self._writer.add_connection, typestore=store)
        self.counts = dict.fromkeys(types, 0)
        """Messages written so far: topic to number."""

    def write(self, topic: str, time_ns: int, serialised: bytes) -> None:
        """Append one serialised message."""
        if topic not in self._connections:
            self._connections[topic] = self._add_command(topic, topics.RECORDED_COMMANDS[topic])
            self.counts[topic] = 0
        self._writer.write(self._connections[topic], time_ns, serialised)
        self.counts[topic] += 1

    def close(self) -> None:
        """Finish the bag and let it appear under its name.

        Raises:
            BagError: the disk did not take it; what there is stays in the folder of unfinished bags.
        """
        try:
            self._writer.close()
            sums = [f"{sha256(file)}  {file.name}\n" for file in self._staging.glob("*.mcap")]
            (self._staging / CHECKSUMS).write_text("".join(sums), encoding="utf-8")
            for file in self._staging.iterdir():
                _sync(file)
            self._staging.rename(self.bag)
            _sync(self.bag.parent)
            if not any(self._staging.parent.iterdir()):
                self._staging.parent.rmdir()
        except OSError as error:
            raise BagError(self.bag, f"could not be closed ({error})", "room on the disk") from error

    def abandon(self) -> None:
        """Give the bag up: what was written stays in the folder of unfinished bags."""
        self._writer.abort()

    def __enter__(self) -> TrialBagWriter:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the bag, or give it up after an error."""
        if kind is None:
            self.close()
        else:
            self.abandon()


def _sync(path: Path) -> None:
    """Have the operating system bring a file or a folder's entries to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
