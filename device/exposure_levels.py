"""How bright a frame is: levels of each colour's own pixels as shares of full scale above black."""

from __future__ import annotations

from typing import Final

import numpy as np

from hal.frame import RawFrame

BRIGHTEST_PERCENTILE: Final = 99.9
"""The level under which all but a thousandth of the pixels lie: the rest are glints."""

HIGHEST_LEVEL: Final = 0.90
"""A ball press must stay under this level in every channel, or steep slopes saturate."""

Levels = tuple[float, float, float]


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


def brightest(levels: list[Levels]) -> Levels:
    """The highest level of each channel."""
    red, green, blue = (max(values) for values in zip(*levels, strict=True))
    return red, green, blue
