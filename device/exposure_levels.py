"""How bright a frame is: levels of each colour's own pixels as shares of full scale above black."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from hal.frame import RawFrame

BRIGHTEST_PERCENTILE: Final = 99.9
"""The level under which all but a thousandth of the pixels lie: the rest are glints."""

HIGHEST_LEVEL: Final = 0.90
"""A ball press must stay under this level in every channel, or steep slopes saturate."""

Levels = tuple[float, float, float]
_COLOURS: Final = ("red", "green", "blue")


def channel_levels(frame: RawFrame, percentile: float) -> Levels:
    """That percentile of the R, G and B pixels, each a share of full scale above black."""
    scale = 1.0 / (frame.white_level_dn - frame.black_level_dn)
    found = []
    for colour in "RGB":
        sites = [i for i, letter in enumerate(frame.bayer_order) if letter == colour]
        counts = np.concatenate([frame.mosaic[i // 2 :: 2, i % 2 :: 2].ravel() for i in sites])
        found.append((float(np.percentile(counts, percentile)) - frame.black_level_dn) * scale)
    red, green, blue = found
    return red, green, blue


@dataclass(frozen=True, slots=True)
class Brightness:
    """How much of the sensor's range a calibration uses: shares of full scale above black, R, G, B.

    flat : median of the skin at rest
    brightest : what all but a thousandth of the pixels of every ball press stay under
    """

    flat: Levels
    brightest: Levels

    @classmethod
    def of_frames(cls, reference: RawFrame, presses: Sequence[RawFrame]) -> Self:
        """That of a reference and the presses after it."""
        red, green, blue = (
            max(values)
            for values in zip(*(channel_levels(frame, BRIGHTEST_PERCENTILE) for frame in presses), strict=True)
        )
        return cls(channel_levels(reference, 50.0), (red, green, blue))

    @classmethod
    def of_figures(cls, figures: Mapping[str, float | None]) -> Self | None:
        """What a calibration's figures say; None where they say nothing."""
        values = [figures.get(f"{what}_level_{colour}") for what in ("flat", "brightest") for colour in _COLOURS]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        return cls((known[0], known[1], known[2]), (known[3], known[4], known[5]))

    def figures(self) -> dict[str, float | None]:
        """The same for a calibration's record."""
        return {
            f"{what}_level_{colour}": level
            for what, levels in (("flat", self.flat), ("brightest", self.brightest))
            for colour, level in zip(_COLOURS, levels, strict=True)
        }

    @property
    def sentence(self) -> str:
        """Both in words."""
        return f"flat skin at {_shares(self.flat)}, brightest {_shares(self.brightest)} of full scale"

    @property
    def warning(self) -> str:
        """What to tell somebody whose ball presses are too bright, or an empty text."""
        if max(self.brightest) <= HIGHEST_LEVEL:
            return ""
        return (
            f"the brightest reach {_shares(self.brightest)} of full scale, over {HIGHEST_LEVEL:.0%}: "
            "run `retroscan calibrate --balance`"
        )


def _shares(levels: Levels) -> str:
    return ", ".join(f"{letter} {level:.0%}" for letter, level in zip("RGB", levels, strict=True))
