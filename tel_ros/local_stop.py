"""Stopping the controller from the same computer without ROS: a datagram, or a signal of who started it.

ROS takes seconds to start and to find its nodes. A controller listens at an abstract address of Linux, which
tells its domain, process and namespace, needs no folder, and is gone with its process. Only the standard
library is imported here, and little of it: an arm is moving.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import time
import zlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import NamedTuple

from tel_ros.core.errors import ConfigError

BRAKE_SIGNAL = signal.SIGUSR1
"""To a node: stop as if it were to end, but go on answering until it is told to end."""
ENDED = "ended: "
"""Begins the last line of a controller's log: what was seen of the arm at the end."""
STOP, RESET = "stop", "reset"
ANSWER_TIMEOUT_S = 1.0
HIGHEST_DOMAIN = 232
"""The ports of Fast DDS and Cyclone DDS reach as far."""
_PREFIX, _LONGEST = "tel_ros/controller", 100
_SOCKETS = "/proc/net/unix"


class Answer(NamedTuple):
    """What a controller answers: whether it has done it, and what it says."""

    success: bool
    message: str


class Controller(NamedTuple):
    """A controller that runs on this computer."""

    domain: int
    pid: int
    namespace: str

    @property
    def address(self) -> str:
        """Where it listens. A namespace that is too long for an address stands there by its checksum."""
        name = f"\0{_PREFIX}/{self.domain}/{self.pid}"
        if len(name + self.namespace) <= _LONGEST:
            return name + self.namespace
        return f"{name}/#{zlib.crc32(self.namespace.encode())}"

    def is_in(self, namespace: str) -> bool:
        """Return whether it runs in a namespace."""
        return self.address == self._replace(namespace=namespace).address


def domain_id() -> int:
    """Return the ROS domain of this process's environment; ConfigError: ROS_DOMAIN_ID is none."""
    value = os.environ.get("ROS_DOMAIN_ID", "")
    number = re.fullmatch(r"\s*(0x[0-9a-f]+|\d+)", value or "0", re.IGNORECASE)
    domain = int(number[1], 16 if "x" in number[1].lower() else 10) if number else -1
    if not 0 <= domain <= HIGHEST_DOMAIN:
        raise ConfigError("ROS_DOMAIN_ID", value, f"a number from 0 to {HIGHEST_DOMAIN}", "environment")
    return domain


def controllers() -> list[Controller]:
    """Return the controllers that run on this computer, in all domains."""
    with open(_SOCKETS, encoding="utf-8", errors="replace") as sockets:
        found = re.findall(rf"@{_PREFIX}/(\d+)/(\d+)(/\S*)$", sockets.read(), re.MULTILINE)
    return [Controller(int(domain), int(pid), namespace) for domain, pid, namespace in found]


def ask(asked: Iterable[Controller], request: str) -> dict[Controller, Answer | None]:
    """Return the answers to a request; None: none has come in time.

    All are told before any answer is waited for: one that hangs must not keep the others from stopping.
    """
    answers = dict[Controller, Answer | None].fromkeys(asked)
    silent = dict[bytes, Controller]()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as asker:
        asker.bind("")  # at an address that Linux chooses, for the answers
        for each in answers:
            with suppress(OSError):  # gone, or it hangs and many have asked
                asker.sendto(request.encode(), each.address)
                silent[each.address.encode()] = each
        end = time.monotonic() + ANSWER_TIMEOUT_S
        while silent and (left_s := end - time.monotonic()) > 0.0:
            asker.settimeout(left_s)
            try:
                said, address = asker.recvfrom(4096)
            except OSError:
                break
            if address in silent:
                answers[silent.pop(address)] = Answer(said[:1] == b"1", said[1:].decode())
    return answers


class Listener:
    """The controller's side: when its owner looks, it answers requests by what is to be done for each."""

    def __init__(self, me: Controller, answers: Mapping[str, Callable[[], Answer]]) -> None:
        self._answers = answers
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._socket.bind(me.address)

    def serve(self) -> None:
        """Answer one request, if one has come; it takes a microsecond if none has."""
        try:
            request, asker = self._socket.recvfrom(64)
        except OSError:
            return
        if answer := self._answers.get(request.decode(errors="replace")):
            success, message = answer()
            with suppress(OSError):  # whoever has asked may be gone; it is done all the same
                self._socket.sendto(f"{int(success)}{message}".encode(), asker)
