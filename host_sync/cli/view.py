"""`retrosync view`."""

from __future__ import annotations

import os
import socket
import sys
import webbrowser
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from device.command_line import Folder
from host_sync.cli.console import DONE, print_error, print_line
from host_sync.library.library import default_library

if TYPE_CHECKING:
    from starlette.applications import Starlette

    from host_sync.viewer.access import Access


def view_command(
    what: Folder | None = None,
    /,
    *,
    frames: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    cache: Folder | None = None,
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
) -> int:
    """Show scans in a browser: relight, turn, profiles, comparison. Ctrl-C ends it.

    Parameters
    ----------
    what
        A library, a folder of results, or one result; ~/Retrograph by default.
    frames
        The FRAMESET.toml that the results were made from, to show their frames.
    host
        Address to listen on. Beyond this machine the connection is not encrypted.
    port
        Port to listen on; by default that of this folder's last view, at first a free one.
    cache
        Cache folder, which can be deleted at any time; in the user's cache by default.
    browser
        Open the page in the desktop's browser.
    """
    from host_sync.frames.frame_set import load_frame_set
    from host_sync.viewer.access import LOOPBACK, Access, answers, keep_access, kept_access
    from host_sync.viewer.app import make_app
    from host_sync.viewer.cache import default_cache
    from host_sync.viewer.catalogue import Catalogue
    from host_sync.viewer.service import ViewerService
    from host_sync.viewer.serving import is_free, listening

    catalogue = Catalogue(what or default_library())
    service = ViewerService(catalogue, cache or default_cache(), load_frame_set(frames) if frames else None)
    known = kept_access(catalogue.root, host) if host in LOOPBACK else None
    with ExitStack() as stack:
        if known and not port and not is_free(host, known.port):
            if answers(known):
                print_line(f"Open {known.link} (it is shown already)")
                return DONE
            known = None  # another program has the port
        listeners = stack.enter_context(listening(host, port or (known.port if known else 0)))
        taken = listeners[0].getsockname()[1]
        access = replace(known, port=taken) if known else Access(host, taken)
        kept = host in LOOPBACK and keep_access(catalogue.root, access)
        note = " (keep it: it opens whenever this folder is viewed)" if kept else ""
        serve_page(make_app(service, access), listeners, access, browser=browser, note=note)
    return DONE


def serve_page(
    app: Starlette, listeners: list[socket.socket], access: Access, *, browser: bool, note: str = ""
) -> None:
    """Serve an application until Ctrl-C, and open its page in the desktop's browser where `browser` is set.

    note : is printed after the link
    """
    from host_sync.viewer.access import LOOPBACK, redirect_file
    from host_sync.viewer.serving import make_server

    if access.host not in LOOPBACK:
        print_error(f"listening on {access.host}: anyone on that network can read the link and the scans", DONE)
    print_line(f"Open {access.link}{note}")
    with ExitStack() as stack:
        if browser and _has_desktop():
            webbrowser.open(stack.enter_context(redirect_file(access.link)).as_uri())
        with suppress(KeyboardInterrupt):  # the normal way to end it
            make_server(app).run(sockets=listeners)


def _has_desktop() -> bool:
    """Return whether a browser would open in a window and not in the terminal."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
