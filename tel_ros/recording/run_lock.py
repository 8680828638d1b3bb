"""One practice at a time in the folder of a run."""

from __future__ import annotations

import errno
import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tel_ros.core.errors import InputFileError
from tel_ros.recording.run_folder import CONFIG_FILE


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold the folder of a run; the operating system gives it free when this process ends, however it ends.

    File systems that know no locks do without.

    Args:
        folder: of the run, with its configuration.

    Raises:
        InputFileError: another process holds it, or it has no configuration.
    """
    try:
        file = (folder / CONFIG_FILE).open("rb")
    except OSError as error:
        found = f"cannot be opened ({error.strerror})"
        raise InputFileError(folder / CONFIG_FILE, found, "the folder of a practice run") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                found = "a practice run is under way in it"
                raise InputFileError(folder, found, "a run that was interrupted and has ended") from None
        yield
