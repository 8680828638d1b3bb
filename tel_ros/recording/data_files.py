"""Data files of rosbag2 as rosbags reads them; and copies of those that it does not read, or not to the end.

MCAP leaves much to its writers: index, summary, statistics, profile and encodings of definitions are optional
or free. rosbags wants them as rosbag2 writes them, and yields less, or nothing, of what is otherwise.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from tel_ros.core.errors import BagError

DATA_FILES = (".mcap", ".db3")
_PACKED = ".zstd"
_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a compressed message; those of CDR are never these."""
_DEFINITIONS = ("ros2msg", "ros2idl", "omgidl", "")
_QOS = "offered_qos_profiles"
_LEAST_ROW_BYTES, _MOST_TRIES = 20, 2_000_000
_SIZE = ("page_count", "page_size")


class McapFile(McapReader):
    """An MCAP file; without an index its messages are put in the order of time."""

    def messages(self, connections: Any, start: int | None = None, stop: int | None = None) -> Any:
        """Return connection, time [ns] and bytes of the messages of some connections."""
        if self.chunks:
            return super().messages(connections, start, stop)
        return iter(sorted(self.messages_scan(connections, start, stop), key=lambda message: message[1]))

    @property
    def is_complete(self) -> bool:
        """Whether the index leads to all messages that the statistics count."""
        counts = [sum(chunk.channel_count.values()) for chunk in self.chunks]
        of_topics = sum(connection.msgcount for connection in self.connections)
        good = [of_topics, sum(counts)] if counts else [of_topics]
        return (any(counts) or not counts) and set(good) == {self.metadata.message_count}


_READERS: dict[str, Any] = {".mcap": McapFile, ".db3": Sqlite3Reader, ".bag": Reader1}


def data_kind(file: Path) -> str:
    """Return the ending that tells a data file's kind, of a compressed one as well."""
    return Path(file.stem).suffix if file.suffix == _PACKED else file.suffix


def message_bytes(raw: bytes) -> bytes:
    """Return a message's bytes, uncompressed."""
    if raw[:4] != _ZSTD:
        return bytes(raw)
    import zstandard  # late: few bags have compressed messages

    return zstandard.ZstdDecompressor().decompressobj().decompress(raw)


def opened_file(file: Path, folder: Path) -> Any:
    """Return an open reader of a data file, or of a copy in ``folder``, where it takes one."""
    file = _plain(file, folder)
    reader, failed = _READERS[file.suffix](file), None
    if file.suffix == ".bag" or not any(_beside(file)):
        try:
            reader.open()
            if not isinstance(reader, McapFile) or reader.is_complete:
                return reader
            reader.close()
        except Exception as error:
            if file.suffix == ".bag":
                raise
            failed = error
    copy, saved = folder / f"saved_{file.name}", None
    with suppress(BagError):
        saved = save_copy(file, copy)
    if failed and not (saved and saved.whole):
        said = " ".join(str(failed).split()) or "no text"
        expected = "a whole one" + (": `tel bag recover` takes out what can be read" if saved else "")
        raise BagError(file, f"cannot be read: was cut off, or is damaged ({said})", expected) from failed
    if saved:
        reader = _READERS[file.suffix](copy)
    reader.open()
    return reader


@dataclass(frozen=True)
class SavedFile:
    """What was saved of a data file: all whole messages, in a copy which rosbags reads.

    ``lost_bytes``: of the file that are not in it; in sqlite3, of pages that are gone, and of the journal,
    which holds what a transaction that did not end has overwritten. ``whole``: the file is undamaged and was
    closed.
    """

    name: str
    messages: int
    lost_bytes: int
    whole: bool
    problem: str = ""


def save_copy(file: Path, copy: Path) -> SavedFile:
    """Write a copy of what can be read of a data file; BagError if that is nothing, or it is no data file."""
    copy.parent.mkdir(parents=True, exist_ok=True)
    plain = _plain(file, copy.parent)
    n, lost_bytes, whole = (_save_mcap if plain.suffix == ".mcap" else _save_sqlite3)(plain, copy)
    if not n:
        what = "whole chunk" if plain.suffix == ".mcap" else "transaction that has ended"
        raise BagError(plain, f"holds no {what}", "at least one: there is nothing to recover")
    return SavedFile(file.name, n, lost_bytes, whole and not lost_bytes)


def _plain(file: Path, folder: Path) -> Path:
    if file.suffix != _PACKED:
        return file
    import zstandard

    folder.mkdir(parents=True, exist_ok=True)
    plain = folder / file.stem
    with file.open("rb") as packed, plain.open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(packed, target)
    return plain


def _save_mcap(file: Path, copy: Path) -> tuple[int, int, bool]:
    """Copy all whole messages; return their number, the lost bytes and whether the file was closed."""
    # Late: few bags need it.
    from mcap.records import Channel, Footer, Message, Schema
    from mcap.writer import Writer

    schemas, channels, n, good, closed = {0: 0}, dict[int, int](), 0, 0, False
    with file.open("rb") as source, copy.open("wb") as target:
        writer = Writer(target)
        writer.start(profile="ros2")
        for records, n_bytes in _whole_records(source):
            good += n_bytes
            for record in records:
                if isinstance(record, Message) and record.channel_id in channels:
                    of = channels[record.channel_id]
                    writer.add_message(of, record.log_time, record.data, record.publish_time)
                    n += 1
                elif isinstance(record, Schema) and record.id not in schemas:
                    encoding = record.encoding if record.encoding in _DEFINITIONS else ""
                    schemas[record.id] = writer.register_schema(record.name, encoding, record.data)
                elif isinstance(record, Channel) and record.id not in channels:
                    of, told = schemas.get(record.schema_id, 0), record.metadata.get(_QOS, "")
                    qos = {_QOS: told} if _is_qos(told) else {}
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, of, qos
                    )
                closed = closed or isinstance(record, Footer)
        writer.finish()  # type: ignore[no-untyped-call]
    return n, file.stat().st_size - good, closed


def _whole_records(source: BinaryIO) -> Iterator[tuple[list[Any], int]]:
    """Yield the records of each undamaged chunk and all others, with the bytes of the file that they take."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    place = 0
    with suppress(Exception):  # damaged bytes make it raise whatever they make it raise: the file ends here
        for record in StreamReader(source, emit_chunks=True).records:
            begin, place, found = place, source.tell(), [record]
            if isinstance(record, Chunk):
                try:
                    found = breakup_chunk(record, validate_crc=True)
                except Exception:  # the next one may be whole
                    continue
            yield found, place - begin
        yield [], source.tell() - place


def _save_sqlite3(file: Path, copy: Path) -> tuple[int, int, bool]:
    source = copy.with_name(f"source_{file.name}")
    for each in (file, *_beside(file)):  # with these, sqlite3 takes back or completes what did not end
        shutil.copyfile(each, source.with_name(f"source_{each.name}"))
    journal = file.with_name(f"{file.name}-journal")
    lost_bytes = journal.stat().st_size if journal.is_file() else 0
    try:
        with closing(sqlite3.connect(source)) as old, closing(sqlite3.connect(copy)) as new, new:
            # Else sqlite3 refuses a file with fewer pages than it was to have.
            old.execute("PRAGMA writable_schema = ON")
            n, whole = _copy_rows(old, new, min(file.stat().st_size // _LEAST_ROW_BYTES, _MOST_TRIES))
            pages, bytes_a_page = (old.execute(f"PRAGMA {name}").fetchone()[0] for name in _SIZE)
    except sqlite3.Error as error:
        raise BagError(file, f"cannot be read ({error})", "a database of rosbag2") from error
    with file.open("rb") as header:  # how many pages there were, as the database itself says
        pages = max(pages, int.from_bytes(header.read(32)[28:], "big"))
    lost_bytes += max(0, pages * bytes_a_page - file.stat().st_size)
    return n, lost_bytes, whole


def _copy_rows(old: sqlite3.Connection, new: sqlite3.Connection, most_rows: int) -> tuple[int, bool]:
    """Copy all rows that are not damaged; return the number of messages and whether that is all."""
    tables = old.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall()
    whole = True
    for name, sql in tables:
        new.execute(sql)
        last = -1
        while last < most_rows:
            try:  # names are the database's own
                for number, *row in old.execute(f"SELECT rowid, * FROM {name} WHERE rowid > ?", (last,)):
                    new.execute(f"INSERT INTO {name} VALUES ({','.join('?' * len(row))})", row)
                    last = number
                break
            except sqlite3.DatabaseError:  # behind the damaged page there may be others
                whole, last = False, last + 1
    names = {name for name, _ in tables}
    if "messages" not in names:
        return 0, False
    if "message_definitions" in names:
        new.execute("DELETE FROM message_definitions WHERE encoding NOT IN ('ros2msg', 'ros2idl')")
    if any(row[1] == _QOS for row in new.execute("PRAGMA table_info(topics)")):
        for number, told in new.execute(f"SELECT id, {_QOS} FROM topics").fetchall():
            if not _is_qos(told):
                new.execute(f"UPDATE topics SET {_QOS} = '' WHERE id = ?", (number,))
    (said,) = old.execute("PRAGMA integrity_check").fetchone() if whole else ("damaged",)
    (n,) = new.execute("SELECT count(*) FROM messages").fetchone()
    return n, said == "ok"


def _beside(file: Path) -> list[Path]:
    """Return what sqlite3 keeps beside a database that was not closed."""
    both = [file.with_name(f"{file.name}{ending}") for ending in ("-wal", "-journal")]
    return [each for each in both if each.is_file() and each.stat().st_size]


def _is_qos(text: str) -> bool:
    try:
        parse_qos(text)
        return True
    except Exception:  # the parser believes that it is what rosbag2 writes
        return False
