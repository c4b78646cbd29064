"""`retrosync live`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from device.command_line import Folder
from host_sync.cli.calibrator import obtain_calibration
from host_sync.cli.console import DONE, status_spinner, tell_of_compiling
from host_sync.cli.reconstruct import MethodName
from host_sync.cli.view import serve_page
from host_sync.frames.frame_set_file import Encoding
from host_sync.text import printable


def live_command(
    source: str,
    /,
    *,
    calibration: str,
    library: Path | None = None,
    record: Folder = Path("recordings"),
    sigma: bool = False,
    encoding: Encoding | None = None,
    method: MethodName | None = None,
    force: bool = False,
    host: str = "127.0.0.1",
    port: int = 0,
    browser: Annotated[bool, Parameter(negative="--no-browser")] = True,
) -> int:
    """Show heights of a sensor in a browser while they come: relight, turn, contact, record. Ctrl-C ends it.

    The newest frame is shown; those that come while it is solved are dropped and counted. A sensor that is unplugged is
    looked for again.

    Parameters
    ----------
    source
        A board profile by name or file (digit, gelsight-mini, twin); a camera by its number or /dev/video file; or a
        recording, which is played in real time.
    calibration
        A file of `retrosync calibrate`, a FRAMESET.toml or a calibration's folder; with --library, a calibration's id
        or its beginning or end.
    library
        Folder of pulled calibrations.
    record
        Folder for recordings, which the key R begins and ends; `retrosync video` reconstructs their frames.
    sigma
        Also find the uncertainty of heights, for the ± of depth and area; about half as many pictures a second.
    encoding
        Encoding of light in the frames' values; that of the calibration by default.
    method
        Method of reconstruction; the one with the smaller held-out error by default.
    force
        Also show frames that do not fit the calibration.
    host
        Address to listen on. Beyond this machine the connection is not encrypted.
    port
        Port to listen on; a free one by default.
    browser
        Open the page in the desktop's browser.
    """
    with status_spinner() as tell:
        tell_of_compiling()
        tell("loading compiled code")
        from host_sync.video.frame_solver import FrameSolver
        from host_sync.video.live import open_live
        from host_sync.video.reconstruct import sequence_doubts
        from host_sync.video.recorder import Recorder
        from host_sync.viewer.access import Access
        from host_sync.viewer.app import make_live_app
        from host_sync.viewer.live import LiveView
        from host_sync.viewer.serving import listening

        kept = obtain_calibration(calibration, library, tell, paper=method == "paper")
        solver = FrameSolver.of(kept, method, encoding, force=force)
        recorder = Recorder(record, printable(calibration))
        live = open_live(source, solver, newest=True, sigma=sigma, tap=recorder.take, tell=tell)
        doubts = tuple(doubt.sentence for doubt in sequence_doubts(kept.calibration, solver))
        view = LiveView(printable(source), live, recorder, solver, doubts)
    try:
        view.start()
        with listening(host, port) as listeners:
            access = Access(host, listeners[0].getsockname()[1])
            serve_page(make_live_app(view, access), listeners, access, browser=browser)
    finally:
        view.close()
    return DONE
