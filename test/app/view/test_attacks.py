"""Attacks that succeed against viser as it comes, each tried here against the live view's server."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import socket
import stat
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

viser = pytest.importorskip("viser", reason="needs the extra view")

import msgspec  # noqa: E402
import psutil  # noqa: E402
import websockets.asyncio.client  # noqa: E402
from viser import _messages as messages  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402

from tel_ros.app.view import ViewError  # noqa: E402
from tel_ros.app.view import server as view_server  # noqa: E402
from tel_ros.app.view.server import OwnersServer  # noqa: E402

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


def wire(message: object) -> bytes:
    return msgspec.msgpack.encode(message.as_serializable_dict())


def press(opened: Opened) -> object:
    return messages.GuiUpdateMessage(opened.button._impl.uuid, {"value": True})


@pytest.fixture
def opened() -> Iterator[Opened]:
    server = OwnersServer(TOKEN, 0, "test")
    clicks: list[str] = []
    button = server.viser.gui.add_button("stop")

    @button.on_click
    async def _(event: object) -> None:  # on the event loop: done when the loop has had its turn
        clicks.append("stop")

    assert server.link == f"http://127.0.0.1:{server.port}/?token={TOKEN}"
    yield Opened(server, server.port, button, clicks)
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
    wait_until(lambda: bool(opened.clicks))


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 30.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)


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
    connect_as_viewer(opened, messages.ShareUrlRequest())
    assert opened.clicks == ["stop"]  # the press that followed
    assert asked == []


def test_clients_may_say_nothing_but_where_they_look_and_what_they_pressed() -> None:
    names = {message.__name__ for message in viser.infra.Message.get_subclasses()}
    assert len(names) > 50
    said = {name: {"type": name, "uuid": "id", "updates": {"label": "fine"}} for name in names}
    allowed = {name for name, message in said.items() if passes(message)}
    assert allowed == {"ViewerCameraMessage"}
    assert passes({"type": "GuiUpdateMessage", "uuid": "id", "updates": {"value": 1}})
    assert not passes({"type": "GuiUpdateMessage", "uuid": "id", "updates": {}})
    assert not passes({"type": "GuiUpdateMessage", "uuid": "id"})


def passes(message: object) -> bool:
    return view_server.harmless(msgspec.msgpack.encode(message)) is not None


@pytest.mark.parametrize("noise", [b"", b"\xc1", b"\x01", "text", msgspec.msgpack.encode(["type"])])
def test_what_is_no_message_at_all_is_dropped(noise: str | bytes) -> None:
    assert view_server.harmless(noise) is None


def test_a_key_that_comes_twice_hides_nothing() -> None:
    """What is passed on is what was looked at, whichever of the two another reader would take."""
    twice = b"\x83" + b"".join(
        msgspec.msgpack.encode(part)
        for part in ("type", "GuiUpdateMessage", "updates", {"update_cb": []}, "updates", {"value": True})
    )
    passed = view_server.harmless(twice)
    assert msgspec.msgpack.decode(passed) == {"type": "GuiUpdateMessage", "updates": {"value": True}}


def test_viser_itself_can_be_reached_by_its_owners_processes_alone(opened: Opened) -> None:
    folder = opened.server._file.parent
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_ISSOCK(opened.server._file.stat().st_mode)
    listening = [c for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert [c.laddr for c in listening if c.laddr.port == opened.port] == [("127.0.0.1", opened.port)]


def test_nothing_is_left_when_it_has_stopped() -> None:
    server = OwnersServer(TOKEN, 0, "test")
    server.stop()
    assert not server._file.parent.exists()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", server.port), timeout=5.0)


def test_a_port_that_is_taken_is_said_and_not_replaced_by_another(opened: Opened) -> None:
    with pytest.raises(ViewError, match=f"port {opened.port}"):
        OwnersServer(TOKEN, opened.port, "test")


def test_a_viser_that_lacks_a_message_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_server, "MAY_SAY", ("ViewerCameraMessage", "PressMessage"))
    with pytest.raises(ViewError, match=r"stays shut: viser .* has no PressMessage"):
        OwnersServer(TOKEN, 0, "test")


def test_a_viser_that_listens_elsewhere_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view_server, "_servers_listen_at", lambda file: contextlib.nullcontext())
    with pytest.raises(ViewError, match="stays shut: viser did not open its socket as expected"):
        OwnersServer(TOKEN, 0, "test")
