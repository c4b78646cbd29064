"""The Protocols of the hardware layer, implemented by real drivers and by the twin.

Every device is a context manager: entering acquires it, leaving releases it (lights off) on any exit. Positions are in
millimetres in the skin frame: x along columns, y along rows (downwards), z towards the camera, origin where the optical
axis meets the untouched skin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hal.frame import CameraSettings, RawFrame


class Clock(Protocol):
    """Injected time, so that tests and the twin run in virtual time."""

    def monotonic_ns(self) -> int:
        """Return monotonic time, ns; the time base of `RawFrame.sensor_timestamp_ns`."""
        ...

    def wall_time_s(self) -> float:
        """Return seconds since 1970 by the system clock: an annotation, never an identity."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Return after `duration_s` seconds of this clock."""
        ...


class Camera(Protocol):
    """A raw camera with all automatics off, whose controls act some frames late.

    A camera that has stalled or disappeared is reopened by the next call; call `apply` for that while lights are off.
    """

    @property
    def camera_id(self) -> str:
        """Identity reported by the driver."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame, in sensor pixels."""
        ...

    def apply(self, settings: CameraSettings) -> None:
        """Request exposure and gain; later frames confirm them in their own metadata."""
        ...

    def next_frame(self, timeout_s: float) -> RawFrame:
        """Return the next frame that the sensor completes, never an earlier one.

        Raises
        ------
        FrameTimeout
            No frame was completed within `timeout_s`.
        CameraError
            The camera disappeared or delivers another format than it granted.
        """
        ...

    def aiming_view(self, timeout_s: float) -> NDArray[np.uint8]:
        """Return the next small grey picture for aiming, uint8 array of shape (h, w); not for measurement.

        Raises
        ------
        FrameTimeout, CameraError
            As for `next_frame`.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@dataclass(frozen=True, slots=True)
class LightFault:
    """Advisory fault flag of one light, as the chip reports it, such as "open" or "short"."""

    light: str
    kind: str


class Lights(Protocol):
    """The three coloured lights, set by current."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        ...

    @property
    def max_ma(self) -> float:
        """Maximum current of a light, mA."""
        ...

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """Return the nearest currents (mA) that the driver can set, which `switch_on` then applies.

        Raises
        ------
        LightError
            An unknown name, or a current out of range.
        """
        ...

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Drive each named light with its current (mA); all others are off.

        Raises
        ------
        LightError
            An unknown name, a current out of range, or a chip that does not answer.
        """
        ...

    def off(self) -> None:
        """Switch every light off."""
        ...

    def faults(self) -> tuple[LightFault, ...]:
        """Advisory fault flags of the lights that are on; empty when the chip reports none.

        Reading them may change the light for a moment: never call it during an exposure of a scan.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@dataclass(frozen=True, slots=True)
class ButtonPress:
    """One debounced press: when it began (clock's monotonic ns) and how long it was held."""

    began_ns: int
    held_s: float


class Button(Protocol):
    """The push button, debounced.

    A button that is down when it is first read counts from its next press.
    """

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """Return the time at which the next press began (ns), while the button is still down; None after `timeout_s`.

        Each press is reported once. `wait_for_press` then waits for the release of the same press, if needed.
        """
        ...

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """Return the next press after its release, or None after `timeout_s` (None waits without limit)."""
        ...

    def is_down(self) -> bool:
        """Return whether the button is down now."""
        ...

    def clear_presses(self) -> int:
        """Drop all presses so far; returns how many of them `wait_for_push` had not reported."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


Refusal = Literal["refused", "refused: calibration", "refused: full", "refused: hardware"]


Cue = Literal["idle", "busy", "may lift", "good", "doubtful", "retake", "pairing", "calibration", Refusal]
"""Patterns of an indicator; plain "refused" means: busy, push again."""


class Indicator(Protocol):
    """A status LED or buzzer: one bit, so every cue is a rhythm, independent of colour."""

    def show(self, cue: Cue) -> None:
        """Play a cue and leave the indicator as the cue ends: on while busy, else off.

        Raises
        ------
        IndicatorError
            It cannot be driven.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@dataclass(frozen=True, slots=True)
class PowerReading:
    """Supply and battery; None means "not measured".

    under_voltage : the supply voltage is too low now
    was_under_voltage : it was too low at some time since boot
    throttled : the processor is slowed down now
    battery_mv, battery_share : cell voltage (mV) and charge (0 to 1)
    complaints : one sentence for each part of the board that did not answer
    """

    under_voltage: bool | None = None
    was_under_voltage: bool | None = None
    throttled: bool | None = None
    battery_mv: float | None = None
    battery_share: float | None = None
    complaints: tuple[str, ...] = ()

    def with_earlier(self, earlier: PowerReading) -> PowerReading:
        """Return this reading combined with the problems of an earlier one."""

        def either(one: bool | None, other: bool | None) -> bool | None:
            return one if other is None else other if one is None else one or other

        return replace(
            self,
            under_voltage=either(self.under_voltage, earlier.under_voltage),
            was_under_voltage=either(self.was_under_voltage, earlier.was_under_voltage),
            throttled=either(self.throttled, earlier.throttled),
            complaints=tuple(dict.fromkeys((*earlier.complaints, *self.complaints))),
        )


class Power(Protocol):
    """Supply and battery."""

    def read(self) -> PowerReading:
        """Read all sensors; one that does not answer gives None and an entry in `complaints`."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@dataclass(frozen=True, slots=True)
class LiftOff:
    """Request: nothing touches the skin."""


@dataclass(frozen=True, slots=True)
class PressBall:
    """Request: press a ball of `radius_mm` at (`column_share`, `row_share`) of the field, 0 to 1."""

    radius_mm: float
    column_share: float
    row_share: float


@dataclass(frozen=True, slots=True)
class PressObject:
    """Request: press an object of the user; the twin knows its specimens by `name`.

    way : (mm right, mm down, degrees clockwise) that the hand moves the instrument first, from where it stood on this
        object; None places it afresh
    pushes : whether the hand pushes the button too
    """

    name: str
    way: tuple[float, float, float] | None = None
    pushes: bool = True


@dataclass(frozen=True, slots=True)
class MayLift:
    """Notice: the frame is in memory, the object may be lifted; no push of the button is wanted."""


@dataclass(frozen=True, slots=True)
class NeverMind:
    """Notice: what was asked for is not wanted any more; no push of the button is wanted."""


FaultName = Literal["dim", "break", "wobble", "dirt", "tilt", "depth", "battery", "stall"]


@dataclass(frozen=True, slots=True)
class SetFault:
    """Request: the twin shows a fault from now on, or no longer; no push of the button follows."""

    name: FaultName
    on: bool


OperatorRequest = LiftOff | PressBall | PressObject | MayLift | NeverMind | SetFault


class Operator(Protocol):
    """The person who holds the instrument, or the twin's operator.

    The twin's operator carries out the request in the simulated world and then pushes the button.
    """

    def ask(self, request: OperatorRequest) -> None:
        """Hand over one request and return at once; the answer is a press of the button, except to a notice.

        Raises
        ------
        OperatorError
            The twin has no such object.
        """
        ...
