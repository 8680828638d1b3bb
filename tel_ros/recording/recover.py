"""Saving what a crash has left of a recording: everything up to the last whole chunk, into a new bag."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from tel_ros.core.config import RecordingConfig
from tel_ros.core.errors import BagError, counted
from tel_ros.core.types import NS_PER_S
from tel_ros.recording import topics
from tel_ros.recording.bag_format import METADATA_FILE, bag_information, offered_qos
from tel_ros.recording.bag_writer import CUSTOM_DATA_FILE, RECOVERED, UNFINISHED, BagWriter
from tel_ros.recording.shared_files import missing
from tel_ros.recording.trial_bag import check_bag

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER = b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + _MAGIC
"""The end of a file that has no index: https://mcap.dev/spec#footer-op0x02"""
_FOOTER_OPCODE, _DATA_END_OPCODE = 0x02, 0x0F
_HAS_MESSAGES = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = 'messages'"
_EXPECTED = "the folder of a recording that was never closed"


@dataclass(frozen=True)
class Recovery:
    """What was saved: the folder of the new bag, and its messages by topic."""

    bag: Path
    counts: Mapping[str, int]
    lost_bytes: int
    """Of the data file, behind its last whole chunk (MCAP); of the journal (sqlite3), which holds what a
    transaction that did not end has overwritten."""
    has_result: bool
    """Whether the trial had ended, and only the closing of its bag had not."""


def recovered_name(unfinished: Path) -> Path:
    """Return where to put what is recovered: beside a run's bags, where nothing takes it for one of them."""
    if unfinished.parent.name == UNFINISHED:
        return unfinished.parent.parent / RECOVERED / unfinished.name
    return unfinished.with_name(f"{unfinished.name}_{RECOVERED}")


def recover(unfinished: Path, out: Path | None = None) -> Recovery:
    """Save what a recording that was never closed holds; the recording stays as it is.

    The new bag is marked (custom data ``recovered``): nothing is trained on it, and no run is resumed after
    it.

    Args:
        unfinished: folder of the recording, or of a closed bag whose data file was damaged.
        out: folder of the new bag; None: see :func:`recovered_name`.

    Raises:
        BagError: there is no recording, it is whole, no whole chunk is in it, or the new bag exists or
            cannot be written.
    """
    data, storage = _data_file(unfinished)
    if unfinished.parent.name != UNFINISHED and _is_whole(unfinished):
        raise BagError(unfinished, "is whole: there is nothing to recover", _EXPECTED)
    out = recovered_name(unfinished) if out is None else out
    try:
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / data.name
            salvage = _salvage_mcap if storage == "mcap" else _salvage_sqlite3
            lost_bytes = salvage(data, copy)
            counts = _rewrite(copy, out, _custom_data(unfinished), storage)
    except OSError as error:
        raise BagError(unfinished, f"cannot be recovered ({error})", "room on the disk") from error
    has_result = any(n > 0 for name, n in counts.items() if topics.is_named(name, topics.TRIAL_RESULT))
    return Recovery(out, counts, lost_bytes, has_result)


def _data_file(unfinished: Path) -> tuple[Path, Literal["mcap", "sqlite3"]]:
    if not unfinished.is_dir():
        raise BagError(unfinished, missing(unfinished, "folder"), _EXPECTED)
    for file in sorted(unfinished.iterdir()):
        if file.suffix == ".mcap":
            return file, "mcap"
        if file.suffix == ".db3":
            return file, "sqlite3"
    raise BagError(unfinished, "holds no data file (.mcap or .db3)", _EXPECTED)


def _is_whole(bag: Path) -> bool:
    with suppress(BagError):
        check_bag(bag)
        return True
    return False


def _custom_data(unfinished: Path) -> dict[str, str]:
    """Return what was to be stored beside the messages; nothing if that has not reached the disk."""
    try:
        if (unfinished / METADATA_FILE).is_file():
            data = bag_information(unfinished)["custom_data"]
        else:
            data = yaml.safe_load((unfinished / CUSTOM_DATA_FILE).read_text(encoding="utf-8"))
        return {str(key): str(value) for key, value in data.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, yaml.YAMLError):
        return {}


def _salvage_mcap(data: Path, copy: Path) -> int:
    """Write a readable file of all whole chunks, and return how many bytes were left.

    A chunk that is there in full may still hold what the disk has made of it: those at the end that cannot be
    read are left as well.
    """
    content = data.read_bytes()
    for end in reversed(_record_ends(content)):
        copy.write_bytes(content[:end] + _FOOTER)
        if _is_readable(copy):
            return len(content) - end
    raise BagError(data, "holds no whole chunk", "at least one: there is nothing to recover")


def _record_ends(content: bytes) -> list[int]:
    """Return where each whole record of the data section of an MCAP file ends."""
    ends: list[int] = []
    place = len(_MAGIC)
    while content.startswith(_MAGIC) and place + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, place)
        place += 9 + length
        of_data = 0 < opcode < _DATA_END_OPCODE and opcode != _FOOTER_OPCODE
        if not of_data or place > len(content):
            break
        ends.append(place)
    return ends


def _is_readable(file: Path) -> bool:
    """Return whether all messages can be had, and there are some."""
    try:
        with AnyReader([file]):
            return sum(1 for _ in _messages(file)) > 0
    except Exception:  # damaged bytes make the reader and its libraries raise whatever they raise
        return False


def _messages(file: Path) -> Iterator[tuple[str, int, bytes]]:
    """Return topic, time [ns] and bytes of all messages of a data file, in the order in which they lie there.

    The plain way to read wants messages without an index to be in the order of time, which those of different
    topics are not.
    """
    reader = McapReader(file) if file.suffix == ".mcap" else Sqlite3Reader(file)
    reader.open()
    with closing(reader):
        read = reader.messages_scan if isinstance(reader, McapReader) else reader.messages
        for connection, time_ns, raw in read(reader.connections):
            yield connection.topic, time_ns, bytes(raw)


def _salvage_sqlite3(data: Path, copy: Path) -> int:
    """Copy a database, have sqlite3 take back what did not end, and return the size of its journal."""
    shutil.copyfile(data, copy)
    journal, lost_bytes = data.with_name(f"{data.name}-journal"), 0
    if journal.is_file():
        shutil.copyfile(journal, copy.with_name(journal.name))
        lost_bytes = journal.stat().st_size
    try:
        with closing(sqlite3.connect(copy)) as database:
            (said,) = database.execute("PRAGMA integrity_check").fetchone()
            (begun,) = database.execute(_HAS_MESSAGES).fetchone()
            (n,) = database.execute("SELECT count(*) FROM messages").fetchone() if begun else (0,)
    except sqlite3.Error as error:
        raise BagError(data, f"cannot be read ({error})", "a database of rosbag2") from error
    if said != "ok":
        raise BagError(data, f"is damaged ({said})", "a database of rosbag2")
    if n == 0:
        raise BagError(
            data, "holds no transaction that has ended", "at least one: there is nothing to recover"
        )
    return lost_bytes


def _rewrite(
    copy: Path, out: Path, metadata: dict[str, str], storage: Literal["mcap", "sqlite3"]
) -> dict[str, int]:
    with AnyReader([copy]) as reader:
        saved = f"{counted(reader.message_count, 'message')}, up to {(reader.end_time - 1) / NS_PER_S:.3f} s"
        with BagWriter(out, metadata | {RECOVERED: saved}, RecordingConfig(storage=storage)) as writer:
            for connection in reader.connections:
                offered = [offered_qos(connection.topic)]
                writer.add_topic(connection.topic, connection.msgtype, reader.typestore, offered)
            for topic, time_ns, raw in _messages(copy):
                writer.write(topic, time_ns, raw)
    return writer.counts
