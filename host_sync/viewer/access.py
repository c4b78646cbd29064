"""Who may ask, and what the page may do: token, Host, and the headers that keep a page to itself.

The address that the command prints carries a token; the first visit turns it into a cookie and takes it out of the
address. Without it nothing is answered, so that no other user of the machine and no page from elsewhere sees a scan.
The Host is compared, so that a name somebody points at this machine (DNS rebinding) reaches nothing.
"""

from __future__ import annotations

import html
import ipaddress
import secrets
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK: Final = frozenset({"127.0.0.1", "localhost", "::1"})

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}


@dataclass(frozen=True, slots=True)
class Access:
    """What a visitor must bring.

    host : the address that the server listens at
    port : its port
    """

    host: str
    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))

    @property
    def cookie(self) -> str:
        """Name of the cookie; browsers tell hosts apart but not ports."""
        return f"retrograph-{self.port}"

    @property
    def address(self) -> str:
        """The page's address, token included."""
        shown = "127.0.0.1" if self.host in ("0.0.0.0", "::") else self.host  # noqa: S104
        shown = f"[{shown}]" if ":" in shown else shown
        return f"http://{shown}:{self.port}/?token={self.token}"

    def knows_host(self, header: str) -> bool:
        """Whether a Host header names this server; beyond loopback a plain address will do, a stranger's name not."""
        name, port = _split_host(header)
        if port != str(self.port) and not (port == "" and self.port == 80):
            return False
        if name in LOOPBACK or name == self.host.lower():
            return True
        return self.host not in LOOPBACK and _is_address(name)

    def holds_token(self, given: str | None) -> bool:
        """Whether this is the token."""
        return given is not None and secrets.compare_digest(given.encode(), self.token.encode())


class AccessCheck:
    """Lets requests through that may pass, and puts the headers on every answer."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return  # no web sockets are spoken here

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        refusal = self._refusal(scope)
        await (refusal or self._app)(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> Response | None:
        """What to answer instead, or None when the request may pass."""
        headers = Headers(scope=scope)
        if not self._access.knows_host(headers.get("host", "")):
            return refused("This is not the address that the viewer was opened at: use the one that it printed.", 421)
        opened = scope["path"] == "/" and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") and not opened:
            return refused("Another page asked for this: only the viewer's own page may.", 403)
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [None])[0]
        if scope["path"] == "/" and self._access.holds_token(given):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self._access.cookie, self._access.token, httponly=True, samesite="strict", path="/")
            return answer
        if not self._access.holds_token(_cookie(headers.get("cookie", ""), self._access.cookie)):
            return refused("Open the address that `retrosync view` printed: it carries the key to this page.", 403)
        return None


def refused(words: str, status: int) -> Response:
    """A page with one sentence."""
    said = html.escape(words)
    return HTMLResponse(
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Retrograph: not opened</title>'
        f"<main><h1>Not opened</h1><p>{said}</p></main></html>",
        status,
    )


def _split_host(header: str) -> tuple[str, str]:
    name, port = header.strip().lower(), ""
    if name.startswith("["):
        name, _, port = name[1:].partition("]")
        port = port.removeprefix(":")
    elif ":" in name:
        name, _, port = name.rpartition(":")
    return name, port


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _cookie(header: str, name: str) -> str | None:
    try:
        jar = SimpleCookie(header)
    except CookieError:
        return None
    return jar[name].value if name in jar else None
