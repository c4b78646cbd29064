"""Back to the spot of an earlier scan: pushes compare a touch with it and say the way; nothing is stored."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Final

from device.acquisition.scanner import ScanOutcome
from device.errors import DeviceError
from device.guidance.cover_task import CoverTask
from device.guidance.placement import Placement, Target, Unplaced, on_the_spot, placed, sentence, way_back
from device.instrument.events import Failed, Info, show
from device.instrument.state import AreaState, SpotState, StateStore
from device.quick_look.solver import QuickLookModel
from device.surface import HeightMap
from hal.frame import RawFrame
from hal.hardware import Hardware

BUSY: Final = "the last touch is still being placed: push again in a moment"
FIRST: Final = "Touch the object lightly, then push the button."


class SpotSearch:
    """The search for one earlier scan's spot, for the hardware's thread only; the state's `spot` shows it.

    Parameters
    ----------
    executor : places the touches
    """

    def __init__(self, hardware: Hardware, states: StateStore, executor: Executor) -> None:
        self._hardware = hardware
        self._states = states
        self._executor = executor
        self._target: Target | None = None
        self._placing: Future[Placement | Unplaced] | None = None

    @property
    def is_on(self) -> bool:
        """True if pushes compare touches, instead of scanning."""
        return self._target is not None

    def begin(self, spot: SpotState, target: Target) -> None:
        """Compare the next pushes with this scan."""
        self._target, self._placing = target, None
        self._states.update(spot=spot)

    def end(self) -> None:
        """Pushes scan again."""
        self._target = self._placing = None
        self._states.update(spot=None)

    def compare(self, touch: RawFrame, model: QuickLookModel) -> None:
        """Place a touch; `collect` says the way. One that is taken after the end is dropped."""
        if (target := self._target) is None:
            return
        if self._placing:
            self._states.publish(Failed(BUSY))
            return
        self._placing = self._executor.submit(lambda: placed(touch, model, target))

    def collect(self) -> None:
        """Say the way back once the last touch is placed."""
        spot = self._states.state.spot
        if spot is None or self._placing is None or not self._placing.done():
            return
        placing, self._placing = self._placing, None
        try:
            found = placing.result()
        except DeviceError as error:
            self._states.publish(Failed(str(error)))
            return
        reached = on_the_spot(found)
        self._states.update(spot=replace(spot, sentence=sentence(found), is_reached=reached, way=way_back(found)))
        self._states.publish(Info(sentence(found)))
        show(self._hardware, "good" if reached else "retake" if isinstance(found, Unplaced) else "doubtful")


# An area larger than the field, press by press: every scan is placed in it, and the state says the way to the next.


class AreaCover:
    """The area that is being covered, for the hardware's thread only; the state's `area` shows it.

    Parameters
    ----------
    executor : places the scans
    """

    def __init__(self, states: StateStore, executor: Executor) -> None:
        self._states = states
        self._executor = executor
        self._task: CoverTask | None = None
        self._adding: deque[Future[AreaState]] = deque()

    def begin(self, width_mm: float, height_mm: float) -> None:
        """Place the next scans in an area; `Failed` while a press is still being judged."""
        if self._states.state.processing:
            self._states.publish(Failed("the last press is still being judged: try again in a moment"))
            return
        self._task = task = CoverTask(width_mm, height_mm)
        self._adding.clear()
        self._states.update(area=AreaState(width_mm, height_mm, None, task.sentence()))
        self._states.publish(Info(task.sentence()))

    def end(self) -> None:
        """Scans are no longer placed; they are kept."""
        self._task = None
        self._adding.clear()
        self._states.update(area=None)

    def add(self, outcome: ScanOutcome) -> None:
        """Place a finished scan; one of the check standard is left out."""
        record = outcome.bundle.record
        area = self._states.state.area
        if (task := self._task) is None or area is None:
            return
        if record.check is not None and record.check.scan_id == record.scan_id:
            return
        look = outcome.quick_look
        height = look.height if look and record.verdict.level != "retake" else None
        self._adding.append(self._executor.submit(lambda: _added(task, height, (area.width_mm, area.height_mm))))

    def collect(self) -> None:
        """Show what the scans cover that were placed since the last call."""
        while self._adding and self._adding[0].done():
            area = self._adding.popleft().result()
            self._states.update(area=area)
            self._states.publish(Info(area.sentence))


def _added(task: CoverTask, height: HeightMap | None, size_mm: tuple[float, float]) -> AreaState:
    task.add(height)
    return AreaState(*size_mm, task.map(), task.sentence(), task.is_done, task.hand_way)
