"""Values and tables that board profiles are made of."""

from __future__ import annotations

from typing import Annotated

import msgspec

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
