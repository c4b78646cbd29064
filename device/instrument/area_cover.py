"""An area larger than the field, press by press: every scan is placed in it, and the state says the way to the next."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Executor, Future

from device.acquisition.scanner import ScanOutcome
from device.guidance.cover_task import CoverTask
from device.instrument.events import Failed, Info
from device.instrument.state import AreaState, StateStore
from device.surface.fields import HeightMap


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
