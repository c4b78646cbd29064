"""One press after the other: taken at once, processed beside, refused with a cue when it cannot be taken.

A press begins when the button goes down: cue, frame, "you may lift". It counts once the button is released: what is
held long asks for something else, and its frame is not published.
The disk and the quick look are another thread's work; the next press is taken meanwhile.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Final, Literal

from device.errors import DeviceError, NoCalibration, StoreError
from device.scanning.scanner import Scanner, ScanOutcome, TakenPress
from device.session.button_watch import ButtonWatch
from device.session.cues import REFUSALS, show
from device.session.events import Failed, MayLift, PressRefused, PressSeen, RefusalReason, ScanFinished
from device.session.noticeboard import Noticeboard
from device.session.state import LastScan
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware

MOST_IN_WORK: Final = 2
"""Frames in memory that wait for the disk: more presses are refused until one is safe."""

LATEST_CUE_MS: Final = 100.0
"""A cue for a press that is older than this is dropped: it would answer to nothing."""

Source = Literal["button", "screen", "auto-shutter"]
Work = Future[tuple[ScanOutcome, float]]
Taken = tuple[Scanner, TakenPress]
"""A press in memory with the scanner that took it: it is judged and recorded by no other."""


class PressCycle:
    """Presses of one instrument.

    Parameters
    ----------
    scanner : the scanner that is in force, asked anew for each press
    motion : how much a frame differs from the live one before it
    long_push : what a long push does
    """

    def __init__(
        self,
        hardware: Hardware,
        board: Noticeboard,
        executor: Executor,
        scanner: Callable[[], Scanner],
        motion: Callable[[RawFrame], float | None],
        long_push: Callable[[], None],
    ) -> None:
        self._hardware = hardware
        self._board = board
        self._executor = executor
        self._scanner = scanner
        self._motion = motion
        self._long_push = long_push
        self._works: deque[Work] = deque()
        self._held: Taken | None = None
        self._button = ButtonWatch(hardware)
        self._busy_until_ns = 0

    def watch_button(self, wait_s: float) -> bool:
        """Listen to the button for so long, see to what it did, and say whether it did anything.

        Raises
        ------
        ButtonError
            The button cannot be read.
        """
        happening = self._button.look(wait_s)
        if happening == "pushed":
            self._pushed(self._button.began_ns or 0)
            happening = self._button.look(0.0)
        if happening in {"short", "long"}:
            self._released(was_long=happening == "long")
        return happening is not None or self._button.began_ns is not None

    def scan(self, source: Source) -> None:
        """A press that did not come from the button."""
        taken = self.take(source, self._hardware.clock.monotonic_ns())
        if taken:
            self.submit(taken)

    def take(self, source: Source, began_ns: int) -> Taken | None:
        """The frame of a press in memory, or None when it was refused and that was shown."""
        now_ns = self._hardware.clock.monotonic_ns()
        if not (scanner := self._admitted()):
            return None
        latency_ms = (now_ns - began_ns) * 1e-6
        if latency_ms <= LATEST_CUE_MS:
            show(self._hardware, "busy")
        self._board.tell(PressSeen(now_ns, latency_ms, source))
        try:
            taken = scanner.take()
        except (DeviceError, HalError) as error:
            self.refuse("hardware", str(error))
            return None
        finally:
            self._busy_until_ns = self._hardware.clock.monotonic_ns()
        self._board.tell(MayLift(self._busy_until_ns))
        motion = self._motion(taken.shot.frame)
        show(self._hardware, "may lift")
        return scanner, replace(taken, motion=motion)

    def submit(self, press: Taken) -> None:
        """Hand a frame over to be judged and published."""
        (scanner, taken), annotations = press, self._board.state.sticky

        def work() -> tuple[ScanOutcome, float]:
            began_s = time.thread_time()
            outcome = scanner.publish(taken, annotations)
            return outcome, 1e3 * (time.thread_time() - began_s)

        self._works.append(self._executor.submit(work))
        self._board.change(processing=len(self._works))

    def collect(self) -> list[ScanOutcome]:
        """Scans that were finished since the last call, told of and shown."""
        finished = []
        while self._works and self._works[0].done():
            work = self._works.popleft()
            try:
                outcome, cpu_ms = work.result()
            except DeviceError as error:
                self._board.change(processing=len(self._works), sentence=str(error))
                self._board.tell(Failed(str(error)))
                show(self._hardware, "refused: full" if isinstance(error, StoreError) else "refused: hardware")
                continue
            self._finish(outcome, cpu_ms)
            finished.append(outcome)
        return finished

    def refuse(self, reason: RefusalReason, sentence: str) -> None:
        """Say and show that a press did nothing."""
        self._board.change(sentence=sentence)
        self._board.tell(PressRefused(self._hardware.clock.monotonic_ns(), reason, sentence))
        show(self._hardware, REFUSALS[reason])

    def _pushed(self, began_ns: int) -> None:
        """The button goes down: take the frame now, and let the release decide what becomes of it."""
        if began_ns < self._busy_until_ns:
            self.refuse("busy", "a push came while the frame was being taken and did nothing: push again")
        else:
            self._held = self.take("button", began_ns)

    def _released(self, was_long: bool) -> None:
        """The press is over, or long already: its frame counts, or something else was asked for."""
        taken, self._held = self._held, None
        if was_long:
            self._long_push()
        elif taken:
            self.submit(taken)

    def _admitted(self) -> Scanner | None:
        """The scanner, when a press can be taken now; else the refusal was shown."""
        if len(self._works) >= MOST_IN_WORK:
            self.refuse("busy", f"{len(self._works)} scans are still being stored: push again in a moment")
            return None
        try:
            scanner = self._scanner()
            self._board.change(scans_left=scanner.check_room())
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
        stored = self._board.state.scans_stored
        self._board.change(
            processing=len(self._works),
            last=last,
            scans_stored=None if stored is None else stored + 1,
            sentence=f"{record.verdict.level}: {record.verdict.reason}",
        )
        now_ns = self._hardware.clock.monotonic_ns()
        self._board.tell(ScanFinished(now_ns, record.scan_id, record.verdict, height, fault, cpu_ms))
        # Whoever pushes on does not wait for a rhythm to end.
        if not self._button.is_waiting():
            show(self._hardware, record.verdict.level)
