"""Attacks that succeed against viser as it comes, each tried here against the live view's server."""

from __future__ import annotations

import asyncio
import http.client
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

viser = pytest.importorskip("viser", reason="needs the extra view")

import msgspec  # noqa: E402
import websockets.asyncio.client  # noqa: E402
import websockets.asyncio.server  # noqa: E402
from viser import _messages as messages  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402

from tel_ros.app.view import server as view_server  # noqa: E402
from tel_ros.app.view.errors import ViewError  # noqa: E402
from tel_ros.app.view.server import OwnersServer, open_server  # noqa: E402

TOKEN = "a-secret-for-tests"


@dataclass
class Opened:
    """A server, the number of clicks on its one button, and how to reach it."""

    server: OwnersServer
    port: int
    button: object
    clicks: list[str]

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def cookie(self) -> str:
        return f"tel_view_{self.port}={TOKEN}"

    def get(self, path: str, **headers: str) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30.0)
        connection.request("GET", path, headers={name.replace("_", "-"): v for name, v in headers.items()})
        answer = connection.getresponse()
        answer.read()
        connection.close()
        return answer

    def say(self, *said: object, cookie: str | None = None, origin: str | None = None) -> None:
        """Open a socket as a browser would, and say something; returns when the server has read all of it."""

        async def talk() -> None:
            async with websockets.asyncio.client.connect(
                f"ws://127.0.0.1:{self.port}",
                origin=self.origin if origin is None else origin or None,
                additional_headers={"Cookie": self.cookie if cookie is None else cookie},
                subprotocols=[f"viser-v{viser.__version__}"],
                max_size=None,
            ) as socket:
                for message in said:
                    await socket.send(wire(message))
                await (await socket.ping())  # the server has read what came before

        asyncio.run(talk())

    def settle(self) -> None:
        """Wait until the server has worked off what it has read."""
        for _ in range(3):
            asyncio.run_coroutine_threadsafe(asyncio.sleep(0), self.server._event_loop).result(30.0)
        self.server._thread_executor.submit(lambda: None).result(30.0)


def wire(message: object) -> bytes:
    return msgspec.msgpack.encode(message.as_serializable_dict())


def press(opened: Opened) -> object:
    return messages.GuiUpdateMessage(opened.button._impl.uuid, {"value": True})


@pytest.fixture
def opened() -> Iterator[Opened]:
    server, link = open_server(TOKEN, 0, "test")
    clicks: list[str] = []
    button = server.gui.add_button("stop")

    @button.on_click
    async def _(event: object) -> None:  # on the event loop: done when the loop has had its turn
        clicks.append("stop")

    assert link == f"http://127.0.0.1:{server.get_port()}/?token={TOKEN}"
    yield Opened(server, server.get_port(), button, clicks)
    server.stop()


def test_the_owner_gets_in_by_the_link_and_presses_a_button(opened: Opened) -> None:
    answer = opened.get(f"/?token={TOKEN}")
    assert answer.status == 303
    assert answer.getheader("Location") == "/"
    cookie = answer.getheader("Set-Cookie")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    page = opened.get("/", Cookie=cookie.partition(";")[0])
    assert page.status == 200
    assert page.getheader("Content-Security-Policy") == "frame-ancestors 'none'"
    connect_as_viewer(opened)
    assert opened.clicks == ["stop"]


def connect_as_viewer(opened: Opened, *said: object) -> None:
    camera = messages.ViewerCameraMessage(
        wxyz=(1.0, 0.0, 0.0, 0.0), position=(1.0, 1.0, 1.0), fov=1.0, near=0.1, far=10.0,
        image_height=100, image_width=100, look_at=(0.0, 0.0, 0.0), up_direction=(0.0, 0.0, 1.0),
    )  # fmt: skip
    opened.say(camera, *said, press(opened))
    end = time.monotonic() + 30.0
    while not opened.clicks and time.monotonic() < end:
        time.sleep(0.01)
    opened.settle()


@pytest.mark.parametrize("path", ["/", "/index.html", "/?token=", "/?token=wrong", "/?token=a&token=b"])
def test_nobody_gets_a_page_without_the_token(opened: Opened, path: str) -> None:
    assert opened.get(path).status == 401
    assert opened.get(path, Cookie=f"tel_view_{opened.port}=wrong").status == 401
    assert opened.get(path, Cookie=f"tel_view_1={TOKEN}").status == 401


@pytest.mark.parametrize("cookie", ["", "tel_view_0=x", "=;=;["])
def test_nobody_opens_a_socket_without_the_token(opened: Opened, cookie: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        opened.say(press(opened), cookie=cookie)
    assert refused.value.response.status_code == 401
    assert opened.clicks == []


@pytest.mark.parametrize("origin", ["http://example.invalid", "http://127.0.0.1:1", "null", ""])
def test_no_page_of_another_origin_presses_a_button_with_the_owners_cookie(
    opened: Opened, origin: str
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        opened.say(press(opened), origin=origin)
    assert refused.value.response.status_code == 403
    assert opened.clicks == []


def test_a_name_of_somebody_elses_that_points_here_is_refused(opened: Opened) -> None:
    assert opened.get("/", Host="example.invalid", Cookie=opened.cookie).status == 403


def test_it_listens_on_this_machine_alone(opened: Opened) -> None:
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    others = {address for address in others if not address.startswith("127.")} or {"127.0.0.2"}
    for address in others:
        with pytest.raises(OSError):
            socket.create_connection((address, opened.port), timeout=5.0).close()


def test_no_client_takes_the_handlers_off_a_button(opened: Opened) -> None:
    attack = messages.GuiUpdateMessage(opened.button._impl.uuid, {"update_cb": []})
    both = messages.GuiUpdateMessage(opened.button._impl.uuid, {"value": False, "update_cb": []})
    connect_as_viewer(opened, attack, both)
    assert opened.clicks == ["stop"]  # the press that followed


def test_no_client_gets_a_public_tunnel(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *a, **k: asked.append(a))
    opened.say(messages.ShareUrlRequest())
    opened.settle()
    assert asked == []
    assert opened.server.request_share_url() is None
    assert asked == []


def test_clients_may_say_nothing_but_where_they_look_and_what_they_pressed() -> None:
    uploads = [m for m in vars(messages).values() if isinstance(m, type) and issubclass(m, messages.Message)]
    assert len(uploads) > 50
    allowed = {m.__name__ for m in uploads if view_server.is_harmless(_blank(m))}
    assert allowed == {"ViewerCameraMessage"}
    assert view_server.is_harmless(messages.GuiUpdateMessage("id", {"value": 1}))
    assert not view_server.is_harmless(messages.GuiUpdateMessage("id", {}))


def _blank(kind: type) -> object:
    blank = object.__new__(kind)
    if kind is messages.GuiUpdateMessage:
        blank.updates = {"label": "fine"}
    return blank


def test_a_port_that_is_taken_is_said_and_not_replaced_by_another(opened: Opened) -> None:
    with pytest.raises(ViewError, match=f"port {opened.port}"):
        open_server(TOKEN, opened.port, "test")


@pytest.mark.parametrize(
    ("gone", "why"),
    [
        ("viser.infra.WebsockMessageHandler._handle_incoming_message", "_handle_incoming_message"),
        ("viser._messages.GuiUpdateMessage", "GuiUpdateMessage"),
        ("viser.ViserServer.request_share_url", "request_share_url"),
        ("websockets.asyncio.server.serve", "serve"),
    ],
)
def test_without_a_name_that_a_lock_needs_nothing_is_opened(
    monkeypatch: pytest.MonkeyPatch, gone: str, why: str
) -> None:
    monkeypatch.delattr(gone)
    with pytest.raises(ViewError, match=why):
        open_server(TOKEN, 0, "test")


def test_another_version_of_viser_is_not_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viser, "__version__", "1.1.2")
    with pytest.raises(ViewError, match=r"needs viser 1\.1\.1.*found 1\.1\.2"):
        open_server(TOKEN, 0, "test")


def test_a_lock_that_does_not_hold_shuts_the_server_again(monkeypatch: pytest.MonkeyPatch) -> None:
    serve = websockets.asyncio.server.serve

    def without_origins(*args: object, origins: object = None, **options: object) -> object:
        return serve(*args, **options)

    monkeypatch.setattr(websockets.asyncio.server, "serve", without_origins)
    with pytest.raises(ViewError, match=r"stays shut: a page of another origin was answered with 101"):
        open_server(TOKEN, 0, "test")
    assert websockets.asyncio.server.serve is without_origins
