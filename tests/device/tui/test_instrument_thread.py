"""The instrument on its own thread: it runs beside the screens, and what kills it is raised where they are."""

from __future__ import annotations

from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest

from device.cli.screens import InstrumentThread
from device.cli.service import SdNotify, ServiceReport
from device.instrument.state import CalibrationState
from hal.clock import SystemClock


class Stepped:
    """An instrument that counts its steps, or breaks at one."""

    def __init__(self, breaks: bool = False) -> None:
        self.state = SimpleNamespace(activity="ready", calibration=CalibrationState(), scans_left=None, alarms=())
        self.stepped, self.left = Event(), Event()
        self._breaks = breaks

    def __enter__(self) -> Stepped:
        return self

    def __exit__(self, *exc: object) -> None:
        self.left.set()

    def step(self) -> None:
        self.stepped.set()
        if self._breaks:
            raise RuntimeError("broken")


def nobody() -> ServiceReport:
    return ServiceReport(SdNotify(None, None), SystemClock())


def test_it_steps_until_it_is_left() -> None:
    instrument: Any = Stepped()
    with InstrumentThread(instrument, nobody()) as thread:
        assert instrument.stepped.wait(60.0)
        assert not thread.has_ended
    assert instrument.left.is_set()


def test_what_breaks_it_ends_the_screens_and_is_raised() -> None:
    instrument: Any = Stepped(breaks=True)
    thread = InstrumentThread(instrument, nobody())
    thread.__enter__()
    assert instrument.left.wait(60.0)
    with pytest.raises(RuntimeError, match="broken"):
        thread.__exit__(None, None, None)
    assert thread.has_ended
