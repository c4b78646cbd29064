"""The Protocols of the hardware layer, on one page. Real drivers and the twin satisfy the same ones.

Every device is a context manager: entering acquires it, leaving releases it (lights dark) on any exit.
Positions are in millimetres in the skin's frame: x along columns, y along rows (downwards), z towards the
camera, origin where the optical axis meets the resting skin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hal.frame import CameraSettings, RawFrame
from hal.power_reading import PowerReading as PowerReading


class Clock(Protocol):
    """Time, injected, so that tests and the twin run in virtual time."""

    def monotonic_ns(self) -> int:
        """Nanoseconds that never run backwards; the time base of `RawFrame.sensor_timestamp_ns`."""
        ...

    def wall_time_s(self) -> float:
        """Seconds since 1970 as the machine believes them: an annotation, never an identity."""
        ...

    def sleep(self, duration_s: float) -> None:
        """Return after `duration_s` seconds of this clock."""
        ...


class Camera(Protocol):
    """A locked-down raw camera: nothing automatic, controls that act some frames late.

    One that has stalled or gone is opened anew by the next call; `apply` is the one to make while it is dark.
    """

    @property
    def camera_id(self) -> str:
        """The identity that the driver reports, so that a frame is never taken for another camera's."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame, in sensor pixels."""
        ...

    def apply(self, settings: CameraSettings) -> None:
        """Ask for exposure and gain; frames show them some frames later, in their own metadata."""
        ...

    def next_frame(self, timeout_s: float) -> RawFrame:
        """The next frame that the sensor completes, never an earlier one.

        Raises
        ------
        FrameTimeout
            No frame was completed within `timeout_s`.
        CameraError
            The camera is gone or delivers another format than was granted.
        """
        ...

    def aiming_view(self, timeout_s: float) -> NDArray[np.uint8]:
        """The next small grey picture for aiming, uint8 array of shape (h, w): for the eye, no measure of light.

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
    """An advisory fault flag of one light: what the chip believes, such as "open" or "short"."""

    light: str
    kind: str


class Lights(Protocol):
    """The three coloured lights, set by current."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights in R, G, B order."""
        ...

    @property
    def highest_ma(self) -> float:
        """The most that a light can be driven with, mA."""
        ...

    def granted_ma(self, currents_ma: Mapping[str, float]) -> dict[str, float]:
        """What the driver makes of these currents (mA): its nearest steps, which `switch_on` then really drives.

        Raises
        ------
        LightError
            An unknown name, or a current out of range.
        """
        ...

    def switch_on(self, currents_ma: Mapping[str, float]) -> None:
        """Drive each named light with its current (mA); lights that are not named go dark.

        Raises
        ------
        LightError
            An unknown name, a current out of range, or a chip that does not answer.
        """
        ...

    def dark(self) -> None:
        """Every light off."""
        ...

    def faults(self) -> tuple[LightFault, ...]:
        """Advisory fault flags of what shines; empty when the chip reports none.

        Looking may change the light for a moment: never during an exposure that counts.
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
    """The push button, already debounced.

    A button that is down when it is first looked at counts from its next press.
    """

    def wait_for_push(self, timeout_s: float | None) -> int | None:
        """When the next press began (ns), told while the button is still down; None after `timeout_s`.

        Each press is told once. `wait_for_press` then waits for the same press's end, if anybody wants to know it.
        """
        ...

    def wait_for_press(self, timeout_s: float | None) -> ButtonPress | None:
        """The next press once it is over, or None when `timeout_s` went by without one (None waits for ever)."""
        ...

    def is_down(self) -> bool:
        """Whether the button is down now."""
        ...

    def forget_presses(self) -> int:
        """Drop every press so far, and say how many of them `wait_for_push` had not told."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


Refusal = Literal["refused", "refused: calibration", "refused: full", "refused: hardware"]
Cue = Literal["idle", "busy", "may lift", "good", "doubtful", "retake", "pairing", "calibration", Refusal]
"""What an indicator can say; "refused" alone is: busy, push again."""


class Indicator(Protocol):
    """A status LED or buzzer: one bit, so that every cue is a rhythm and colour carries nothing."""

    def show(self, cue: Cue) -> None:
        """Play a cue and leave the light as the cue ends: on while busy, else off.

        Raises
        ------
        IndicatorError
            It cannot be driven.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


class Power(Protocol):
    """Supply and battery."""

    def read(self) -> PowerReading:
        """What is measured now; a part that does not answer costs its own figures and leaves a complaint."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...


@dataclass(frozen=True, slots=True)
class LiftOff:
    """Request: nothing touches the skin."""


@dataclass(frozen=True, slots=True)
class PressBall:
    """Request: press a ball of `radius_mm` where the field is crossed at (`column_share`, `row_share`), 0 to 1."""

    radius_mm: float
    column_share: float
    row_share: float


@dataclass(frozen=True, slots=True)
class PressObject:
    """Request: press an object of the user's choice; the twin knows its gallery by `name`."""

    name: str


OperatorRequest = LiftOff | PressBall | PressObject


class Operator(Protocol):
    """Whoever holds the instrument. A person needs only the words on the screen; the twin's operator
    carries the request out in the simulated world and then pushes its button."""

    def ask(self, request: OperatorRequest) -> None:
        """Hand over one request and return at once; the answer is a press of the button.

        Raises
        ------
        OperatorError
            The twin has no such object.
        """
        ...
