"""The folder of a practice run: configuration, bags, network and summary."""

from __future__ import annotations

import dataclasses
import errno
import fcntl
import json
import math
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tel_ros.core.config import Config, file_keys, file_values, with_files
from tel_ros.core.errors import BagError, InputFileError, NetworkFileError
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import config_from, dump_config, flat_values, load_config, read_yaml
from tel_ros.recording.provenance import versions
from tel_ros.recording.shared_files import replacing

CONFIG_FILE = "run.yaml"
SUMMARY_FILE = "summary.json"
NETWORK_FILE = "network/network.npz"
REPORT_FILE = "report.html"
LOG_FOLDER = "log"


def create_run_folder(folder: Path, config: Config) -> Config:
    """Make a folder for a run and write the configuration into it, complete with the files that it names.

    Returns:
        The configuration as written, with the copies in the folder instead of the original files.

    Raises:
        InputFileError: the folder exists or cannot be made.
    """
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise InputFileError(folder, "exists already", "a folder that is new (option --out)") from None
    except OSError as error:
        raise InputFileError(
            folder, f"cannot be made ({error.strerror})", "a folder that can be written"
        ) from error
    return write_run_config(folder, config)


def write_run_config(folder: Path, config: Config) -> Config:
    """Write a configuration into a folder, with the files that it names; return it as written."""
    copies: dict[str, str] = {}
    for key, file in file_values(config).items():
        # Two files of different folders may have one name.
        taken = file.name in copies.values()
        copies[key] = f"{key.split('.')[1]}_{file.name}" if taken else file.name
        with suppress(shutil.SameFileError):
            shutil.copy(file, folder / copies[key])
    written = dataclasses.replace(with_files(config, copies), versions=versions())
    write_atomically(folder / CONFIG_FILE, dump_config(written))
    return written


def open_run_folder(folder: Path, config: Config) -> Config:
    """Return the configuration that is written in the folder of a new run; a missing folder is made.

    What is written there has to be ``config``: bags store the former, practice follows the latter.

    Raises:
        InputFileError: the folder holds no run's configuration, another one, or more than that, or cannot be
            made.
        ConfigError: the configuration in it is wrong.
    """
    if not folder.exists():
        return create_run_folder(folder, config)
    file = folder / CONFIG_FILE
    made_by_runs = [folder / SUMMARY_FILE, folder / UNFINISHED, *folder.glob("trial_*")]
    if not file.exists() or any(path.exists() for path in made_by_runs):
        raise InputFileError(folder, "holds something already", f"a new folder, or one with a {CONFIG_FILE}")
    used, written = flat_values(config), flat_values(load_config(file))
    for key in used | written:
        value = written.get(key)
        same = _contents(value) == _contents(used.get(key)) if key in file_keys() else value == used.get(key)
        if not same and not key.startswith("versions"):
            expected = f"{used.get(key)!r}, as in the configuration of the nodes, or a new folder"
            raise InputFileError(file, f"{key} is {value!r}", expected)
    return written_config(folder)


def _contents(names: Any) -> list[str | bytes]:
    """Return what the files of a key hold; of what names no file, the name."""
    files = [names] if isinstance(names, str) else names
    return [Path(name).read_bytes() if Path(name).is_file() else name for name in files]


def written_config(folder: Path) -> Config:
    """Return the configuration of a run as it is written in its folder, files named relative to it."""
    file = folder / CONFIG_FILE
    return config_from(read_yaml(file), lambda key: str(file))


def is_run_folder(folder: Path) -> bool:
    """Return whether a practice run has begun in a folder."""
    return (folder / CONFIG_FILE).is_file() or (folder / SUMMARY_FILE).is_file()


def trial_bag(folder: Path, index: int) -> Path:
    """Return the folder of a trial's bag."""
    return folder / f"trial_{index:03d}"


def trial_bags(folder: Path) -> list[Path]:
    """Return the bags in the folder of a run, in the order of the trials."""
    bags = [bag for bag in folder.glob("trial_*") if bag.name.removeprefix("trial_").isdigit()]
    return sorted(bags, key=lambda bag: int(bag.name.removeprefix("trial_")))


def require_all_before_last(folder: Path, bags: Sequence[Path]) -> None:
    """Raise a BagError if a trial before the last one of a run has no bag."""
    for index, bag in enumerate(bags, start=1):
        if bag != trial_bag(folder, index):
            found = "there is no such folder"
            raise BagError(trial_bag(folder, index), found, f"one, as {bag.name} is there")


def network_after(folder: Path, index: int) -> Path:
    """Return the file of the network as it was after a trial; 0: as the run began."""
    return folder / "network" / f"after_{index:03d}.npz"


def publish_network(folder: Path, index: int) -> None:
    """Make ``network/network.npz`` the network as it was after a trial: a second name of the same file.

    The change is atomic. A file system without hard links gets a copy. Files of networks are only ever
    replaced, never written to, so the two names do not disturb each other. NetworkFileError if the disk does
    not take it.
    """
    file = folder / NETWORK_FILE
    beside = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        beside.unlink(missing_ok=True)
        try:
            beside.hardlink_to(network_after(folder, index))
        except OSError:
            shutil.copyfile(network_after(folder, index), beside)
        beside.replace(file)
        beside.unlink(missing_ok=True)  # rename does nothing where both are the same file already
    except OSError as error:
        raise NetworkFileError(file, f"cannot be written ({error})", "a file that can be written") from error


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write the summary of a run, atomically; numbers that are not finite become null.

    Raises:
        InputFileError: the disk does not take it; an earlier summary is still there.
    """
    file = folder / SUMMARY_FILE
    try:
        write_atomically(file, json.dumps(json_ready(summary), indent=2) + "\n")
    except OSError as error:
        raise InputFileError(file, f"cannot be written ({error})", "room on the disk") from error


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the summary of a run; InputFileError if there is none, or it is not readable."""
    file = folder / SUMMARY_FILE
    try:
        summary: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputFileError(file, "there is no such file", "the folder of a practice run") from None
    except NotADirectoryError:
        raise InputFileError(folder, "is a file", "the folder of a practice run") from None
    except (OSError, ValueError) as error:
        raise InputFileError(file, f"not readable ({error})", "the summary of a practice run") from error
    return summary


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that a reader finds the old one or the new one, never half of one."""
    with replacing(path) as file:
        file.write(text.encode())


def json_ready(value: Any) -> Any:
    """Return a value with null in place of every number that is not finite: JSON knows none of those."""
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def run_lock(folder: Path, name: str = CONFIG_FILE, what: str = "practice run") -> Iterator[None]:
    """Hold the folder of a run; the operating system gives it free when this process ends, however it ends.

    It is held by the file ``name``, which must not be replaced meanwhile. File systems that know no locks do
    without. Raises InputFileError if another process holds it, or it has no such file.
    """
    try:
        file = (folder / name).open("rb")
    except OSError as error:
        found = f"cannot be opened ({error.strerror})"
        raise InputFileError(folder / name, found, f"the folder of a {what}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                found = f"a {what} is under way in it"
                raise InputFileError(folder, found, "a run that was interrupted and has ended") from None
        yield
