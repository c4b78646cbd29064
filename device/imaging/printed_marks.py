"""Dots that are printed on a gel's skin: they darken all lights alike, and move with the skin.

Reference and press show them at different places, so that their ratio is wrong at both. Where the reference shows a
pattern of them, they are taken out of every frame: light under them is interpolated from around them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import DARK_FLOOR, LinearFrame
from device.surface import Float32Array, MaskArray

LARGEST: Final = 0.08
SMALLEST: Final = 0.01
"""Width of the largest and the smallest mark, fractions of the frame's shorter side."""

REDUCED_PX: Final = 3.0
"""Width of the smallest mark in the reduced frame in which a pattern is searched for, pixels."""

DARKER: Final = 0.25
"""A mark lowers the logarithm of every light by so much."""

LIT: Final = 0.02
"""Fraction of full scale of the light around a mark; darker surroundings are no skin."""

MIN_MARKS: Final = 16
ALIKE: Final = 2.5
REGULAR: Final = 1.6
MOST: Final = 0.7
"""A pattern has so many marks, and this fraction of them the same area and distance from the next, up to factors."""

REACH: Final = 2.0
"""Width of what counts as a mark of a known pattern, over the pattern's: shadows next to a ball are wider."""

MARGIN: Final = 0.15
"""Border around a mark that is taken out with it, fraction of its width; at least two pixels."""

DENSEST: Final = 0.12
"""Marks that take more of the skin with their borders leave too little between them to interpolate from."""


@dataclass(frozen=True, slots=True)
class MarkPattern:
    """Printed marks of a skin.

    width_px : width of one
    covered : fraction of the skin under them and their borders
    """

    width_px: float
    covered: float

    @classmethod
    def of(cls, reference: LinearFrame) -> MarkPattern | None:
        """Return the pattern of marks that untouched skin shows; None where it shows none.

        A pattern consists of many marks, of one size, evenly spaced.
        """
        rows, columns = reference.shape
        shorter = min(rows, columns)
        factor = max(1, int(SMALLEST * shorter / REDUCED_PX))
        small = columns // factor, rows // factor
        reduced = np.asarray(cv2.resize(reference.rgb, small, interpolation=cv2.INTER_AREA), np.float32)
        reduced = reduced.reshape(*small[::-1], -1)
        _, area, centres = _marks(reduced, LARGEST * shorter / factor, SMALLEST * shorter / factor)
        if len(area) < MIN_MARKS:
            return None
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
        np.fill_diagonal(apart, np.inf)
        nearest = apart.min(axis=1)
        size, near = np.abs(np.log(area / np.median(area))), np.abs(np.log(nearest / np.median(nearest)))
        if ((size < np.log(ALIKE)) & (near < np.log(REGULAR))).mean() < MOST:
            return None
        pattern = cls(factor * float(np.sqrt(np.median(area))), 0.0)
        covered = float(pattern.hidden(reference).mean())
        return replace(pattern, covered=covered) if covered < DENSEST else None

    @property
    def note(self) -> str:
        """The sentence on what becomes of them."""
        return f"printed marks cover {self.covered:.0%} of the skin: heights under them are interpolated"

    def hidden(self, frame: LinearFrame) -> MaskArray:
        """Return True under the marks of a frame and their borders: bool array of shape (H, W)."""
        under, _, _ = _marks(frame.rgb, REACH * self.width_px, 0.5 * self.width_px)
        border = 2 * max(2, round(MARGIN * self.width_px)) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (border, border))
        return np.asarray(cv2.dilate(under.astype(np.uint8), kernel), np.bool_)

    def taken_out_of(self, frame: LinearFrame) -> LinearFrame:
        """Return the frame with light interpolated under its marks."""
        hidden = self.hidden(frame).astype(np.uint8)
        planes = [
            cv2.inpaint(np.ascontiguousarray(frame.rgb[..., light]), hidden, 3.0, cv2.INPAINT_NS)
            for light in range(frame.rgb.shape[-1])
        ]
        return replace(frame, rgb=np.asarray(np.stack(planes, axis=-1), np.float32))


def _marks(
    rgb: Float32Array, largest_px: float, smallest_px: float
) -> tuple[MaskArray, NDArray[np.int32], NDArray[np.float64]]:
    """Return marks of a frame: bool array (H, W), True under them; their areas (N,), pixels; their centres (N, 2)."""
    reach = max(3, round(largest_px)) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    light = np.log(np.maximum(cv2.blur(rgb, (3, 3)).reshape(rgb.shape), np.float32(DARK_FLOOR)))
    darker = np.min(
        [cv2.morphologyEx(one.copy(), cv2.MORPH_BLACKHAT, kernel) for one in np.moveaxis(light, -1, 0)], axis=0
    )
    around = cv2.morphologyEx(rgb.max(axis=-1), cv2.MORPH_CLOSE, kernel)
    lit = cv2.erode((around > LIT).astype(np.uint8), kernel).astype(np.bool_)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(((darker > DARKER) & lit).astype(np.uint8))
    area, size = stats[:, cv2.CC_STAT_AREA], stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    is_mark = (area >= smallest_px**2) & (size < largest_px)
    is_mark[0] = False
    return np.asarray(is_mark[labels]), area[is_mark], centres[is_mark]
