"""Access control of the viewer: link, session cookie, Host check and security headers.

A link carries a code that is exchanged for a session cookie, and leaves the address bar with the exchange. On loopback
the link of a folder stays the same from run to run (`kept_access`), and the page is served under a random host name
below `localhost`: browsers send a host's cookies to all of its ports, so a cookie of 127.0.0.1 would reach every other
server on this machine. A browser on the desktop is started with a file that only its user can read, because every user
can read the arguments of a program.
"""

from __future__ import annotations

import hashlib
import html
import http.client
import ipaddress
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs

import msgspec
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from device.io.atomic import replace_file
from host_sync.errors import LibraryError, ViewError
from host_sync.offload.paired_devices import default_devices_folder

LOOPBACK: Final = frozenset({"127.0.0.1", "localhost", "::1"})
COOKIE_S: Final = 400 * 86_400
"""Browsers keep no cookie longer."""

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
    """Credentials of the viewer.

    host : address that the server listens on
    port : its port
    code : secret in the link
    random_name : label of the host name below `localhost`
    """

    host: str
    port: int
    code: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    random_name: str = field(default_factory=lambda: secrets.token_hex(16))

    @property
    def token(self) -> str:
        """Value of the session cookie; it does not reveal the code."""
        return hashlib.sha256(f"session {self.code}".encode()).hexdigest()

    @property
    def cookie(self) -> str:
        """Name of the session cookie."""
        return f"retrograph-{self.port}"

    @property
    def origin(self) -> str:
        """Scheme, host and port of the page."""
        if self.host in LOOPBACK:
            return f"http://{self.random_name}.localhost:{self.port}"
        shown = "127.0.0.1" if self.host in ("0.0.0.0", "::") else self.host  # noqa: S104
        return f"http://[{shown}]:{self.port}" if ":" in shown else f"http://{shown}:{self.port}"

    @property
    def link(self) -> str:
        """The address that opens the page in any browser of this machine."""
        return f"{self.origin}/?code={self.code}"

    def knows_host(self, header: str) -> bool:
        """Return whether a Host header names this server: the random name on loopback, else host or IP address."""
        name, port = _split_host(header)
        if port != str(self.port) and not (port == "" and self.port == 80):
            return False
        if self.host in LOOPBACK:
            return secrets.compare_digest(name.encode(), f"{self.random_name}.localhost".encode())
        return name == self.host.lower() or _is_address(name)

    def holds_token(self, given: str | None) -> bool:
        """Return whether this is the session token."""
        return given is not None and secrets.compare_digest(given.encode(), self.token.encode())


class AccessCheck:
    """Middleware that refuses requests without access and adds the security headers to every answer."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] == "websocket":
            # Refused without a word: a page cannot read the reason.
            allowed = self._is_own_page(scope) and self._own_answer(scope) is None
            await (self._app if allowed else WebSocketClose(1008))(scope, receive, send)
            return

        own_socket = self._access.origin.replace("http", "ws", 1)
        policy = HEADERS["Content-Security-Policy"].replace("connect-src 'self'", f"connect-src 'self' {own_socket}")
        headers = HEADERS | {"Content-Security-Policy": policy}

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(headers)
            await send(message)

        answer = self._own_answer(scope)
        await (answer or self._app)(scope, receive, send_with_headers)

    def _is_own_page(self, scope: Scope) -> bool:
        """Return whether a web socket is asked for by a page of this server, as browsers say."""
        scheme, _, host = Headers(scope=scope).get("origin", "").partition("://")
        return scheme in ("http", "https") and self._access.knows_host(host)

    def _own_answer(self, scope: Scope) -> Response | None:
        """Return a refusal or the exchange of a link; None when the request may pass."""
        request = HTTPConnection(scope)
        headers = request.headers
        if not self._access.knows_host(headers.get("host", "")):
            return refused("The viewer does not answer at this address: use the link that it printed.", 421)
        opened = scope["path"] == "/" and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none") and not opened:
            return refused("Another page requested this: only the viewer's own page may.", 403)
        if scope["path"] == "/" and scope.get("method") == "GET" and "prefetch" not in headers.get("sec-purpose", ""):
            code = parse_qs(scope["query_string"].decode("latin-1")).get("code", [""])[0]
            if secrets.compare_digest(code.encode(), self._access.code.encode()):
                return self._session(headers)
        if not self._access.holds_token(request.cookies.get(self._access.cookie)):
            return refused("Open the link that retrosync view printed.", 403)
        return None

    def _session(self, headers: Headers) -> Response:
        """Set the cookie and load the page without the code."""
        if headers.get("sec-fetch-site") == "cross-site":
            # From the redirect file. A browser withholds a strict cookie after a redirect that began on another site.
            answer: Response = HTMLResponse(_moving_on("/"))
        else:
            answer = RedirectResponse("/", 303)
        answer.headers["Cache-Control"] = "no-store"
        answer.set_cookie(self._access.cookie, self._access.token, COOKIE_S, httponly=True, samesite="strict", path="/")
        return answer


@contextmanager
def redirect_file(link: str) -> Iterator[Path]:
    """A page that leads to a link, readable by its owner only; it is removed at the end.

    Raises
    ------
    ViewError
        No temporary file can be written.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix="retrograph-view-"))
    except OSError as error:
        raise ViewError(f"no temporary file can be written ({error.strerror}): start it with --no-browser") from error
    try:
        path = folder / "open.html"
        try:
            with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
                stream.write(_moving_on(link))
        except OSError as error:
            raise ViewError(f"{path} cannot be written ({error.strerror}): start it with --no-browser") from error
        yield path
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def refused(words: str, status: int) -> Response:
    """Return a page with one sentence."""
    said = html.escape(words)
    return HTMLResponse(
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>Retrograph: not opened</title>'
        f"<main><h1>Not opened</h1><p>{said}</p></main></html>",
        status,
    )


def _moving_on(link: str) -> str:
    """Return a page that loads another."""
    place = html.escape(link, quote=True)
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
        f'<meta http-equiv="refresh" content="0; url={place}"><title>Retrograph</title>'
        f'<p><a href="{place}">Open the viewer</a></p></html>'
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


FILE: Final = "viewer.json"
ANSWER_S: Final = 2.0


class _Address(msgspec.Struct, frozen=True):
    """Credentials of a folder's page."""

    port: int
    code: str
    random_name: str


def kept_access(folder: Path, host: str) -> Access | None:
    """Return the credentials with which a folder was viewed last; None where it was not, or they cannot be read."""
    kept = _read().get(str(folder.resolve()))
    return Access(host, kept.port, kept.code, kept.random_name) if kept else None


def keep_access(folder: Path, access: Access) -> bool:
    """Keep the credentials of a folder, readable by this user only; False where the settings cannot be written."""
    every = _read() | {str(folder.resolve()): _Address(access.port, access.code, access.random_name)}
    try:
        settings = default_devices_folder()
        settings.mkdir(parents=True, exist_ok=True, mode=0o700)
        replace_file(settings / FILE, msgspec.json.encode(every), 0o600)
    except (OSError, LibraryError):
        return False
    return True


def answers(access: Access) -> bool:
    """Return whether a viewer with these credentials runs already."""
    connection = http.client.HTTPConnection("127.0.0.1", access.port, timeout=ANSWER_S)
    try:
        headers = {"Host": access.origin.removeprefix("http://"), "Cookie": f"{access.cookie}={access.token}"}
        connection.request("GET", "/api/palettes", headers=headers)
        return connection.getresponse().status == 200
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def _read() -> dict[str, _Address]:
    try:
        return msgspec.json.decode((default_devices_folder() / FILE).read_bytes(), type=dict[str, _Address])
    except (OSError, LibraryError, msgspec.DecodeError, UnicodeDecodeError):
        return {}
