"""The instrument on a thread of its own, beside the screens; its loop also feeds the service manager's watchdog."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event as Flag
from typing import Self

from device.session.instrument import Instrument
from device.session.service_report import ServiceReport


class InstrumentThread:
    """Steps an instrument from entering to leaving. A context manager; leaving waits for what is in work.

    Parameters
    ----------
    instrument : not entered; the thread enters and leaves it
    report : hears of every turn
    """

    def __init__(self, instrument: Instrument, report: ServiceReport) -> None:
        self._instrument = instrument
        self._report = report
        self._stop = Flag()
        self._executor = ThreadPoolExecutor(1, "instrument")
        self._running: Future[None] | None = None

    @property
    def has_ended(self) -> bool:
        """Whether the loop has ended though nobody asked it to; leaving then raises why."""
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
