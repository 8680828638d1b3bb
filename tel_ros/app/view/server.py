"""A viser server that only its owner can use.

viser by itself has no authentication, listens everywhere, and lets every client change the handlers of every
button or ask for a public tunnel. What is changed about that here touches names that viser does not promise
to keep. So it takes exactly the version for which this was written and attacked (``test/app/view``), looks
whether each name is there, and tries its own locks before anybody gets the link.
"""

from __future__ import annotations

import http.client
import inspect
import socket
from http import HTTPStatus
from typing import Any

import viser
import viser._messages
import viser.infra
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tel_ros.app.view.errors import ViewError
from tel_ros.app.view.gate import HOST, Gate, Verdict

VISER_VERSION = "1.1.1"
_FOREIGN_ORIGIN = "http://example.invalid"
_ANSWER_TIMEOUT_S = 5.0
_GUARDED = "_tel_view_guarded"


class OwnersServer(viser.ViserServer):  # type: ignore[misc]
    """Without the public tunnel that any client of viser can ask for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: this arm is nobody else's."""
        return None


def open_server(token: str, port: int, label: str) -> tuple[OwnersServer, str]:
    """Open a server at the loopback address, and return it with the link that lets in.

    Args:
        token: the secret in the link.
        port: 0: any that is free.
        label: title of the page.

    Raises:
        ViewError: the port is taken, this is not the version of viser that can be protected, or a lock does
            not hold. Nothing listens then.
    """
    _require_known_viser()
    _drop_all_messages_but_known_ones()
    listener = _listener(port)
    gate = Gate(token, listener.getsockname()[1])
    locks: list[bool] = []
    serve = websockets.asyncio.server.serve

    def serve_behind_gate(handler: Any, host: str, number: int, **options: Any) -> Any:
        inner = options.pop("process_request", None)
        locks.append(callable(inner))

        def process_request(connection: Any, request: Request) -> Response | None:
            verdict = gate.judge(
                request.path, request.headers.get_all("Host"), request.headers.get_all("Cookie")
            )
            if verdict.status != HTTPStatus.OK or not callable(inner):
                return _answer(verdict)
            response: Response | None = inner(connection, request)
            if response is not None:
                response.headers.update(verdict.headers)
            return response

        options["origins"] = list(gate.origins)
        return serve(handler, sock=listener, process_request=process_request, **options)

    websockets.asyncio.server.serve = serve_behind_gate  # type: ignore[assignment, misc]
    try:
        server = OwnersServer(host=HOST, port=listener.getsockname()[1], label=label, verbose=False)
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
    complaint = "" if locks == [True] else "viser did not open its socket as expected"
    complaint = complaint or _complaint(listener.getsockname(), gate.link)
    if complaint:
        server.stop()
        listener.close()
        raise ViewError(f"the live view is not safe to open and stays shut: {complaint}")
    return server, gate.link


def _require_known_viser() -> None:
    if viser.__version__ != VISER_VERSION:
        raise ViewError(
            f"the live view needs viser {VISER_VERSION}, for which its locks were made; "
            f"found {viser.__version__} (pip install 'tel_ros[view]')"
        )
    handle = getattr(viser.infra.WebsockMessageHandler, "_handle_incoming_message", None)
    found = {
        "WebsockMessageHandler._handle_incoming_message": inspect.iscoroutinefunction(handle)
        and list(inspect.signature(handle).parameters) == ["self", "client_id", "message"],
        "ViserServer.request_share_url": hasattr(viser.ViserServer, "request_share_url"),
        **{f"_messages.{name}": hasattr(viser._messages, name) for name in _KNOWN},
        "websockets.asyncio.server.serve": hasattr(websockets.asyncio.server, "serve"),
    }
    missing = [name for name, there in found.items() if not there]
    if missing:
        raise ViewError(f"the live view stays shut: viser has no {', '.join(missing)} as expected")


_KNOWN = ("ViewerCameraMessage", "GuiUpdateMessage")
"""All that a client has to say here: where it looks from, and what was pressed."""


def is_harmless(message: object) -> bool:
    """Return whether a client may say this: where its camera is, or the value of an input (a click is one).

    Everything else is dropped: new handlers for somebody's buttons, uploads, tunnels, dragged parts.
    """
    if type(message) is viser._messages.GuiUpdateMessage:
        return isinstance(message.updates, dict) and set(message.updates) == {"value"}
    return type(message) is viser._messages.ViewerCameraMessage


def _drop_all_messages_but_known_ones() -> None:
    """Put :func:`is_harmless` before the one place through which all messages of clients come, for good."""
    handler = viser.infra.WebsockMessageHandler
    handle = handler._handle_incoming_message
    if hasattr(handle, _GUARDED):
        return

    async def handle_if_harmless(self: Any, client_id: Any, message: Any) -> None:
        if is_harmless(message):
            await handle(self, client_id, message)

    setattr(handle_if_harmless, _GUARDED, True)
    handler._handle_incoming_message = handle_if_harmless


def _listener(port: int) -> socket.socket:
    """Return a socket of our own: viser would take the next port without a word."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except (OSError, OverflowError) as error:
        listener.close()
        raise ViewError(f"port {port} is not to be had for the live view ({error}); try --port") from None
    return listener


def _answer(verdict: Verdict) -> Response:
    body = verdict.text.encode()
    status = HTTPStatus.SERVICE_UNAVAILABLE if verdict.status == HTTPStatus.OK else verdict.status
    headers = Headers([*verdict.headers, ("Content-Type", "text/plain"), ("Content-Length", str(len(body)))])
    return Response(status.value, status.phrase, headers, body)


def _complaint(address: tuple[str, int], link: str) -> str:
    """Try the locks; return which one does not hold."""
    if address[0] != HOST:
        return f"it listens at {address[0]}"
    cookie = _get(address, link.partition("/?")[2], {}).getheader("Set-Cookie", "").partition(";")[0]
    attempts = {
        "a request without the token": ({}, HTTPStatus.UNAUTHORIZED),
        "a name that was made to point here": ({"Host": "example.invalid"}, HTTPStatus.FORBIDDEN),
        "a page of another origin": (
            {
                **{"Cookie": cookie, "Origin": _FOREIGN_ORIGIN, "Upgrade": "websocket"},
                **{"Connection": "Upgrade", "Sec-WebSocket-Version": "13"},
                "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            },
            HTTPStatus.FORBIDDEN,
        ),
    }
    for what, (headers, expected) in attempts.items():
        status = _get(address, "", headers).status
        if status != expected:
            return f"{what} was answered with {status}; expected {expected.value}"
    return ""


def _get(address: tuple[str, int], query: str, headers: dict[str, str]) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(*address, timeout=_ANSWER_TIMEOUT_S)
    try:
        connection.request("GET", f"/?{query}", headers={"Host": f"{address[0]}:{address[1]}", **headers})
        return connection.getresponse()
    except (OSError, http.client.HTTPException) as error:
        raise ViewError(f"the live view does not answer: {error}") from error
    finally:
        connection.close()
