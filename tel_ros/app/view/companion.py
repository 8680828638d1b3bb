"""The live view as a process beside a practice run, which does not wait for it and does not need it."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from tel_ros.app.bring_up import die_with_parent, kill_tree

_MODULE = "tel_ros.app.view.main"
_END_TIMEOUT_S = 3.0


class ViewProcess:
    """Starts the view and ends it; use it with ``with``, around the nodes: they start later and end before.

    Nobody looks whether it lives. It gets SIGTERM from the kernel if this process dies.

    Args:
        config_file: of the run.
        log_folder: gets ``view.log``.
        token: the secret in the link.
        tell: called, from another thread, with the link, or with why there is none.
        namespace: of the graph.
    """

    def __init__(
        self,
        config_file: Path,
        log_folder: Path,
        token: str,
        tell: Callable[[str], None],
        namespace: str = "/",
    ) -> None:
        self._config_file, self._log_folder, self._token, self._tell = config_file, log_folder, token, tell
        self._namespace = namespace
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> ViewProcess:
        """Start it, and go on at once."""
        self._log_folder.mkdir(parents=True, exist_ok=True)
        with (self._log_folder / "view.log").open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", _MODULE, str(self._config_file), "0", self._namespace],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,  # Ctrl-C reaches the supervisor only
                preexec_fn=die_with_parent,
            )
        with contextlib.suppress(OSError):  # it may have died already: that is its own affair
            # Shorter than a pipe's buffer, so this does not wait.
            self._process.stdin.write(f"{self._token}\n")
            self._process.stdin.close()
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        """End it."""
        if self._process is None or self._process.poll() is not None:
            return
        self._process.terminate()
        try:
            self._process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            kill_tree(self._process.pid)
            self._process.wait()

    def _listen(self) -> None:
        for line in self._process.stdout:
            self._tell(line.strip())
