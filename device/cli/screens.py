"""`retroscan` and `retroscan tui`: the screens on this terminal. Only this command needs textual."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from threading import Event as Flag
from typing import TYPE_CHECKING, Self, TextIO

from device.acquisition.instrument_lock import SERVICE_FOLDER, exclusive_instrument
from device.cli.console import Given, open_store, store_folder
from device.cli.service import POWER_OFF_FILE, SdNotify, ServiceReport
from device.errors import StoreError, TerminalMissing
from device.instrument.instrument import Instrument
from device.tui.drawing.cells import colour_depth
from device.tui.screens.panels import ProgramInfo
from hal.board_profile import load_board_profile
from hal.clock import SystemClock
from hal.errors import DriverMissing
from hal.factory import open_hardware
from hal.hardware import Hardware

if TYPE_CHECKING:
    from device.instrument.demo_faults import DemoFaults
    from device.tui.screens.app import RetroscanApp


class InstrumentThread:
    """Steps an instrument on its own thread, beside the screens. Leaving waits for the turn in progress.

    Parameters
    ----------
    instrument : not entered; the thread enters and leaves it
    report : receives the state after every turn
    """

    def __init__(self, instrument: Instrument, report: ServiceReport) -> None:
        self._instrument = instrument
        self._report = report
        self._stop = Flag()
        self._executor = ThreadPoolExecutor(1, "instrument")
        self._running: Future[None] | None = None

    @property
    def has_ended(self) -> bool:
        """True if the loop ended without being stopped; leaving the context then raises its error."""
        return self._running is not None and self._running.done()

    def __enter__(self) -> Self:
        self._running = self._executor.submit(self._run)
        return self

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        self._executor.shutdown(wait=True)
        if self._running and exc[0] is None:
            self._running.result()

    def _run(self) -> None:
        with self._instrument as instrument:
            while not self._stop.is_set():
                instrument.step()
                self._report.turn(instrument.state)
            self._report.ended()


def run_screens(*, options: Given) -> int:
    """Show the screens on this terminal (the default command).

    Returns the exit code when the operator quits.

    Raises
    ------
    TerminalMissing
        Standard input or error is not a terminal.
    DriverMissing
        textual is not installed.
    DeviceError, HalError
        The store or the board profile cannot be used; later failures appear on the screens.
    """
    profile = load_board_profile(options.board)
    require_terminal()
    with exclusive_instrument(profile):
        hardware = open_hardware(profile, SystemClock())
        instrument = Instrument(hardware, open_store(options, hardware.clock))
        return show_screens(instrument, hardware, store_folder(options))


def require_terminal() -> None:
    """Check that the screens can be shown. Errors as for `run_screens`."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise TerminalMissing("the screens need a terminal for input and error output: use `retroscan run` instead")
    if find_spec("textual") is None:
        raise DriverMissing("textual is not installed: install retrograph[device], or use `retroscan run`")


def show_screens(instrument: Instrument, hardware: Hardware, folder: Path, faults: DemoFaults | None = None) -> int:
    """Show the screens of an instrument until the operator quits; returns the exit code.

    folder : of its store
    faults : that the operator may switch in a demonstration
    """
    from device.tui.screens.app import RetroscanApp

    depth, profile = colour_depth(os.environ), hardware.profile
    if depth == "mono":
        os.environ["NO_COLOR"] = "1"
    # libcamera would write its log lines across the screens; "syslog" goes to the journal where there is one.
    os.environ.setdefault("LIBCAMERA_LOG_FILE", "syslog")
    report = ServiceReport(SdNotify.from_environment(os.environ), hardware.clock)
    with InstrumentThread(instrument, report) as thread:
        is_twin = profile.driver == "twin"
        program = ProgramInfo(version("retrograph"), folder, "battery" in profile.capabilities)
        app = RetroscanApp(instrument, program, depth, profile.sensor, is_twin, lambda: thread.has_ended, faults=faults)
        outcome = asyncio.run(_shown(app))
    if outcome == "off" and faults is None:
        power_off(SERVICE_FOLDER)
    return app.return_code or 0


async def _shown(app: RetroscanApp) -> str | None:
    """Run the app and return its result; a signal that ends it, or a lost terminal, makes it quit in order."""
    from device.tui.screens.app import STOPPED

    loop = asyncio.get_running_loop()
    numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    before = {number: signal.getsignal(number) for number in numbers}
    for number in numbers:
        code = STOPPED if number == signal.SIGINT else 0
        loop.add_signal_handler(number, partial(app.exit, return_code=code))
    try:
        with watched_terminal(lambda: loop.call_soon_threadsafe(app.exit)):
            return await app.run_async()
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)
            signal.signal(number, before[number])  # a second signal must not end the clean-up that follows


def power_off(service_folder: Path) -> None:
    """Ask the system to switch the machine off.

    Raises
    ------
    StoreError
        The machine was not installed as a handheld, so that no service handles the request.
    """
    try:
        (service_folder / POWER_OFF_FILE).touch()
    except OSError as error:
        raise StoreError(
            f"{service_folder}: cannot ask this machine to switch off ({error.strerror}); all scans are stored and the "
            "lights are off: switch it off by hand"
        ) from error


# Output to a terminal that may vanish.
#
# textual writes on a thread of its own, which an error of the terminal ends; its queue then fills up, and the program
# waits for it for ever, deaf to signals. So an error is not raised: it is reported once, and later output is dropped.


class TerminalOutput:
    """A terminal's stream whose errors are reported once instead of being raised.

    Parameters
    ----------
    stream : of the terminal
    on_lost : called once, on whichever thread writes
    """

    def __init__(self, stream: TextIO, on_lost: Callable[[], object]) -> None:
        self._stream = stream
        self._on_lost = on_lost
        self._is_lost = False

    def write(self, text: str) -> int:
        """Write, or drop the text if the terminal is gone; returns its length."""
        self._unless_lost(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush, unless the terminal is gone."""
        self._unless_lost(self._stream.flush)

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the stream's file descriptor."""
        return self._stream.fileno()

    @property
    def encoding(self) -> str:
        """Of the stream."""
        return self._stream.encoding

    def _unless_lost(self, work: Callable[[], object]) -> None:
        if self._is_lost:
            return
        try:
            work()
        except OSError:
            self._is_lost = True
            self._on_lost()


@contextmanager
def watched_terminal(on_lost: Callable[[], object]) -> Iterator[None]:
    """Context in which textual's terminal, the process's own standard error, is a `TerminalOutput`."""
    before = sys.__stderr__
    if before is None:
        yield
        return
    sys.__stderr__ = TerminalOutput(before, on_lost)  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        sys.__stderr__ = before  # type: ignore[misc]
