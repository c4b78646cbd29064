"""What another user and another server on this machine can learn of the viewer's credentials."""

import http.server
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import uvicorn
from limits import join, running
from uvicorn.server import ServerState

from host_sync.cli.main import main
from host_sync.errors import ViewError
from host_sync.viewer.access import keep_access, redirect_file
from host_sync.viewer.serving import ConnectionLimits, LimitedConnection, listening

ANOTHER_USER = 65534


@pytest.fixture
def eavesdropper() -> Iterator[tuple[int, list[str]]]:
    """Another server on 127.0.0.1: its port, and the headers of every request that reached it."""
    heard: list[str] = []

    class Listener(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            heard.append(f"{self.path}\n{self.headers}")
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<p>theirs</p>")

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Listener)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server.server_address[1], heard
    server.shutdown()
    join(thread)
    server.server_close()


def test_a_browser_comes_through_the_redirect_file_and_its_cookie_stays(
    served: Any, visit: Callable[..., Any], eavesdropper: tuple[int, list[str]]
) -> None:
    """From a file, as the desktop's browser does; then the same browser visits other servers of this machine."""
    port, heard = eavesdropper
    link = served.access.link
    with redirect_file(link) as path:
        page = visit(served, begin=path.as_uri(), locale="en")
        page.wait_for_selector(".card")
    assert page.url == f"{served.origin}/"
    assert [cookie["domain"] for cookie in page.context.cookies()] == [served.origin.split("/")[2].split(":")[0]]
    assert page.evaluate("document.cookie") == ""
    other = page.context.new_page()
    for host in ("127.0.0.1", "localhost", "another.localhost"):
        other.goto(f"http://{host}:{port}/")
    assert len([one for one in heard if one.startswith("/\n")]) == 3
    assert not [one for one in heard if served.access.token in one or served.access.random_name in one]
    status = page.goto(link).status
    assert status == 200
    assert page.context.cookies()[0]["expires"] > 0  # it outlives the browser's window


def test_the_redirect_file_is_private_and_does_not_stay(tmp_path: Path) -> None:
    with redirect_file("http://a.localhost:1/?code=secret") as path:
        assert path.stat().st_mode & 0o777 == 0o600
        assert path.parent.stat().st_mode & 0o777 == 0o700
        assert "code=secret" in path.read_text()
        if os.geteuid() == 0:
            reading = subprocess.run(["cat", path], user=ANOTHER_USER, group=ANOTHER_USER, capture_output=True)
            assert reading.returncode != 0
            assert b"secret" not in reading.stdout
    assert not path.parent.exists()


def test_no_process_shows_a_link_to_other_users(results: Path, tmp_path: Path) -> None:
    """The arguments of viewer and browser, which `ps` shows to everyone, hold neither code nor token nor host name."""
    said, seen = tmp_path / "arguments", tmp_path / "page"
    browser = tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$@" > {said}.part\ncp "${{1#file://}}" {seen}\nmv {said}.part {said}\n')
    browser.chmod(0o755)
    environment = os.environ | {
        "BROWSER": str(browser),
        "DISPLAY": ":77",
        "XDG_CACHE_HOME": str(tmp_path),
        "XDG_CONFIG_HOME": str(tmp_path),
    }
    command = [sys.executable, "-m", "host_sync", "view", str(results)]
    with running(command, env=environment, stdout=subprocess.PIPE, text=True) as viewer:
        try:
            assert viewer.stdout is not None
            printed = viewer.stdout.readline()
            with socket.create_connection(("127.0.0.1", int(printed.split(":")[2].split("/")[0]))) as connection:
                connection.sendall(b"GET / HTTP/1.1\r\nHost: wait\r\n\r\n")
                assert connection.recv(64).startswith(b"HTTP/1.1 421")  # it serves, so the browser was started
            arguments = Path(f"/proc/{viewer.pid}/cmdline").read_text() + said.read_text()
        finally:
            viewer.send_signal(signal.SIGINT)
    name, code = printed.split("//")[1].split(".localhost")[0], printed.split("code=")[1].split()[0]
    assert "file://" in arguments
    assert "code" not in arguments
    assert name not in arguments
    assert name in seen.read_text()
    assert code in seen.read_text()
    assert (tmp_path / "retrograph" / "viewer.json").stat().st_mode & 0o777 == 0o600


def test_both_loopback_addresses_are_taken(tmp_path: Path) -> None:
    """Else another user could listen on the one that a browser tries first."""
    with listening("127.0.0.1", 0) as listeners:
        port = listeners[0].getsockname()[1]
        families = {one.family for one in listeners}
        assert {one.getsockname()[1] for one in listeners} == {port}
        assert socket.AF_INET in families
        for family, host in ((socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")):
            if family in families:
                with socket.socket(family) as theirs, pytest.raises(OSError, match="in use"):
                    theirs.bind((host, port))
        with pytest.raises(ViewError, match="choose another --port"), listening("127.0.0.1", port):
            pass


def test_a_prefetch_opens_nothing(served: Any) -> None:
    path = served.access.link.removeprefix(served.origin)
    assert served.ask(path, Sec_Purpose="prefetch")[0] == 403
    assert served.ask(path, "HEAD")[0] == 403
    assert served.ask(path)[0] == 303


def test_the_address_of_a_folder_stays(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def again(_server: uvicorn.Server, sockets: list[socket.socket]) -> None:
        """A second `view` finds the port taken, by what does not answer as a viewer."""
        monkeypatch.setattr(uvicorn.Server, "run", lambda *_, **__: None)
        assert main(["view", str(results), "--no-browser"]) == 0

    def view(folder: Path, *options: str) -> str:
        assert main(["view", str(folder), "--no-browser", *options]) == 0
        return capsys.readouterr().out.split()[1]

    monkeypatch.setattr(uvicorn.Server, "run", lambda *_, **__: None)
    link = view(results)
    assert view(results) == link
    assert view(results / "hill").partition("=")[2] != link.partition("=")[2]
    monkeypatch.setattr(uvicorn.Server, "run", again)
    assert view(results) == link
    moved = view(results)
    assert moved != link
    assert view(results) == moved


def test_a_folder_that_is_shown_already_is_named_and_not_served_twice(
    serve: Callable[..., Any], results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    access = serve(results).access
    keep_access(results, access)
    assert main(["view", str(results), "--no-browser"]) == 0
    assert capsys.readouterr().out == f"Open {access.link} (it is shown already)\n"


@pytest.mark.parametrize(
    "begun", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: x\r\n", b"POST / HTTP/1.1\r\nContent-Length: 9\r\n"]
)
def test_a_connection_without_a_request_is_closed(serve: Callable[..., Any], results: Path, begun: bytes) -> None:
    short = serve(results, ConnectionLimits(request_s=0.05))
    with socket.create_connection(("127.0.0.1", short.access.port), timeout=60) as connection:
        connection.sendall(begun)
        assert ended(connection)


def test_a_connection_that_drips_after_an_answer_is_closed(serve: Callable[..., Any], results: Path) -> None:
    short = serve(results, ConnectionLimits(request_s=0.2))
    with socket.create_connection(("127.0.0.1", short.access.port), timeout=60) as connection:
        connection.sendall(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\n")
        assert connection.recv(64).startswith(b"HTTP/1.1 421")
        connection.sendall(b"x")
        assert ended(connection)


class VirtualLoop:
    """Timers of an event loop that fire when they are told to."""

    def __init__(self) -> None:
        self.timers: list[tuple[float, Callable[[], None], threading.Event]] = []

    def call_later(self, delay_s: float, call: Callable[[], None]) -> SimpleNamespace:
        cancelled = threading.Event()
        self.timers.append((delay_s, call, cancelled))
        return SimpleNamespace(cancel=cancelled.set)

    def pass_time(self, seconds: float) -> None:
        for delay_s, call, cancelled in tuple(self.timers):
            if delay_s <= seconds and not cancelled.is_set():
                call()


def test_a_client_that_does_not_read_its_answer_is_dropped() -> None:
    aborted: list[bool] = []
    transport = SimpleNamespace(get_extra_info=lambda _name: None, abort=lambda: aborted.append(True))
    loop = VirtualLoop()
    config = uvicorn.Config("none", lifespan="off")
    config.load_app = lambda: None  # type: ignore[method-assign]
    config.load()
    limits = ConnectionLimits(request_s=1000.0, stalled_s=30.0)
    connection = LimitedConnection(config, ServerState(), {}, loop, limits=limits)
    connection.connection_made(transport)  # type: ignore[arg-type]
    connection.pause_writing()
    connection.resume_writing()
    loop.pass_time(100.0)
    assert not aborted
    connection.pause_writing()
    loop.pass_time(100.0)
    assert aborted == [True]


def test_half_open_connections_do_not_keep_others_out(serve: Callable[..., Any], results: Path) -> None:
    few = serve(results, ConnectionLimits(connections=8))
    half_open = [socket.create_connection(("127.0.0.1", few.access.port), timeout=60) for _ in range(40)]
    try:
        for connection in half_open:
            connection.sendall(b"GET / HT")
        assert few.json("/api/list")["entries"]
        assert ended(half_open[0])
    finally:
        for connection in half_open:
            connection.close()


def ended(connection: socket.socket) -> bool:
    """Whether the other side closes the connection within its time-out, whatever it sends before."""
    try:
        while connection.recv(4096):
            pass
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False
    return True
