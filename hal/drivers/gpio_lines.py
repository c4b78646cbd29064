"""GPIO lines through libgpiod v2, and the indicator on one of them: one-bit rhythms for an LED or a buzzer.

A chip is selected by its label, since its number differs between kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Final, Protocol, Self

from hal.drivers.i2c_bus import require_package
from hal.errors import ButtonError, DriverMissing, HalError, IndicatorError, LightError
from hal.interfaces import Clock, Cue

if TYPE_CHECKING:
    import gpiod

CONSUMER = "retroscan"
EVENT_BUFFER = 1024
"""Number of edges that the kernel buffers, its maximum; a bouncing press makes a dozen."""

DEVICES = Path("/dev")
"""Folder of the GPIO chips' device files."""
_INSTALL = "pip install 'gpiod>=2.2' in the program's venv (bookworm's python3-libgpiod is version 1)"


@dataclass(frozen=True, slots=True)
class Edge:
    """A change of level at that time (clock's monotonic ns); `active` is the level afterwards."""

    at_ns: int
    active: bool


class InputLine(Protocol):
    """A line that reports its edges."""

    def wait(self, timeout_s: float | None) -> bool:
        """Return True when edges can be read within `timeout_s` (None waits without limit)."""
        ...

    def edges(self) -> list[Edge]:
        """Return edges since the last call, oldest first."""
        ...

    def is_active(self) -> bool:
        """Return the level now."""
        ...

    def release(self) -> None:
        """Release the line."""
        ...


OpenInput = Callable[[], InputLine]


class GpiodInput:
    """An input line through libgpiod; see `InputLine`.

    Parameters
    ----------
    request : line request granted by libgpiod
    """

    def __init__(self, request: gpiod.LineRequest, place: str) -> None:
        self._request = request
        self._place = place

    @classmethod
    def open(cls, label: str, offset: int, active_low: bool, devices: Path = DEVICES) -> Self:
        """Return the line at an offset of the chip with that label, biased to its inactive level, reporting both edges.

        Raises
        ------
        DriverMissing, ButtonError
            libgpiod is not installed or of version 1; the chip or line does not exist or is in use.
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
        chip = _chip_path(label, place, ButtonError, devices)
        try:
            request = gpiod.request_lines(
                chip, consumer=CONSUMER, config={offset: settings}, event_buffer_size=EVENT_BUFFER
            )
        except (OSError, ValueError) as error:
            raise ButtonError(
                f"{place} cannot be requested ({error}): check button.line and its other users"
            ) from error
        return cls(request, place)

    def wait(self, timeout_s: float | None) -> bool:
        """Return True when edges can be read."""
        try:
            return self._request.wait_edge_events(timeout_s)
        except OSError as error:
            raise self._unreadable(error) from error

    def edges(self) -> list[Edge]:
        """Return edges since the last call."""
        from gpiod import EdgeEvent

        try:
            events = self._request.read_edge_events()
        except OSError as error:
            raise self._unreadable(error) from error
        return [Edge(event.timestamp_ns, event.event_type is EdgeEvent.Type.RISING_EDGE) for event in events]

    def is_active(self) -> bool:
        """Return the level now."""
        from gpiod.line import Value

        try:
            return self._request.get_value(self._request.offsets[0]) is Value.ACTIVE
        except OSError as error:
            raise self._unreadable(error) from error

    def release(self) -> None:
        """Release the line."""
        self._request.release()

    def _unreadable(self, error: OSError) -> ButtonError:
        return ButtonError(f"{self._place} cannot be read ({error.strerror}): check its wiring")


@dataclass(frozen=True, slots=True)
class OutputRole:
    """Purpose of an output line: its name and profile key in errors, the error's type, and its active level."""

    what: str
    key: str
    failure: type[HalError]
    active_low: bool = False


INDICATOR: Final = OutputRole("the indicator", "indicator.line", IndicatorError)
ENABLE_HIGH: Final = OutputRole("the light driver's enable", "light_driver.enable_line", LightError)
ENABLE_LOW: Final = OutputRole("the light driver's enable", "light_driver.enable_line", LightError, active_low=True)


class GpiodOutput:
    """An output line through libgpiod, inactive at first; once released it follows its pull or keeps its level."""

    def __init__(self, label: str, offset: int, devices: Path = DEVICES, role: OutputRole = INDICATOR) -> None:
        self._devices = devices
        self._role = role
        self._label = label
        self._offset = offset
        self._request: gpiod.LineRequest | None = None

    def switch(self, on: bool) -> None:
        """Drive the line; the first call requests it.

        Raises
        ------
        DriverMissing, and the role's error
            libgpiod is not installed or of version 1; the chip or line does not exist or is in use.
        """
        gpiod = load_gpiod()
        from gpiod.line import Direction, Value

        role = self._role
        place = f"{role.what} on line {self._offset} of GPIO chip {self._label!r}"
        try:
            if self._request is None:
                settings = gpiod.LineSettings(
                    direction=Direction.OUTPUT, output_value=Value.INACTIVE, active_low=role.active_low
                )
                chip = _chip_path(self._label, place, role.failure, self._devices)
                self._request = gpiod.request_lines(chip, consumer=CONSUMER, config={self._offset: settings})
            self._request.set_value(self._offset, Value.ACTIVE if on else Value.INACTIVE)
        except (OSError, ValueError) as error:
            if isinstance(error, HalError):
                raise
            raise role.failure(f"{place} cannot be driven ({error}): check {role.key}") from error

    def release(self) -> None:
        """Release the line."""
        if self._request is not None:
            self._request.release()
            self._request = None


def load_gpiod() -> ModuleType:
    """Python module of libgpiod, version 2.

    Raises
    ------
    DriverMissing
        It is not installed, cannot be imported, or is of version 1, which has another interface.
    """
    require_package("gpiod", _INSTALL)
    try:
        import gpiod
    except (ImportError, OSError) as error:
        raise DriverMissing(f"the package gpiod is installed but cannot be imported ({error}): {_INSTALL}") from error
    if not hasattr(gpiod, "request_lines"):
        read_version = getattr(gpiod, "version_string", None)
        found = read_version() if callable(read_version) else "1"
        raise DriverMissing(f"the package gpiod is version {found}, but version 2 is needed: {_INSTALL}")
    module: ModuleType = gpiod
    return module


def _chip_path(label: str, place: str, failure: type[HalError], devices: Path) -> str:
    """Return the device file of the GPIO chip with that label."""
    import gpiod

    found = []
    for path in sorted(devices.glob("gpiochip*")):
        try:
            with gpiod.Chip(str(path)) as chip:
                found.append(chip.get_info().label)
        except OSError:
            found.append(f"{path.name} (cannot be opened)")
            continue
        if found[-1] == label:
            return str(path)
    there = ", ".join(found) or "none"
    raise failure(f"{place} not found: the chips of this machine are {there}; check button.chip_label")


_SHORT: Final = (0.06, 0.06)
_LONG: Final = (0.5, 0.1)

RHYTHMS: Final[dict[Cue, tuple[tuple[float, float], ...]]] = {
    "idle": (),
    "busy": (),
    "may lift": (_SHORT,),
    "good": (_SHORT, _SHORT),
    "doubtful": (_SHORT, _SHORT, _SHORT),
    "retake": (_LONG,),
    "refused": (_LONG, _SHORT, _SHORT),
    "refused: calibration": (_LONG, _SHORT, _SHORT, _SHORT),
    "refused: full": (_SHORT, _LONG),
    "refused: hardware": (_SHORT, _SHORT, _LONG),
    "pairing": (_SHORT, _LONG, _SHORT),
    "calibration": (_LONG, _SHORT),
}
"""On and off times, in seconds, of each cue."""


class BlinkIndicator:
    """See `hal.interfaces.Indicator`.

    Parameters
    ----------
    switch : turns it on or off
    release : releases it
    """

    def __init__(self, switch: Callable[[bool], None], release: Callable[[], None], clock: Clock) -> None:
        self._switch = switch
        self._release = release
        self._clock = clock

    def show(self, cue: Cue) -> None:
        """Play a cue; it stays on while busy, else goes off."""
        for on_s, off_s in RHYTHMS[cue]:
            self._switch(True)
            self._clock.sleep(on_s)
            self._switch(False)
            self._clock.sleep(off_s)
        self._switch(cue == "busy")

    def __enter__(self) -> Self:
        self._switch(False)
        return self

    def __exit__(self, *exc: object) -> None:
        try:
            self._switch(False)
        finally:
            self._release()


class NoIndicator:
    """The indicator of a board that has none: cues appear on the screen only."""

    def show(self, cue: Cue) -> None:
        """No-op."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        return None
