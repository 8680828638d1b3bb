"""Reading anybody's bags: rosbag1 and rosbag2, whole, split, compressed, with or without metadata.

The data files say what there is. ``metadata.yaml`` adds what was announced and stored beside the messages;
where it is damaged or contradicts them, the data win. What nobody asks for never matters: a definition is
parsed when a message of its type is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from heapq import merge
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos, QosDurability
from rosbags.interfaces import MessageDefinition as Definition
from rosbags.interfaces import MessageDefinitionFormat as Format
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tel_ros.core.errors import BagError, TelError, counted
from tel_ros.recording.bag_format import definition, plain_text, typestore
from tel_ros.recording.data_files import DATA_FILES, data_kind, message_bytes, opened_file
from tel_ros.recording.run_folder import is_run_folder

METADATA_FILE = "metadata.yaml"
EXPECTED = "a closed rosbag2 folder, an .mcap, .db3 or .bag file"
_OF_PYTHON = (TypeError, AttributeError, LookupError, MemoryError, AssertionError, RuntimeError)
_IDL = "=" * 80 + "\nIDL: "


class AnyBag:
    """An open bag; one connection for each topic and type, however many files there are.

    ``msgcount`` of a connection is what the data files say; ``announced`` what the metadata say, if they do.
    """

    def __init__(self, bag: Path, files: Sequence[Path], stack: ExitStack) -> None:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        self.bag, self.is2 = bag, data_kind(files[0]) != ".bag"
        self._storages: list[Any] = []
        for number, file in enumerate(files):
            with reading(file):
                self._storages.append(opened_file(file, folder / str(number)))
            stack.callback(self._storages[-1].close)
        found = dict[tuple[str, str], Connection]()
        for each in (c for storage in self._storages for c in storage.connections):
            first = found.get((each.topic, each.msgtype), each._replace(msgcount=0))
            defined = (first if first.msgdef.data else each).msgdef
            count = first.msgcount + each.msgcount
            found[each.topic, each.msgtype] = first._replace(msgdef=defined, msgcount=count)
        there, told = Counter[str](), Counter[str]()
        for connection in found.values():
            there[connection.topic] += connection.msgcount
        for topic, kind, n in announced_topics(bag):
            told[topic] += n
            if topic not in there:
                ext = ConnectionExtRosbag2("cdr", [])
                nothing = Definition(Format.NONE, "")
                found[topic, kind] = Connection(0, topic, kind, nothing, "", 0, ext, self)
        self._found = {key: c._replace(id=k) for k, (key, c) in enumerate(found.items(), start=1)}
        self.connections = list(self._found.values())
        self.announced = {c.topic: told[c.topic] or there[c.topic] for c in self.connections}
        self._stores = dict[str, Typestore | None]()
        extents = [storage.metadata if self.is2 else storage for storage in self._storages]
        extents = [each for each in extents if each.message_count]
        self.start_time = min((each.start_time for each in extents), default=2**63 - 1)
        """Time [ns] of the earliest message."""
        self.end_time = max((each.end_time for each in extents), default=0)
        """The nanosecond after the latest message."""

    def messages(
        self, connections: Sequence[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time [ns] and bytes, in the order of time; of all, if none is named."""
        wanted = {(c.topic, c.msgtype) for c in connections or self.connections}

        def of(storage: Any) -> Iterator[tuple[Connection, int, bytes]]:
            own = [c for c in storage.connections if (c.topic, c.msgtype) in wanted]
            for c, time_ns, raw in storage.messages(own, start, stop) if own else ():
                yield self._found[c.topic, c.msgtype], time_ns, message_bytes(raw) if self.is2 else raw

        yield from merge(*map(of, self._storages), key=lambda message: message[1])

    def contents(self, connections: Sequence[Connection], *, exactly: bool = False) -> list[tuple[int, Any]]:
        """Return time [ns] and content of a topic's messages; BagError if not all come."""
        found = [
            (time_ns, self.deserialize(raw, c.msgtype)) for c, time_ns, raw in self.messages(connections)
        ]
        n, topic = len(found), connections[0].topic
        announced = self.announced[topic]
        if not exactly:
            announced = max(announced, sum(c.msgcount for c in connections))
        if n < announced or (exactly and n > announced):
            yields = f"yields {counted(n, 'message')} of {topic}"
            raise BagError(self.bag, yields, f"the {announced} that it announces")
        return found

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """Return a message as the bag defines its type; if it does not, as ROS 2 Jazzy or we do."""
        store = self._store(kind) or typestore()
        return store.deserialize_cdr(raw, kind) if self.is2 else store.deserialize_ros1(raw, kind)

    def definition(self, connection: Connection) -> tuple[str, str]:
        """Return text and hash (RIHS01) of a topic's type, as recorded; empty where nobody knows."""
        store = None
        with suppress(Exception):  # what cannot be parsed is passed on as it is
            store = self._store(connection.msgtype)
        if store is not None:
            return connection.msgdef.data, store.hash_rihs01(connection.msgtype)
        if connection.msgdef.data or connection.msgtype not in typestore().types:
            return connection.msgdef.data, connection.digest
        return definition(connection.msgtype)

    def _store(self, kind: str) -> Typestore | None:
        if kind not in self._stores:
            text = next((c.msgdef for c in self.connections if c.msgtype == kind and c.msgdef.data), None)
            self._stores[kind] = None if text is None else _parsed(kind, text)
        return self._stores[kind]


def _parsed(kind: str, text: Definition) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    if text.format == Format.MSG:
        store.register(get_types_from_msg(text.data, kind))
    elif text.data.startswith(_IDL):
        for part in text.data.split(_IDL.partition("\n")[0] + "\n")[1:]:
            store.register(get_types_from_idl(part.partition("\n")[2]))
    else:
        store.register(get_types_from_idl(text.data))
    return store


@contextmanager
def open_any_bag(bag: Path, *, closed: bool = True) -> Iterator[AnyBag]:
    """Open a bag, a ``closed`` one with metadata: without, its recorder may not have come to its end."""
    files = data_files(bag)
    if closed and bag.is_dir() and not (bag / METADATA_FILE).is_file():
        found = f"has no {METADATA_FILE}: it was never closed (`tel bag recover` takes out what can be read)"
        raise BagError(bag, found, EXPECTED)
    with ExitStack() as stack:
        with reading(bag):
            reader = AnyBag(bag, files, stack)
        yield reader


def data_files(bag: Path) -> list[Path]:
    """Return the data files of a bag; BagError if it is none, or the metadata name one that is gone."""
    if bag.is_file() and data_kind(bag) in (*DATA_FILES, ".bag"):
        return [bag]
    files, named = files_in(bag) if bag.is_dir() else [], information_of(bag).get("relative_file_paths")
    names = [Path(str(name)).name for name in named] if isinstance(named, list) else []
    # Files may have been renamed, or be more than the metadata know; fewer is a loss.
    if len(files) < len(names):
        gone = ", ".join(name for name in names if not (bag / name).is_file())
        raise BagError(bag, f"has no {gone}, which its {METADATA_FILE} names", EXPECTED)
    if not files:
        has_metadata = (bag / METADATA_FILE).is_file()
        found = f"has a {METADATA_FILE} but no data file" if has_metadata else what_is(bag)
        raise BagError(bag, found, EXPECTED)
    return files


def files_in(bag: Path) -> list[Path]:
    """Return the data files of rosbag2 that are there, in a folder or as a single file."""
    every = sorted(bag.iterdir()) if bag.is_dir() else [bag]
    return [file for file in every if file.is_file() and data_kind(file) in DATA_FILES]


def what_is(path: Path) -> str:
    """Return what a path is that was taken for a bag, in words for a message."""
    if not path.exists():
        return "there is no such file or folder"
    if path.is_dir() and is_run_folder(path):
        first = next((each.name for each in sorted(path.glob("trial_*"))), "trial_NNN")
        return f"is the folder of a practice run, which holds a bag a trial ({path / first})"
    if path.is_dir():
        inside = next((each for each in sorted(path.iterdir()) if (each / METADATA_FILE).is_file()), None)
        within = f" (but {inside.name} in it is one)" if inside else ""
        return f"is a folder without metadata.yaml and data files: no bag{within}"
    kinds = {".yaml": "a YAML file", ".yml": "a YAML file", ".npz": "a network file", ".csv": "a CSV"}
    return f"is {kinds.get(path.suffix.lower(), f'a file {path.suffix}' if path.suffix else 'a file')}"


def bag_information(bag: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says; BagError if that cannot be read."""
    file, expected = bag / METADATA_FILE, "the metadata of a rosbag2 folder"
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, OSError, ValueError) as error:
        raise BagError(file, f"not readable ({' '.join(str(error).split())})", expected) from error
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(file, "has no rosbag2_bagfile_information", expected)
    return information


def information_of(bag: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says; nothing if that cannot be read."""
    with suppress(BagError):
        return bag_information(bag)
    return {}


def custom_data(information: Mapping[str, Any]) -> dict[str, str]:
    """Return what was stored beside the messages, of the metadata."""
    stored = information.get("custom_data")
    texts = stored if isinstance(stored, dict) else {}
    return {str(key): plain_text(str(value)) for key, value in texts.items()}


def announced_topics(bag: Path) -> Iterator[tuple[str, str, int]]:
    """Yield name, type and number of messages of each topic, as far as the metadata tell them."""
    for each in information_of(bag).get("topics_with_message_count") or ():
        with suppress(TypeError, KeyError, ValueError):
            name, kind = each["topic_metadata"]["name"], each["topic_metadata"]["type"]
            if isinstance(name, str) and isinstance(kind, str):
                yield name, kind, int(each["message_count"])


@contextmanager
def reading(bag: Path, expected: str = EXPECTED) -> Iterator[None]:
    """Make a BagError of whatever damaged bytes make the reader and its libraries raise."""
    try:
        yield
    except TelError:
        raise
    except Exception as error:
        # What Python says where a library has not expected such bytes tells people nothing.
        text = "damaged" if isinstance(error, _OF_PYTHON) else " ".join(str(error).split())
        raise BagError(bag, f"cannot be read ({text})", expected) from error


def is_latched(connection: Connection) -> bool:
    """Return whether late joiners are to get a topic's newest message: as offered, or if it has only one."""
    latching = getattr(connection.ext, "latching", 0)
    offered = [qos.durability for qos in profiles(connection)]
    return connection.msgcount == 1 or bool(latching) or QosDurability.TRANSIENT_LOCAL in offered


def profiles(connection: Connection) -> Sequence[Qos]:
    """Return the quality of service that was offered; ROS 1 knows none."""
    return getattr(connection.ext, "offered_qos_profiles", ())
