"""`retrosync demo`: the whole way from a press to a height map, with a simulated handheld."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter

from device.command_line import Folder
from host_sync.cli.calibrate import calibrator_for
from host_sync.cli.console import DONE, print_line, status_spinner, tell_of_compiling
from host_sync.cli.view import view_command
from host_sync.errors import HostError
from host_sync.kernels.cache import holds_kernels
from host_sync.library.library import Library

if TYPE_CHECKING:
    from host_sync.render.picture_file import StoryRow

OBJECTS: Final = ("coin", "texture")
PICTURE_FILE: Final = "demo.png"


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
    tell_of_compiling()
    with _compiling_meanwhile():
        print_line("The handheld is calibrated with twelve presses of a ball (simulated).")
        _retroscan(*handheld, "calibrate")
        for name in OBJECTS:
            print_line(f"The {name} is pressed into the gel; a push of the button scans.")
            _retroscan(*handheld, "scan", "--object", name, "--part", name)
    report = pull(DirectorySource(card), library)
    if report.failed:
        raise HostError(f"not pulled: {report.failed}")
    print_line("The workstation has pulled the scans and verified every byte. It calibrates and reconstructs.")
    with status_spinner() as tell:
        rows = _reconstruct(library, tell)
        tell("drawing")
        from host_sync.render.picture_file import write_story

        picture = out / PICTURE_FILE
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


def _reconstruct(library: Library, tell: Callable[[str], None]) -> list[StoryRow]:
    """Reconstruct every scan of the library; one row of the picture for each."""
    import cv2
    import numpy as np

    from device.imaging.flat_field import demosaic
    from device.quick_look.solver import PICTURE_FILE as QUICK_LOOK
    from host_sync.reconstruction.from_library import LibraryReconstructor
    from host_sync.render.picture_file import StoryRow
    from host_sync.results.doubts import stated_doubts

    job = LibraryReconstructor(library, tell=tell, calibrator=calibrator_for(None, tell))
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
