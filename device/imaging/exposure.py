"""Brightness of a frame: levels of each colour's own pixels, as fractions of full scale above black."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import SATURATED
from hal.frame import RawFrame

BRIGHTEST_PERCENTILE: Final = 99.9
"""Percentile taken as the brightest level; the remaining thousandth of the pixels are glints."""

HIGHEST_LEVEL: Final = 0.90
"""Maximum level of a ball press in every channel; above it steep slopes saturate."""

LIVE_STEP: Final = 4
"""Levels of live frames need no more than a sixteenth of the pixels."""

Levels = tuple[float, float, float]
_COLOURS: Final = ("red", "green", "blue")


def channel_levels(frame: RawFrame, percentile: float) -> Levels:
    """Return a percentile of the R, G and B pixels, each as a fraction of full scale above black."""
    scale = 1.0 / (frame.white_level_dn - frame.black_level_dn)
    found = []
    for colour in "RGB":
        counts = _sites(frame, colour)
        found.append((float(np.percentile(counts, percentile)) - frame.black_level_dn) * scale)
    red, green, blue = found
    return red, green, blue


def _sites(frame: RawFrame, colour: str) -> NDArray[np.uint16]:
    """Return the counts of all pixels of a colour: uint16 array of shape (n,)."""
    sites = [i for i, letter in enumerate(frame.bayer_order) if letter == colour]
    return np.concatenate([frame.mosaic[i // 2 :: 2, i % 2 :: 2].ravel() for i in sites])


@dataclass(frozen=True, slots=True)
class SkinLevels:
    """Light of one frame: fractions of full scale above black, R, G, B.

    median : of all pixels of the colour
    clipped : fraction of them that are saturated
    """

    median: Levels
    clipped: Levels

    @classmethod
    def of_frame(cls, frame: RawFrame) -> Self:
        """Return the levels of every `LIVE_STEP`-th cell of the mosaic, row and column: for every live frame."""
        few = replace(frame, mosaic=_every_cell(frame.mosaic, LIVE_STEP))
        limit = frame.black_level_dn + SATURATED * (frame.white_level_dn - frame.black_level_dn)
        full = replace(few, mosaic=(few.mosaic >= limit).astype(np.uint16))
        red, green, blue = (float(np.mean(_sites(full, colour))) for colour in "RGB")
        return cls(channel_levels(few, 50.0), (red, green, blue))


def _every_cell(mosaic: NDArray[np.uint16], step: int) -> NDArray[np.uint16]:
    """Return every `step`-th 2x2 cell of a mosaic in both directions: uint16 array of shape (h, w)."""
    rows, columns = (size // 2 // step * step for size in mosaic.shape)
    cells = mosaic[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2)[::step, :, ::step]
    return np.ascontiguousarray(cells).reshape(2 * (rows // step), 2 * (columns // step))


@dataclass(frozen=True, slots=True)
class Brightness:
    """Part of the sensor's range that a calibration uses: fractions of full scale above black, R, G, B.

    flat : median of untouched skin
    brightest : 99.9th percentile of the brightest ball press
    """

    flat: Levels
    brightest: Levels

    @classmethod
    def of_frames(cls, reference: RawFrame, presses: Sequence[RawFrame]) -> Self:
        """Return the brightness of a reference and its presses."""
        red, green, blue = (
            max(values)
            for values in zip(*(channel_levels(frame, BRIGHTEST_PERCENTILE) for frame in presses), strict=True)
        )
        return cls(channel_levels(reference, 50.0), (red, green, blue))

    @classmethod
    def of_figures(cls, figures: Mapping[str, float | None]) -> Self | None:
        """Return the brightness from a calibration's figures; None when they lack it."""
        values = [figures.get(f"{what}_level_{colour}") for what in ("flat", "brightest") for colour in _COLOURS]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        return cls((known[0], known[1], known[2]), (known[3], known[4], known[5]))

    def figures(self) -> dict[str, float | None]:
        """Return the figures for a calibration's record."""
        return {
            f"{what}_level_{colour}": level
            for what, levels in (("flat", self.flat), ("brightest", self.brightest))
            for colour, level in zip(_COLOURS, levels, strict=True)
        }

    @property
    def sentence(self) -> str:
        """Both levels in a sentence."""
        return f"flat skin at {_percentages(self.flat)}, brightest {_percentages(self.brightest)} of full scale"

    @property
    def warning(self) -> str:
        """Warning when ball presses are too bright, otherwise empty."""
        if max(self.brightest) <= HIGHEST_LEVEL:
            return ""
        return (
            f"the brightest reach {_percentages(self.brightest)} of full scale, over {HIGHEST_LEVEL:.0%}: "
            "run `retroscan calibrate --auto-exposure`"
        )


def _percentages(levels: Levels) -> str:
    return ", ".join(f"{letter} {level:.0%}" for letter, level in zip("RGB", levels, strict=True))
