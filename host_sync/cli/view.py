"""`retrosync view`: results as a page; `retrosync demo`: from a press to a height map with a simulated handheld."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

from device.command_line import Folder
from host_sync.cli.calibrate import calibrator_for
from host_sync.cli.console import DONE, announce_compiling, print_error, print_line, status_spinner
from host_sync.errors import HostError
from host_sync.kernels.cache import holds_kernels
from host_sync.library.library import Library, default_library

if TYPE_CHECKING:
    from starlette.applications import Starlette

    from host_sync.render.picture_file import StoryRow
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


DEMO_OBJECTS: Final = ("coin", "texture")
DEMO_PICTURE: Final = "demo.png"


def demo_command(
    *,
    out: Folder = Path("retrograph-demo"),
    board: str = "twin",
    open_page: Annotated[bool, Parameter(name="--browser", negative="--no-browser")] = True,
) -> int:
    """Run the whole workflow with a simulated handheld: calibrate, scan, pull, reconstruct, view.

    Parameters
    ----------
    out
        Folder for scans, results and demo.png; it must not exist yet.
    board
        Board profile of a simulated handheld: twin, twin-distant, or a .toml file.
    open_page
        Show the results in the browser at the end, until Ctrl-C.
    """
    from host_sync.offload.pull import pull
    from host_sync.offload.source import DirectorySource

    if out.exists():
        raise HostError(f"{out} exists already: show it with `retrosync view {out}`, or name another folder with --out")
    began_s = time.monotonic()
    card, library = out / "card", Library(out / "library")
    handheld = ("--board", board, "--store", str(card))
    announce_compiling()
    with _compiling_meanwhile():
        print_line("The handheld is calibrated with twelve presses of a ball (simulated).")
        _retroscan(*handheld, "calibrate")
        for name in DEMO_OBJECTS:
            print_line(f"The {name} is pressed into the gel; a push of the button scans.")
            _retroscan(*handheld, "scan", "--object", name, "--part", name)
    report = pull(DirectorySource(card), library)
    if report.failed:
        raise HostError(f"not pulled: {report.failed}")
    print_line("The workstation has pulled the scans and verified every byte. It calibrates and reconstructs.")
    with status_spinner() as report_progress:
        rows = _reconstruct_all(library, report_progress)
        report_progress("drawing")
        from host_sync.render.picture_file import write_story

        picture = out / DEMO_PICTURE
        write_story(rows, picture)
    print_line(f"{time.monotonic() - began_s:.0f} s in all. Scans and height maps: {library.root}")
    print_line(f"Picture: {picture}")
    print_line(f"To see them again: retrosync view {out}")
    return view_command(out) if open_page else DONE


@contextmanager
def _compiling_meanwhile() -> Iterator[None]:
    """On the first run, compile on a thread while the handheld's program works."""
    if holds_kernels():
        yield
        return
    from host_sync.integration.integrate import compile_integration

    with ThreadPoolExecutor(1) as pool:
        compiled = pool.submit(compile_integration)
        yield
        compiled.result()


def _retroscan(*arguments: str) -> None:
    """Run the handheld's program and show its lines, indented; its failure ends the demo."""
    command = [sys.executable, "-m", "device", *arguments]
    with (
        TemporaryFile("w+") as said,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, text=True) as running,  # noqa: S603 - our own
    ):
        for line in running.stdout or ():
            print_line(f"    {line.rstrip()}")
            sys.stdout.flush()
        if running.wait():
            said.seek(0)
            lines = said.read().splitlines() or [f"retroscan ended with {running.returncode}"]
            raise HostError(lines[-1].removeprefix("retroscan: "))


def _reconstruct_all(library: Library, report_progress: Callable[[str], None]) -> list[StoryRow]:
    """Reconstruct every scan of the library; one row of the picture for each."""
    import cv2
    import numpy as np

    from device.imaging.flat_field import demosaic
    from device.quick_look.solver import PICTURE_FILE as QUICK_LOOK
    from host_sync.reconstruction.scans import LibraryReconstructor
    from host_sync.render.picture_file import StoryRow
    from host_sync.results.doubts import stated_doubts

    job = LibraryReconstructor(
        library, report_progress=report_progress, calibrator=calibrator_for(None, report_progress)
    )
    rows = []
    for scan in sorted(library.scans().bundles, key=lambda one: one.scan_id):
        found, folder = job.run(scan)
        highest_um = float(np.nanmax(found.height.z_um))
        at = np.unravel_index(int(np.nanargmax(found.height.z_um)), found.height.z_um.shape)
        part = scan.record.annotations.part or scan.scan_id
        print_line(f"{part}: highest point {highest_um:.0f} ± {float(found.sigma_um[at]):.0f} µm (k = 1), in {folder}")
        for words in stated_doubts(folder):
            print_line(f"  doubt: {words}")
        rows.append(
            StoryRow(
                title=part,
                frame_rgb=demosaic(scan.raw_frame()).rgb,
                quick_look=np.asarray(cv2.imread(str(scan.path(QUICK_LOOK)), cv2.IMREAD_GRAYSCALE), np.uint8),
                height=found.height,
                sigma_um=found.sigma_um,
            )
        )
    return rows
