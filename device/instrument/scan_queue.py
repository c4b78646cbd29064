"""Scans one after another: captured at once, processed in the background.

A press whose frame shows too little untouched skin to prove the lights right waits, for at most ten seconds, until the
operator has lifted and a live frame shows them: only then it is judged and published.

A press begins at button-down: cue, frame, "you may lift". It counts at the release: a long push means something else,
and its frame is discarded. Another thread computes the quick look and writes the disk, so that presses never wait.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeVar

from device.acquisition.check_press import BallInDoubt
from device.acquisition.scanner import LIFT_PATIENCE_S, Assessment, RawCapture, Scanner, ScanOutcome
from device.bundles.check import CheckStandard
from device.bundles.scan import Annotations, Retake
from device.errors import DeviceError, NoCalibration, StoreError
from device.instrument.button import ButtonEvent, ButtonWatch
from device.instrument.events import (
    REFUSALS,
    CaptureDone,
    CheckAsked,
    Checked,
    Failed,
    Info,
    PressRefused,
    PressSeen,
    RefusalReason,
    ScanFinished,
    show,
)
from device.instrument.history import DeletedScans, ScanLabels
from device.instrument.spot_search import SpotSearch
from device.instrument.state import LastScan, StateStore
from hal.errors import HalError
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import MayLift

MAX_IN_WORK: Final = 2
"""Maximum number of frames in memory that wait for the disk; further presses are refused."""

MAX_CUE_DELAY_MS: Final = 100.0
"""The "busy" cue is skipped for older presses: the operator could not relate it to the push."""

AWAKE: Final = "Lights on: push again to scan."
REPLACED: Final = "The scan before was replaced: z on Scans brings it back until power off."
KEPT_BOTH: Final = "The new scan is no better: both are kept."
MOVED_ALONE: Final = "It moved while each light shone alone: those frames were left out."
LIFT_OFF: Final = "lift off: the lights are checked on untouched skin, then comes the verdict"

Source = Literal["button", "screen", "auto-shutter"]
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class CapturedPress:
    """A press in memory.

    scanner : also judges and records it
    standard : the check standard that is pressed, if one is
    replaces : the scan that is taken again, if one is
    is_touch : it is compared with an earlier scan's spot, not stored; all as it was when the press began
    """

    scanner: Scanner
    raw: RawCapture
    standard: CheckStandard | None = None
    replaces: Retake | None = None
    is_touch: bool = False


@dataclass(slots=True)
class QueuedPress:
    """A press on its way to the disk.

    assessing, publishing : its two pieces of work, each with its CPU time (ms); between them it may wait for untouched
        skin, until `until_ns`
    is_asked : the operator was asked about the check's ball; it waits for the answer
    is_certain : nothing is asked about it any more
    """

    press: CapturedPress
    annotations: Annotations
    until_ns: int
    assessing: Future[tuple[Assessment, float]]
    publishing: Future[tuple[ScanOutcome, float]] | None = None
    is_announced: bool = False
    is_asked: bool = False
    is_certain: bool = False


class ScanQueue:
    """The scans of one instrument.

    Parameters
    ----------
    scanner : returns the active scanner; called for each press
    motion : how much a frame differs from the last live frame
    on_long_press : called after a long push ("long"), and when it is held on until power off ("off")
    is_asleep : whether the next push only wakes the instrument
    labels, deleted, spot : annotations of scans, where a replaced one goes, and what compares touches

    `asks` says whether a front end can ask the operator about a check; otherwise a look-alike is a failed check.
    """

    def __init__(
        self,
        hardware: Hardware,
        states: StateStore,
        executor: Executor,
        scanner: Callable[[], Scanner],
        motion: Callable[[RawFrame], float | None],
        on_long_press: Callable[[ButtonEvent], None],
        is_asleep: Callable[[], bool],
        labels: ScanLabels,
        deleted: DeletedScans,
        spot: SpotSearch,
    ) -> None:
        self._hardware = hardware
        self._states = states
        self._executor = executor
        self._scanner = scanner
        self._motion = motion
        self._on_long_press = on_long_press
        self._is_asleep = is_asleep
        self._labels = labels
        self._deleted = deleted
        self._spot = spot
        self._queued: deque[QueuedPress] = deque()
        self._held: CapturedPress | None = None
        self._button = ButtonWatch(hardware)
        self._busy_until_ns = 0
        self.asks = False

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
        elif event == "off":
            self._on_long_press(event)
        return event is not None or self._button.began_ns is not None

    def scan(self, source: Source) -> None:
        """Scan without the button."""
        if self._is_asleep():
            self._states.publish(Info(AWAKE))
            return
        taken = self.capture(source, self._hardware.clock.monotonic_ns())
        if taken:
            self.submit(taken)

    def capture(self, source: Source, began_ns: int) -> CapturedPress | None:
        """Capture a press into memory; None if it was refused (already reported)."""
        now_ns = self._hardware.clock.monotonic_ns()
        before, is_touch = self._states.state, self._spot.is_on
        if not (scanner := self._admitted(stores=not is_touch)):
            return None
        latency_ms = (now_ns - began_ns) * 1e-6
        if latency_ms <= MAX_CUE_DELAY_MS:
            show(self._hardware, "busy")
        self._states.publish(PressSeen(now_ns, latency_ms, source))
        try:
            taken = scanner.capture(mode="single" if is_touch else before.settings.capture)
        except (DeviceError, HalError) as error:
            self.refuse("hardware", str(error))
            return None
        finally:
            self._busy_until_ns = self._hardware.clock.monotonic_ns()
        self._states.publish(CaptureDone(self._busy_until_ns))
        motion = self._motion(taken.frame)
        show(self._hardware, "may lift")
        self._hardware.operator.ask(MayLift())
        if taken.precise.alone_moved:
            self._states.publish(Info(MOVED_ALONE))
        standard = before.check.standard if before.check.is_next else None
        return CapturedPress(
            scanner, replace(taken, motion=motion), standard, None if standard else before.replaces, is_touch
        )

    def submit(self, press: CapturedPress) -> None:
        """Hand a press over to be judged and published, or compared."""
        if press.is_touch:
            self._spot.compare(press.raw.lit, press.scanner.model)
            return
        until_ns = press.raw.frame.sensor_timestamp_ns + round(LIFT_PATIENCE_S * 1e9)
        assessing = self._timed(lambda: press.scanner.assess(press.raw))
        state = self._states.state
        if press.standard:
            self._states.update(check=replace(state.check, is_next=False))
            annotations = state.sticky
        elif press.replaces:
            annotations = press.replaces.annotations
            if state.replaces == press.replaces:
                self._states.update(replaces=None)
        else:
            annotations = self._labels.take()
        self._queued.append(QueuedPress(press, annotations, until_ns, assessing))
        self._states.update(processing=len(self._queued))

    def collect(self, *, waits: bool = True) -> list[ScanOutcome]:
        """Report the scans that were finished since the last call, and return them.

        waits : whether presses may go on waiting for untouched skin
        """
        finished = []
        for pending in tuple(self._queued):
            try:
                outcome = self._advance(pending, waits)
            except DeviceError as error:
                self._queued.remove(pending)
                self._states.update(processing=len(self._queued), sentence=str(error))
                self._give_back(pending)
                self._states.publish(Failed(str(error)))
                show(self._hardware, "refused: full" if isinstance(error, StoreError) else "refused: hardware")
                continue
            if outcome:
                self._queued.remove(pending)
                self._finish(*outcome)
                if pending.press.replaces:
                    self._replace(pending.press.replaces, outcome[0])
                finished.append(outcome[0])
        return finished

    def answer_check(self, *, is_standard: bool) -> None:
        """Go on with the check that was asked about: failed if it is the standard, otherwise to be pressed again."""
        pending = next((one for one in self._queued if one.is_asked), None)
        if pending is None:
            return
        pending.is_asked, pending.is_certain = False, True
        if is_standard or pending.press.standard is None:
            return
        self._queued.remove(pending)
        self._states.update(processing=len(self._queued))
        self._give_back(pending)
        self._states.publish(Info(f"Press {pending.press.standard.name}, then push."))

    def _give_back(self, pending: QueuedPress) -> None:
        """After a press that was not stored: the check, the retake or the part's number is still to come."""
        if pending.press.standard is not None:
            self._states.update(check=replace(self._states.state.check, is_next=True))
        elif pending.press.replaces:
            self._states.update(replaces=self._states.state.replaces or pending.press.replaces)
        else:
            self._labels.give_back(pending.annotations)

    def _replace(self, old: Retake, outcome: ScanOutcome) -> None:
        """Delete the scan that was taken again if the new one replaces it."""
        if outcome.bundle.record.replaces != old.scan_id:
            self._states.publish(Info(KEPT_BOTH))
            return
        try:
            self._deleted.delete(old.scan_id)
        except DeviceError as error:
            self._states.publish(Failed(str(error)))
            return
        self._states.publish(Info(REPLACED))

    def forget_push(self) -> bool:
        """Drop a push whose release was missed while a part did not answer; returns whether there was one."""
        self._held = None
        return self._button.forget()

    def finish(self) -> None:
        """Store every press in memory, without waiting for untouched skin any more."""
        while self._queued:
            self.collect(waits=False)
            for pending in self._queued:
                (pending.publishing or pending.assessing).exception()

    def _advance(self, pending: QueuedPress, waits: bool) -> tuple[ScanOutcome, float] | None:
        """Take the next step of a press that is due; its outcome and CPU time (ms) once it is published."""
        if not pending.assessing.done():
            return None
        assessed, spent_ms = pending.assessing.result()
        if pending.publishing is None:
            if waits and (pending.is_asked or self._must_wait(pending, assessed)):
                return None
            press, annotations = pending.press, pending.annotations
            asks = waits and self.asks and not pending.is_certain
            pending.is_asked = False
            pending.publishing = self._timed(
                lambda: press.scanner.publish(assessed, annotations, press.standard, press.replaces, asks=asks)
            )
        if not pending.publishing.done():
            return None
        try:
            outcome, more_ms = pending.publishing.result()
        except BallInDoubt as doubt:
            pending.publishing, pending.is_asked = None, True
            self._states.update(sentence=str(doubt))
            self._states.publish(CheckAsked(str(doubt)))
            return None
        return outcome, spent_ms + more_ms

    def _must_wait(self, pending: QueuedPress, assessed: Assessment) -> bool:
        in_time = self._hardware.clock.monotonic_ns() < pending.until_ns
        must = in_time and assessed.awaits_lift and not pending.press.scanner.lights_proven(assessed)
        if must and not pending.is_announced:
            pending.is_announced = True
            self._states.update(sentence=LIFT_OFF)
            self._states.publish(Info(LIFT_OFF))
        return must

    def _timed(self, act: Callable[[], Result]) -> Future[tuple[Result, float]]:
        """Work for the other thread, with its CPU time, ms."""

        def work() -> tuple[Result, float]:
            began_s = time.thread_time()
            done = act()
            return done, 1e3 * (time.thread_time() - began_s)

        return self._executor.submit(work)

    def refuse(self, reason: RefusalReason, sentence: str) -> None:
        """Report a refused press by event and cue."""
        self._states.update(sentence=sentence)
        self._states.publish(PressRefused(self._hardware.clock.monotonic_ns(), reason, sentence))
        show(self._hardware, REFUSALS[reason])

    def _pushed(self, began_ns: int) -> None:
        """Take the frame at button-down; the release decides what becomes of it."""
        if self._is_asleep():
            self._states.publish(Info(AWAKE))
        elif began_ns < self._busy_until_ns:
            self.refuse("busy", "a push was ignored while the frame was being taken: push again")
        else:
            self._held = self.capture("button", began_ns)

    def _released(self, was_long: bool) -> None:
        """At the release, or after the long-push time: submit the frame, or handle the long push."""
        taken, self._held = self._held, None
        if was_long:
            self._on_long_press("long")
        elif taken:
            self.submit(taken)

    def _admitted(self, *, stores: bool) -> Scanner | None:
        """Return the scanner if a press can be taken now, with room where it `stores` one; else report the refusal."""
        if len(self._queued) >= MAX_IN_WORK:
            self._stop_waiting()
        if len(self._queued) >= MAX_IN_WORK:
            self.refuse("busy", f"{len(self._queued)} scans are still being stored: push again in a moment")
            return None
        try:
            scanner = self._scanner()
            if stores:
                self._states.update(scans_left=scanner.check_room(self._states.state.settings.capture))
        except StoreError as error:
            self.refuse("full", str(error))
        except (NoCalibration, DeviceError) as error:
            self.refuse("calibration", str(error))
        except HalError as error:
            self.refuse("hardware", str(error))
        else:
            return scanner
        return None

    def _stop_waiting(self) -> None:
        """Publish the oldest press that waits for untouched skin, since the operator presses again without lifting."""
        waiting = next((pending for pending in self._queued if pending.is_announced), None)
        if waiting:
            waiting.until_ns = 0
            self.collect()

    def _finish(self, outcome: ScanOutcome, cpu_ms: float) -> None:
        record = outcome.bundle.record
        height = outcome.quick_look.height if outcome.quick_look else None
        fault = outcome.quick_look_fault
        number = record.identity.counter
        last = LastScan(record.scan_id, number, record.verdict, height, fault, record.annotations)
        self._states.count_stored(1)
        self._states.update(
            processing=len(self._queued),
            last=last,
            sentence=f"{record.verdict.level}: {record.verdict.reason}",
        )
        now_ns = self._hardware.clock.monotonic_ns()
        if record.check is not None and record.check.scan_id == record.scan_id:
            self._states.publish(Checked(record.check.passed, f"C{record.check.sentence[1:]}."))
        self._states.publish(ScanFinished(now_ns, record.scan_id, record.verdict, height, fault, cpu_ms))
        # An operator who is already pushing again must not wait for the cue to end.
        if not self._button.is_waiting():
            show(self._hardware, record.verdict.level)
