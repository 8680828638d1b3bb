"""Writing one trial to one rosbag2 folder that is either whole or not there."""

from __future__ import annotations

import hashlib
import os
import shutil
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

import yaml
from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_format import as_yaml_keeps_it, definition, offered_qos

UNFINISHED = ".unfinished"
"""Folder beside the bags in which a bag lies until it is closed."""

CHECKSUMS = "SHA256SUMS"
"""File in a bag with the sums of its data files for ``sha256sum -c``: rosbags leaves MCAP's own empty."""

CUSTOM_DATA_FILE = "custom_data.yaml"
"""File in an unfinished bag with the metadata, which rosbag2 stores only when it closes a bag."""

RECOVERED = "recovered"
"""Key of the custom data that marks a bag as saved after a crash, and says how much was saved."""

_UNKNOWN = f"RIHS01_{'0' * 64}"
"""Hash of a type that nobody can parse."""
_PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
_DISK_ERRORS = (OSError, sqlite3.Error)


def sha256(file: Path) -> str:
    """Return the checksum of a file as ``sha256sum`` prints it."""
    with file.open("rb") as data:
        return hashlib.file_digest(data, "sha256").hexdigest()


def free_mb(path: Path) -> float:
    """Return the free space [MB] on the disk of a file or folder that exists or will."""
    existing = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    return shutil.disk_usage(existing).free / 1e6


class BagWriter:
    """Writes serialised messages as they come, without touching their bytes.

    The bag grows under ``.unfinished`` and gets its name only when it is closed: a bag under its own name is
    whole. A crash of this process or of the machine costs at most the last ``chunk_s`` of messages.

    Raises BagError if the bag or an unfinished one of that name exists, or the folder cannot be written.
    """

    def __init__(
        self, bag: Path, metadata: Mapping[str, str], recording: RecordingConfig | None = None
    ) -> None:
        recording = recording or RecordingConfig()
        self.bag, self._staging = bag, bag.parent / UNFINISHED / bag.name
        if bag.exists():
            raise BagError(bag, "exists already", "a name that is free: bags are never overwritten")
        if self._staging.exists():
            raise BagError(self._staging, "an unfinished bag of that name is there", "a name that is free")
        self._writer = Writer(self._staging, version=9, storage_plugin=_PLUGINS[recording.storage])
        if recording.storage == "mcap":
            # Chunk by chunk inside the file, as rosbag2 does it: every reader of MCAP knows it.
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in metadata.items():
            self._writer.set_custom_data(key, as_yaml_keeps_it(key, value))
        try:
            self._writer.open()
            text = yaml.safe_dump(self._writer.custom_data, allow_unicode=True)
            (self._staging / CUSTOM_DATA_FILE).write_text(text, encoding="utf-8")
            for path in (self._staging / CUSTOM_DATA_FILE, self._staging, self._staging.parent):
                _sync(path)
        except (*_DISK_ERRORS, WriterError) as error:
            raise BagError(bag, f"cannot be written ({error})", "a folder that can be written") from error
        self._connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}
        """Messages written so far: topic to number."""
        self._chunk_ns = round(recording.chunk_s * NS_PER_S)
        self._chunk_began_ns: int | None = None
        self._disk_refused = False

    def add_topic(
        self, topic: str, kind: str, offered: Sequence[Qos], defined: tuple[str, str] | None = None
    ) -> None:
        """Announce a topic and how to play it; ``defined``: text and hash of a type not of ours."""
        text, type_hash = defined or definition(kind)
        self._connections[topic] = self._writer.add_connection(
            topic, kind, msgdef=text, rihs01=type_hash or _UNKNOWN, offered_qos_profiles=offered
        )
        self.counts[topic] = 0

    def write(self, topic: str, time_ns: int, serialised: bytes) -> None:
        """Append one serialised message; raise a BagError if the disk does not take it."""
        try:
            self._writer.write(self._connections[topic], time_ns, serialised)
            self.counts[topic] += 1
            if self._chunk_began_ns is None:
                self._chunk_began_ns = time_ns
            # A clock that has jumped back ends a chunk, too.
            elif abs(time_ns - self._chunk_began_ns) >= self._chunk_ns:
                self.flush()
        except _DISK_ERRORS as error:
            raise self._disk_error("cannot be written", error) from error

    def flush(self) -> None:
        """End the chunk (MCAP) or transaction (sqlite3), and wait until it is on the disk.

        rosbags does the former by itself after a megabyte, the latter only at the end.
        """
        storage = self._writer.storage
        try:
            if isinstance(storage, McapWriter):
                if storage.chunk.bio.tell():
                    storage.close_chunk()
                storage.bio.flush()
                os.fdatasync(storage.bio.fileno())
            elif isinstance(storage, Sqlite3Writer):
                storage.conn.commit()  # which waits for the disk: sqlite's default
            self._chunk_began_ns = None
        except _DISK_ERRORS as error:
            raise self._disk_error("cannot be written", error) from error

    def close(self) -> None:
        """Finish the bag and let it appear under its name; BagError if the disk does not take it."""
        storage = self._writer.storage
        if storage is None:
            raise BagError(self.bag, "is closed already", "a bag that is open")
        try:
            data = storage.path
            self._writer.close()
            text = (self._staging / "metadata.yaml").read_text(encoding="utf-8")
            written = yaml.load(text, Loader=yaml.CSafeLoader)["rosbag2_bagfile_information"]["custom_data"]
            if (written or {}) != self._writer.custom_data:
                raise BagError(self.bag, "its metadata read otherwise than they were written", "the same")
            (self._staging / CHECKSUMS).write_text(f"{sha256(data)}  {data.name}\n", encoding="utf-8")
            for path in (*self._staging.iterdir(), self._staging):
                _sync(path)
            (self._staging / CUSTOM_DATA_FILE).unlink()
            self._staging.rename(self.bag)
            _sync(self.bag.parent)
            if not any(self._staging.parent.iterdir()):
                self._staging.parent.rmdir()
        except _DISK_ERRORS as error:
            with suppress(*_DISK_ERRORS):
                self._writer.abort()
            raise self._disk_error("could not be closed", error) from error

    def abandon(self) -> None:
        """Give the bag up: what was written stays in the folder of unfinished bags."""
        if not self._disk_refused:  # a disk that did not take a part of a chunk must not get the rest
            with suppress(BagError):
                self.flush()
        with suppress(*_DISK_ERRORS):
            self._writer.abort()

    def discard(self) -> None:
        """Remove what there is of a bag that was given up; a closed one stays."""
        shutil.rmtree(self._staging, ignore_errors=True)
        with suppress(OSError):  # bags of others are in there
            self._staging.parent.rmdir()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def _disk_error(self, what: str, error: Exception) -> BagError:
        self._disk_refused = True
        found = f"{what} ({error}; {free_mb(self._staging):.0f} MB are free there)"
        return BagError(self.bag, found, "room on the disk")


class TrialBagWriter(BagWriter):
    """Writes the bag of a trial, whose topics are those of :mod:`topics`, in a namespace."""

    def __init__(
        self,
        bag: Path,
        metadata: Mapping[str, str],
        recording: RecordingConfig | None = None,
        namespace: str = "/",
    ) -> None:
        super().__init__(bag, metadata, recording)
        self._namespace = namespace
        for topic, kind in (topics.RECORDED_LIVE | topics.RECORDED_ONCE).items():
            name = topics.absolute(topic, namespace)
            self.add_topic(name, kind, [offered_qos(name)])

    def write(self, topic: str, time_ns: int, serialised: bytes) -> None:
        """Append one serialised message; raise a BagError if the disk does not take it."""
        name = topics.absolute(topic, self._namespace)
        if name not in self.counts:
            # Which of the topics of commands a trial has shows when the first one comes.
            self.add_topic(name, topics.RECORDED_COMMANDS[topic], [offered_qos(name)])
        super().write(name, time_ns, serialised)


def _sync(path: Path) -> None:
    """Have the operating system bring a file or a folder's entries to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
