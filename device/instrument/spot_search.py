"""Back to the spot of an earlier scan: pushes compare a touch with it and say the way; nothing is stored."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Final

from device.errors import DeviceError
from device.guidance.placement import Placement, Target, Unplaced, on_the_spot, placed, sentence, way_back
from device.instrument.events import Failed, Info, show
from device.instrument.state import SpotState, StateStore
from device.quick_look.solver import QuickLookModel
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
