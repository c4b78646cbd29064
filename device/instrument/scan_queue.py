"""Scans one after another: captured at once, processed in the background.

A press begins at button-down: cue, frame, "you may lift". It counts at the release: a long push means something else,
and its frame is discarded. Another thread computes the quick look and writes the disk, so that presses never wait.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Final, Literal

from device.acquisition.scanner import RawCapture, Scanner, ScanOutcome
from device.errors import DeviceError, NoCalibration, StoreError
from device.instrument.button import ButtonWatch
from device.instrument.events import (
    REFUSALS,
    CaptureDone,
    Failed,
    PressRefused,
    PressSeen,
    RefusalReason,
    ScanFinished,
    show,
)
from device.instrument.state import LastScan, StateStore
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware

MAX_IN_WORK: Final = 2
"""Maximum number of frames in memory that wait for the disk; further presses are refused."""

MAX_CUE_DELAY_MS: Final = 100.0
"""The "busy" cue is skipped for older presses: the operator could not relate it to the push."""

Source = Literal["button", "screen", "auto-shutter"]
Work = Future[tuple[ScanOutcome, float]]
Taken = tuple[Scanner, RawCapture]
"""A press in memory with its scanner, which also judges and records it."""


class ScanQueue:
    """The scans of one instrument.

    Parameters
    ----------
    scanner : returns the active scanner; called for each press
    motion : how much a frame differs from the last live frame
    on_long_press : called after a long push
    """

    def __init__(
        self,
        hardware: Hardware,
        states: StateStore,
        executor: Executor,
        scanner: Callable[[], Scanner],
        motion: Callable[[RawFrame], float | None],
        on_long_press: Callable[[], None],
    ) -> None:
        self._hardware = hardware
        self._states = states
        self._executor = executor
        self._scanner = scanner
        self._motion = motion
        self._on_long_press = on_long_press
        self._works: deque[Work] = deque()
        self._held: Taken | None = None
        self._button = ButtonWatch(hardware)
        self._busy_until_ns = 0

    def watch_button(self, wait_s: float) -> bool:
        """Wait for the button up to `wait_s`, handle its events, and return whether it was pushed.

        Raises
        ------
        ButtonError
            The button cannot be read.
        """
        event = self._button.wait(wait_s)
        if event == "pushed":
            self._pushed(self._button.began_ns or 0)
            event = self._button.wait(0.0)
        if event in {"short", "long"}:
            self._released(was_long=event == "long")
        return event is not None or self._button.began_ns is not None

    def scan(self, source: Source) -> None:
        """Scan without the button."""
        taken = self.capture(source, self._hardware.clock.monotonic_ns())
        if taken:
            self.submit(taken)

    def capture(self, source: Source, began_ns: int) -> Taken | None:
        """Capture a press into memory; None if it was refused (already reported)."""
        now_ns = self._hardware.clock.monotonic_ns()
        if not (scanner := self._admitted()):
            return None
        latency_ms = (now_ns - began_ns) * 1e-6
        if latency_ms <= MAX_CUE_DELAY_MS:
            show(self._hardware, "busy")
        self._states.publish(PressSeen(now_ns, latency_ms, source))
        try:
            taken = scanner.capture()
        except (DeviceError, HalError) as error:
            self.refuse("hardware", str(error))
            return None
        finally:
            self._busy_until_ns = self._hardware.clock.monotonic_ns()
        self._states.publish(CaptureDone(self._busy_until_ns))
        motion = self._motion(taken.capture.frame)
        show(self._hardware, "may lift")
        return scanner, replace(taken, motion=motion)

    def submit(self, press: Taken) -> None:
        """Hand a press over to be judged and published."""
        (scanner, taken), annotations = press, self._states.state.sticky

        def work() -> tuple[ScanOutcome, float]:
            began_s = time.thread_time()
            outcome = scanner.publish(taken, annotations)
            return outcome, 1e3 * (time.thread_time() - began_s)

        self._works.append(self._executor.submit(work))
        self._states.update(processing=len(self._works))

    def collect(self) -> list[ScanOutcome]:
        """Report the scans that were finished since the last call, and return them."""
        finished = []
        while self._works and self._works[0].done():
            work = self._works.popleft()
            try:
                outcome, cpu_ms = work.result()
            except DeviceError as error:
                self._states.update(processing=len(self._works), sentence=str(error))
                self._states.publish(Failed(str(error)))
                show(self._hardware, "refused: full" if isinstance(error, StoreError) else "refused: hardware")
                continue
            self._finish(outcome, cpu_ms)
            finished.append(outcome)
        return finished

    def refuse(self, reason: RefusalReason, sentence: str) -> None:
        """Report a refused press by event and cue."""
        self._states.update(sentence=sentence)
        self._states.publish(PressRefused(self._hardware.clock.monotonic_ns(), reason, sentence))
        show(self._hardware, REFUSALS[reason])

    def _pushed(self, began_ns: int) -> None:
        """Take the frame at button-down; the release decides what becomes of it."""
        if began_ns < self._busy_until_ns:
            self.refuse("busy", "a push was ignored while the frame was being taken: push again")
        else:
            self._held = self.capture("button", began_ns)

    def _released(self, was_long: bool) -> None:
        """At the release, or after the long-push time: submit the frame, or handle the long push."""
        taken, self._held = self._held, None
        if was_long:
            self._on_long_press()
        elif taken:
            self.submit(taken)

    def _admitted(self) -> Scanner | None:
        """The scanner if a press can be taken now; otherwise the refusal is reported."""
        if len(self._works) >= MAX_IN_WORK:
            self.refuse("busy", f"{len(self._works)} scans are still being stored: push again in a moment")
            return None
        try:
            scanner = self._scanner()
            self._states.update(scans_left=scanner.check_room())
        except StoreError as error:
            self.refuse("full", str(error))
        except (NoCalibration, DeviceError) as error:
            self.refuse("calibration", str(error))
        except HalError as error:
            self.refuse("hardware", str(error))
        else:
            return scanner
        return None

    def _finish(self, outcome: ScanOutcome, cpu_ms: float) -> None:
        record = outcome.bundle.record
        height = outcome.quick_look.height if outcome.quick_look else None
        fault = outcome.quick_look_fault
        last = LastScan(record.scan_id, record.identity.counter, record.verdict, height, fault)
        stored = self._states.state.scans_stored
        self._states.update(
            processing=len(self._works),
            last=last,
            scans_stored=None if stored is None else stored + 1,
            sentence=f"{record.verdict.level}: {record.verdict.reason}",
        )
        now_ns = self._hardware.clock.monotonic_ns()
        self._states.publish(ScanFinished(now_ns, record.scan_id, record.verdict, height, fault, cpu_ms))
        # An operator who is already pushing again must not wait for the cue to end.
        if not self._button.is_waiting():
            show(self._hardware, record.verdict.level)
