"""`retrosync view`."""

from __future__ import annotations

import os
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path

from cyclopts import App

from host_sync.commands.console import DONE, Folder, complain, say
from host_sync.library import default_library


def register(app: App) -> None:
    """Add the command."""
    app.command(view_command, name="view")


def view_command(
    what: Folder | None = None,
    *,
    frames: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    cache: Folder | None = None,
    browser: bool = True,
) -> int:
    """Look at scans in a browser: relight, turn, measure along lines, compare. Ctrl-C ends it.

    Parameters
    ----------
    what
        A library, a folder with results in it, or one result; ~/Retrograph when not given.
    frames
        The FRAMESET.toml that results were made from, to show their frames.
    host
        Address to listen at. Beyond this machine whoever has the printed address sees everything, unencrypted.
    port
        To listen at; a free one when not given.
    cache
        Folder that may be deleted at any time; in the user's cache when not given.
    browser
        Open the page in the desktop's browser.
    """
    from host_sync.frame_set import load_frame_set
    from host_sync.viewer.access import LOOPBACK, Access
    from host_sync.viewer.app import make_app
    from host_sync.viewer.cache import default_cache
    from host_sync.viewer.catalogue import Catalogue
    from host_sync.viewer.desk import Desk
    from host_sync.viewer.serving import listening, make_server

    catalogue = Catalogue(what or default_library())
    desk = Desk(catalogue, cache or default_cache(), load_frame_set(frames) if frames else None)
    with listening(host, port) as listener:
        access = Access(host, listener.getsockname()[1])
        server = make_server(make_app(desk, access))
        if host not in LOOPBACK:
            complain(f"listening at {host}: whoever learns the address below sees these scans, unencrypted", DONE)
        say(f"Open {access.address}")
        sys.stdout.flush()
        if browser and _has_desktop():
            webbrowser.open(access.address)
        with suppress(KeyboardInterrupt):  # that is how it is ended
            server.run(sockets=[listener])
    return DONE


def _has_desktop() -> bool:
    """Whether a browser would open beside the terminal and not in it."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
