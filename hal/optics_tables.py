"""Tables of a board profile that describe its optics: the lens as it is set, and the beam of its lights."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from hal.profile_values import NotNegative, Positive, Table

GEL_INDEX: Final = 1.41
"""Refractive index of silicone; acrylic's is 1.49."""


class LensConfig(Table, frozen=True):
    """The lens, and what its blur follows from.

    focal_mm : focal length
    f_number : as engraved, for far objects
    pixel_um : side of a pixel on the sensor; of a binned one, of all that it sums
    focus_mm : height of the plane in focus above the untouched skin
    """

    focal_mm: Positive
    f_number: Annotated[float, msgspec.Meta(ge=0.7, le=64)]
    pixel_um: Positive
    focus_mm: Annotated[float, msgspec.Meta(ge=-20, le=20)] = 0.0

    def pupil_height_mm(self, pitch_um: float) -> float:
        """Height of the entrance pupil over the untouched skin, whose pixels are `pitch_um` apart, as rays inside the
        gel see it: the block's flat face bends them, so that it seems farther by the refractive index.
        """
        return GEL_INDEX * self.focal_mm * (1.0 + pitch_um / self.pixel_um)


class BeamConfig(Table, frozen=True):
    """The beam of every light: its LEDs and what stands before them.

    led_angle_deg : between the directions of half brightness of an LED
    led_offsets_mm : of each LED from the light's position, level and square to its axis
    facet : whether the light enters a clear block through a facet square to its axis; otherwise the LEDs stand free
    behind_mm : from the facet back to the LEDs' fronts
    bore_mm : diameter of the opening before an LED
    aim_past_mm : how far beyond the skin's centre the LEDs aim, along the skin
    """

    led_angle_deg: Annotated[float, msgspec.Meta(ge=5, le=150)]
    led_offsets_mm: tuple[float, ...] = (0.0,)
    facet: bool = True
    behind_mm: NotNegative = 0.0
    bore_mm: Positive = 5.0
    aim_past_mm: NotNegative = 0.0
