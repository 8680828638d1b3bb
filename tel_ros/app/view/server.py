"""A viser server that only its owner can use.

viser has no authentication, listens everywhere, and lets every client change the handlers of every button or
ask for a public tunnel. So it listens only at a socket file in a folder that nobody but this user may enter.
The only way there is a server of ours at the loopback address, which judges each request and passes on only
what a client may say (:func:`harmless`).

It lets in whoever knows the token: from the link in the terminal at first, from a cookie after that. Pages of
other origins can send requests to this machine, too, and the browser adds the cookie to them. So the origin
of a socket is checked as well, and the host name of the request, against foreign names that point here.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http.client
import io
import socket
import tempfile
import threading
from collections.abc import Iterator, Sequence
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
import viser
import viser.infra
from websockets.asyncio.client import unix_connect
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Origin

from tel_ros.app.view import ViewError

HOST = "127.0.0.1"
"""The view listens here only: other machines cannot reach it."""
SHIELD = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",  # no other page may cover the buttons
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every answer."""
_TIMEOUT_S = 10.0
MAY_SAY = ("ViewerCameraMessage", "GuiUpdateMessage")
"""Names of viser's messages that a client may send: where its camera is, and the value of an input."""


def harmless(message: str | bytes) -> bytes | None:
    """Return a message of a client as it may be passed on, None if the client may not say this.

    It may say where its camera is and what value an input has (a click is one). Everything else is dropped:
    new handlers for somebody's buttons, uploads, tunnels, dragged parts, and whatever is unknown.
    """
    try:
        said = msgspec.msgpack.decode(message)  # type: ignore[arg-type]  # text is refused
    except (msgspec.DecodeError, TypeError):
        return None
    if not isinstance(said, dict) or said.get("type") not in MAY_SAY:
        return None
    updates = said.get("updates")
    if said["type"] == "GuiUpdateMessage" and (not isinstance(updates, dict) or set(updates) != {"value"}):
        return None
    return msgspec.msgpack.encode(said)  # what was looked at, not what was sent


class OwnersServer:
    """viser behind a gate; ViewError if the port is taken or viser cannot be protected."""

    def __init__(self, token: str, port: int, label: str) -> None:
        if not token:
            raise ValueError("the token is empty: everybody would know it")
        unknown = set(MAY_SAY) - {message.__name__ for message in viser.infra.Message.get_subclasses()}
        if unknown:
            raise ViewError(
                f"the live view stays shut: viser {viser.__version__} has no {', '.join(unknown)}"
            )
        self._token = token.encode()
        self._closing = contextlib.ExitStack()
        try:
            listener = self._closing.enter_context(_listener(port))
            self.port = listener.getsockname()[1]
            self._cookie = f"tel_view_{self.port}"  # cookies do not know ports: each view has its own
            self._hosts = (f"{HOST}:{self.port}", f"localhost:{self.port}")
            # By number: localhost may have a second address, at which somebody else listens.
            self.link = f"http://{HOST}:{self.port}/?token={token}"
            folder = self._closing.enter_context(tempfile.TemporaryDirectory(prefix="tel_view_"))  # mode 0700
            self._file = Path(folder) / "viser"
            # viser prints an address that nobody is to use.
            with _servers_listen_at(self._file), contextlib.redirect_stdout(io.StringIO()):
                self.viser = viser.ViserServer(host=HOST, port=self.port, label=label, verbose=False)
            self._closing.callback(self.viser.stop)
            if not self._file.is_socket():
                raise ViewError("the live view stays shut: viser did not open its socket as expected")
            self._open(listener)
        except BaseException:
            self._closing.close()
            raise

    def stop(self) -> None:
        """Close the page."""
        self._closing.close()

    def _open(self, listener: socket.socket) -> None:
        """Let requests in, on a thread of its own."""
        loop, ready = asyncio.new_event_loop(), threading.Event()

        async def run() -> None:
            stop = asyncio.Event()
            self._closing.callback(loop.call_soon_threadsafe, stop.set)
            async with serve(
                self._relay,
                sock=listener,
                process_request=self._answer,
                origins=[Origin(f"http://{host}") for host in self._hosts],
                # The protocol names viser's version, which viser checks.
                select_subprotocol=lambda _, offered: next(
                    (name for name in offered if name.startswith("viser-v")), None
                ),
                compression=None,
                max_size=2**16,  # where a camera is, or a click, needs less
            ):
                ready.set()
                await stop.wait()

        thread = threading.Thread(target=lambda: loop.run_until_complete(run()), daemon=True)
        self._closing.callback(thread.join, _TIMEOUT_S)
        thread.start()
        if not ready.wait(_TIMEOUT_S):
            raise ViewError("the live view does not come up")

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for a file; None lets a socket be opened, if its origin is one of ours."""
        hosts = request.headers.get_all("Host")
        asked = parse_qs(urlsplit(request.path).query).get("token", [])
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            response = connection.respond(HTTPStatus.FORBIDDEN, "Not the name of this server.\n")
        elif len(asked) == 1 and self._is_token(asked[0]):
            # The token must not stay in the address bar, where others could read it.
            response = connection.respond(HTTPStatus.SEE_OTHER, "")
            cookie = f"{self._cookie}={asked[0]}; HttpOnly; SameSite=Strict; Path=/"
            response.headers.update({"Location": "/", "Set-Cookie": cookie})
        elif not self._is_token(self._shown(request.headers.get_all("Cookie"))):
            text = "Open the link with the token that tel has printed in its terminal.\n"
            response = connection.respond(HTTPStatus.UNAUTHORIZED, text)
        elif request.headers.get("Upgrade", "").lower() == "websocket":
            return None
        else:
            response = await asyncio.to_thread(_fetch, self._file, request)
        response.headers.update(SHIELD)
        return response

    def _shown(self, cookies: Sequence[str]) -> str:
        jar = SimpleCookie()
        try:
            jar.load("; ".join(cookies))
        except CookieError:
            return ""
        return jar[self._cookie].value if self._cookie in jar else ""

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode("utf-8", "surrogateescape"), self._token)

    async def _relay(self, browser: ServerConnection) -> None:
        """Pass on what viser sends, and what the browser may say."""
        chosen = [browser.subprotocol] if browser.subprotocol else None
        async with unix_connect(
            str(self._file), "ws://localhost/", subprotocols=chosen, compression=None, max_size=None
        ) as inside:

            async def inwards() -> None:
                async for message in browser:
                    if (said := harmless(message)) is not None:
                        await inside.send(said)

            async def outwards() -> None:
                async for message in inside:
                    await browser.send(message)

            tasks = [asyncio.create_task(inwards()), asyncio.create_task(outwards())]
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
                    with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                        await task


@contextlib.contextmanager
def _servers_listen_at(file: Path) -> Iterator[None]:
    """Have servers on event loops that are made meanwhile listen at a socket file, not at a port."""

    class Loop(asyncio.SelectorEventLoop):
        async def create_server(  # type: ignore[override]
            self, factory: Any, *place: Any, **options: Any
        ) -> Any:
            return await self.create_unix_server(factory, str(file), **options)

    class Policy(asyncio.DefaultEventLoopPolicy):
        def new_event_loop(self) -> asyncio.AbstractEventLoop:
            return Loop()

    before = asyncio.get_event_loop_policy()
    asyncio.set_event_loop_policy(Policy())
    try:
        yield
    finally:
        asyncio.set_event_loop_policy(before)


def _listener(port: int) -> socket.socket:
    """Return a socket at exactly this port: viser by itself would take the next one without a word."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise ViewError(f"port {port} cannot be used for the live view ({error}); try --port") from None
    return listener


def _fetch(file: Path, request: Request) -> Response:
    connection = http.client.HTTPConnection("localhost", timeout=_TIMEOUT_S)
    connection.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    with contextlib.closing(connection):
        connection.sock.settimeout(_TIMEOUT_S)
        connection.sock.connect(str(file))
        encoding = request.headers.get("Accept-Encoding", "identity")
        connection.request("GET", request.path, headers={"Accept-Encoding": encoding})
        answer = connection.getresponse()
        return Response(answer.status, answer.reason, Headers(answer.getheaders()), answer.read())
