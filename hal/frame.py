"""The raw frame: one exposure of a Bayer sensor, with metadata that confirms how it was taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

BayerOrder = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
AS_GRANTED: Final = "as granted"
StatedOrder = Literal["RGGB", "BGGR", "GRBG", "GBRG", "as granted"]
"""What a board profile says of its sensor: an order, or that the order which libcamera grants is taken."""
BAYER_ORDERS: Final[tuple[BayerOrder, ...]] = ("RGGB", "BGGR", "GRBG", "GBRG")

RELATIVE_TOLERANCE: Final = 0.02
"""Relative tolerance between requested and granted exposure and gain, which the sensor quantizes."""

WHOLE_US: Final = 1.0
"""Exposures are granted in the whole µs that libcamera reports."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Settings requested from the camera, or granted according to a frame's metadata."""

    exposure_us: float
    analogue_gain: float

    def is_granted(self, granted: CameraSettings, step_us: float) -> bool:
        """Return whether a frame's settings are these requested ones, which sensors quantize.

        step_us : exposures come in steps of so many µs
        """
        near_us = max(RELATIVE_TOLERANCE * self.exposure_us, step_us + WHOLE_US)
        return (
            abs(granted.exposure_us - self.exposure_us) <= near_us
            and abs(granted.analogue_gain - self.analogue_gain) <= RELATIVE_TOLERANCE * self.analogue_gain
        )


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One raw exposure.

    mosaic : uint16 array of shape (H, W), sensor counts (dn); H and W are even
    bayer_order : colours of the top left 2x2 pixels, in reading order
    black_level_dn : counts of a pixel without light
    white_level_dn : counts at which a pixel is saturated
    granted : exposure and gain from this frame's own metadata
    sensor_timestamp_ns : monotonic time at which the exposure of the first row began, ns
    """

    mosaic: NDArray[np.uint16]
    bayer_order: BayerOrder
    black_level_dn: float
    white_level_dn: float
    granted: CameraSettings
    sensor_timestamp_ns: int

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) in sensor pixels."""
        rows, columns = self.mosaic.shape
        return rows, columns
