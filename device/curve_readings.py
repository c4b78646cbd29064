"""What curves of the inverse map read that is not intensity alone, each with its curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.light_field import LightField
from device.near_field import NearField
from device.slope_curve import SlopeCurve

Reading = LightField | NearField
"""Makes of intensity and place the colours that a curve is a function of."""


@dataclass(frozen=True, slots=True, eq=False)
class LightCurve:
    """A curve that reads light, and its part in the map.

    field : light of untouched skin
    curve : what reads it; its colours are light relative to the field's mean
    share : its weight, 0 to 1; the map's other curve has the rest
    """

    field: LightField
    curve: SlopeCurve
    share: float

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays; `from_arrays` is its inverse."""
        return self.curve.arrays() | self.field.arrays() | {"share": np.array(self.share)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> LightCurve | None:
        """What `arrays` wrote, None where there are none; KeyError, ValueError or RecordError when it is none."""
        if not arrays:
            return None
        share = float(arrays["share"])
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a share of {share}")
        return cls(LightField.from_arrays(arrays), SlopeCurve.from_arrays(arrays, source, linear=True), share)


@dataclass(frozen=True, slots=True, eq=False)
class NearCurve:
    """A curve that reads the slopes of a matt skin under near lights.

    field : where the lights stand
    curve : what reads them; its colours are p, q and brightness
    """

    field: NearField
    curve: SlopeCurve

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays; `from_arrays` is its inverse."""
        return self.curve.arrays() | self.field.arrays()

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> NearCurve | None:
        """What `arrays` wrote, None where there are none; KeyError, ValueError or RecordError when it is none."""
        if not arrays:
            return None
        return cls(NearField.from_arrays(arrays), SlopeCurve.from_arrays(arrays, source, linear=True))
