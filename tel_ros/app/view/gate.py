"""Who may come in: the host names, origins and the token that a request has to show."""

from __future__ import annotations

import hmac
from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from tel_ros.core.errors import TelError

HOST = "127.0.0.1"
"""The view listens here only: other machines cannot reach it."""


class ViewError(TelError):
    """The live view cannot be opened, or not safely."""


@dataclass(frozen=True)
class Verdict:
    """What to do with a request: ``status`` is OK if it may pass; ``headers`` belong to the answer."""

    status: HTTPStatus
    headers: tuple[tuple[str, str], ...] = ()
    text: str = ""


SHIELD = (
    ("Cache-Control", "no-store"),
    ("Content-Security-Policy", "frame-ancestors 'none'"),  # no other page may cover the buttons
    ("Referrer-Policy", "no-referrer"),
    ("X-Content-Type-Options", "nosniff"),
    ("X-Frame-Options", "DENY"),
)
"""Headers of every answer."""


class Gate:
    """Lets in whoever knows the token: from the link in the terminal at first, from a cookie after that.

    Pages of other origins can send requests to this machine, too, and the browser adds the cookie to them. So
    the origin of a socket is checked as well (:attr:`origins`), and the host name of the request, against
    foreign names that point here.

    Args:
        token: the secret; not empty.
        port: that the server listens at.
    """

    def __init__(self, token: str, port: int) -> None:
        if not token:
            raise ValueError("the token is empty: everybody would know it")
        self._token = token.encode()
        self._cookie = f"tel_view_{port}"  # cookies do not know ports: each view has its own
        self._hosts = (f"{HOST}:{port}", f"localhost:{port}")
        self.origins = tuple(f"http://{host}" for host in self._hosts)
        """Origins of pages that may open a socket."""
        # By number: localhost may have a second address, at which somebody else listens.
        self.link = f"http://{HOST}:{port}/?token={token}"
        """What to open in a browser of this machine."""

    def judge(self, path: str, hosts: Sequence[str], cookies: Sequence[str]) -> Verdict:
        """Judge a request, a page's as well as a socket's, by its path with query and two of its headers."""
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return Verdict(HTTPStatus.FORBIDDEN, SHIELD, "Not the name of this server.\n")
        asked = parse_qs(urlsplit(path).query).get("token", [])
        if len(asked) == 1 and self._is_token(asked[0]):
            cookie = f"{self._cookie}={asked[0]}; HttpOnly; SameSite=Strict; Path=/"
            # The token must not stay in the address bar, where others could read it.
            return Verdict(HTTPStatus.SEE_OTHER, (("Location", "/"), ("Set-Cookie", cookie), *SHIELD))
        if self._is_token(self._shown(cookies)):
            return Verdict(HTTPStatus.OK, SHIELD)
        text = "Open the link with the token that tel has printed in its terminal.\n"
        return Verdict(HTTPStatus.UNAUTHORIZED, SHIELD, text)

    def _shown(self, cookies: Sequence[str]) -> str:
        jar = SimpleCookie()
        try:
            jar.load("; ".join(cookies))
        except CookieError:
            return ""
        return jar[self._cookie].value if self._cookie in jar else ""

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode("utf-8", "surrogateescape"), self._token)
