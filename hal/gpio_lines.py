"""GPIO lines through libgpiod v2; a chip is chosen by its label, since its number differs between kernels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Protocol, Self

from hal.driver_library import require
from hal.errors import ButtonError, DriverMissing, HalError, IndicatorError

if TYPE_CHECKING:
    import gpiod

CONSUMER = "retroscan"
EVENT_BUFFER = 1024
"""Edges that the kernel keeps while nobody listens: its most; a bouncing press makes a dozen."""

DEVICES = Path("/dev")
_INSTALL = "pip install 'gpiod>=2.2' in the program's venv (bookworm's python3-libgpiod is version 1)"


@dataclass(frozen=True, slots=True)
class Edge:
    """The line changed its level then (clock's monotonic ns); `active` is the level afterwards."""

    at_ns: int
    active: bool


class InputLine(Protocol):
    """A line that reports its edges."""

    def wait(self, timeout_s: float | None) -> bool:
        """True when edges can be read before `timeout_s` went by (None waits for ever)."""
        ...

    def edges(self) -> list[Edge]:
        """The edges since the last call, oldest first."""
        ...

    def is_active(self) -> bool:
        """The level now."""
        ...

    def release(self) -> None:
        """Give the line back."""
        ...


OpenInput = Callable[[], InputLine]


class GpiodInput:
    """An input line over libgpiod; see `InputLine`.

    Parameters
    ----------
    request : the line request that libgpiod granted
    """

    def __init__(self, request: gpiod.LineRequest, place: str) -> None:
        self._request = request
        self._place = place

    @classmethod
    def open(cls, label: str, offset: int, active_low: bool) -> Self:
        """The line at an offset of the chip with that label, pulled to rest, reporting both edges.

        Raises
        ------
        DriverMissing, ButtonError
            libgpiod is not installed or of version 1; no such chip or line, or somebody else holds it.
        """
        gpiod = load_gpiod()
        from gpiod.line import Bias, Clock, Direction, Edge

        settings = gpiod.LineSettings(
            direction=Direction.INPUT,
            edge_detection=Edge.BOTH,
            bias=Bias.PULL_UP if active_low else Bias.PULL_DOWN,
            active_low=active_low,
            event_clock=Clock.MONOTONIC,
        )
        place = f"the button on line {offset} of GPIO chip {label!r}"
        chip = _chip_path(label, place, ButtonError)
        try:
            request = gpiod.request_lines(
                chip, consumer=CONSUMER, config={offset: settings}, event_buffer_size=EVENT_BUFFER
            )
        except (OSError, ValueError) as error:
            raise ButtonError(f"{place} cannot be had ({error}): check button.line and who else uses it") from error
        return cls(request, place)

    def wait(self, timeout_s: float | None) -> bool:
        """True when edges can be read."""
        try:
            return self._request.wait_edge_events(timeout_s)
        except OSError as error:
            raise self._unreadable(error) from error

    def edges(self) -> list[Edge]:
        """The edges since the last call."""
        from gpiod import EdgeEvent

        try:
            events = self._request.read_edge_events()
        except OSError as error:
            raise self._unreadable(error) from error
        return [Edge(event.timestamp_ns, event.event_type is EdgeEvent.Type.RISING_EDGE) for event in events]

    def is_active(self) -> bool:
        """The level now."""
        from gpiod.line import Value

        try:
            return self._request.get_value(self._request.offsets[0]) is Value.ACTIVE
        except OSError as error:
            raise self._unreadable(error) from error

    def release(self) -> None:
        """Give the line back."""
        self._request.release()

    def _unreadable(self, error: OSError) -> ButtonError:
        return ButtonError(f"{self._place} cannot be read ({error.strerror}): check its wiring")


class GpiodOutput:
    """An output line over libgpiod, low at first and when it is given back."""

    def __init__(self, label: str, offset: int) -> None:
        self._label = label
        self._offset = offset
        self._request: gpiod.LineRequest | None = None

    def switch(self, on: bool) -> None:
        """Drive the line; the first call asks for it.

        Raises
        ------
        DriverMissing, IndicatorError
            libgpiod is not installed or of version 1; no such chip or line, or somebody else holds it.
        """
        gpiod = load_gpiod()
        from gpiod.line import Direction, Value

        place = f"the indicator on line {self._offset} of GPIO chip {self._label!r}"
        try:
            if self._request is None:
                settings = gpiod.LineSettings(direction=Direction.OUTPUT, output_value=Value.INACTIVE)
                chip = _chip_path(self._label, place, IndicatorError)
                self._request = gpiod.request_lines(chip, consumer=CONSUMER, config={self._offset: settings})
            self._request.set_value(self._offset, Value.ACTIVE if on else Value.INACTIVE)
        except (OSError, ValueError) as error:
            if isinstance(error, HalError):
                raise
            raise IndicatorError(f"{place} cannot be driven ({error}): check indicator.line") from error

    def release(self) -> None:
        """Give the line back."""
        if self._request is not None:
            self._request.release()
            self._request = None


def load_gpiod() -> ModuleType:
    """libgpiod's Python module, version 2.

    Raises
    ------
    DriverMissing
        It is not installed, cannot be imported, or is of version 1, which has another interface.
    """
    require("gpiod", _INSTALL)
    try:
        import gpiod
    except (ImportError, OSError) as error:
        raise DriverMissing(f"the library gpiod is installed and cannot be imported ({error}): {_INSTALL}") from error
    if not hasattr(gpiod, "request_lines"):
        told = getattr(gpiod, "version_string", None)
        found = told() if callable(told) else "1"
        raise DriverMissing(f"the library gpiod here is version {found} and version 2 is needed: {_INSTALL}")
    module: ModuleType = gpiod
    return module


def _chip_path(label: str, place: str, failure: type[HalError]) -> str:
    """Device file of the GPIO chip with that label."""
    import gpiod

    found = []
    for path in sorted(DEVICES.glob("gpiochip*")):
        try:
            with gpiod.Chip(str(path)) as chip:
                found.append(chip.get_info().label)
        except OSError:
            found.append(f"{path.name} (not to be opened)")
            continue
        if found[-1] == label:
            return str(path)
    there = ", ".join(found) or "none"
    raise failure(f"{place} is not there: the chips of this machine are {there}; check button.chip_label")
