"""The parts that a real board is built from, as its profile states them: camera stack, light driver, button, power."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Channel = Annotated[int, msgspec.Meta(ge=0, le=15)]
BusNumber = Annotated[int, msgspec.Meta(ge=0, le=99)]
BusAddress = Annotated[int, msgspec.Meta(ge=0x08, le=0x77)]
LineOffset = Annotated[int, msgspec.Meta(ge=0, le=255)]
EvenSize = Annotated[int, msgspec.Meta(ge=16, multiple_of=2)]


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the profile: unknown keys are refused."""


class LibcameraFacts(Table, frozen=True):
    """How libcamera is asked for this sensor.

    camera_id : part of libcamera's name of the camera that exactly one camera's name contains, such as "imx477@1a"
    raw_bits : bits of the unpacked raw format; a Pi 5 hands out 16, shifted up, whatever the sensor has
    sensor_bits : bits of the sensor's own mode
    frame_period_us : the frame duration that is locked
    aiming_columns, aiming_rows : size of the small stream for aiming
    buffer_count : frames in flight; one drops every second frame, more need more of the kernel's contiguous memory
    lens_position : dioptres, for a module with a motorised lens
    """

    camera_id: Annotated[str, msgspec.Meta(min_length=3)]
    raw_bits: Literal[8, 10, 12, 14, 16]
    sensor_bits: Literal[8, 10, 12, 14, 16]
    frame_period_us: Positive
    aiming_columns: EvenSize = 320
    aiming_rows: EvenSize = 240
    buffer_count: Annotated[int, msgspec.Meta(ge=2, le=8)] = 2
    lens_position: NotNegative | None = None


class LightDriverFacts(Table, frozen=True):
    """The chip that drives the lights, where it sits, and the resistor (ohm) that sets its currents."""

    chip: Literal["PCA9955B", "TLC59116"]
    bus: BusNumber
    address: BusAddress
    reference_ohm: Positive


class ButtonFacts(Table, frozen=True):
    """The button's line: the GPIO chip by its label, since its number differs between kernels, and the offset on it."""

    chip_label: str
    line: LineOffset
    active_low: bool = True


class IndicatorFacts(Table, frozen=True):
    """The status LED or buzzer: either a GPIO line of the button's chip, or a spare channel of the light driver."""

    line: LineOffset | None = None
    channel: Channel | None = None
    current_ma: Positive = 2.0


class FuelGaugeFacts(Table, frozen=True):
    """A battery gauge on the I²C bus."""

    chip: Literal["MAX17048"]
    bus: BusNumber
    address: BusAddress = 0x36


class PowerFacts(Table, frozen=True):
    """Where under-voltage is read, and the battery's gauge when there is one."""

    throttled: Literal["sysfs", "vcgencmd"] = "sysfs"
    fuel_gauge: FuelGaugeFacts | None = None
