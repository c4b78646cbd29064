"""Values and tables that board profiles are made of."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

ASPECT_TOLERANCE: Final = 0.02
"""Relative tolerance of the aspect ratio; libcamera crops an aiming view that differs more from the sensor."""

LIVE_AIMING_US: Final = 80_000.0
"""Maximum frame period for ten aiming views per second with time to spare."""

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Channel = Annotated[int, msgspec.Meta(ge=0, le=15)]
BusNumber = Annotated[int, msgspec.Meta(ge=0, le=99)]
BusAddress = Annotated[int, msgspec.Meta(ge=0x08, le=0x77)]
LineOffset = Annotated[int, msgspec.Meta(ge=0, le=255)]
EvenSize = Annotated[int, msgspec.Meta(ge=16, multiple_of=2)]
Fraction = Annotated[float, msgspec.Meta(ge=0, le=1)]
Exposure = Annotated[float, msgspec.Meta(gt=0, le=1e7)]
Gain = Annotated[float, msgspec.Meta(ge=1, le=64)]
Triple = tuple[float, float, float]


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the profile; unknown keys are refused."""
