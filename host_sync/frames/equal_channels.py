"""Two channels of a press that hold the same picture, as a file that is named twice or a copied channel makes them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from host_sync.errors import FrameSetError

COARSE_PX: Final = 100
"""Length of a frame's shorter side in which channels are compared: averages of blocks show little of JPEG's losses."""

SAME: Final = 0.05
"""Channels that differ nowhere by more than this fraction of their light are one: a ball shades lights differently."""


def check_channels(press: NDArray[Any], name: str, images: Sequence[Path] = ()) -> None:
    """Refuse a press, array of shape (H, W, N), of which two channels are equal and a third is not.

    images : of its channels where each has its own

    Raises
    ------
    FrameSetError
        Names the channels.
    """
    size = [max(1, round(length * COARSE_PX / min(press.shape[:2]))) for length in press.shape[1::-1]]
    planes = [
        cv2.resize(np.asarray(press[..., channel], np.float32), size, interpolation=cv2.INTER_AREA)
        for channel in range(press.shape[2])
    ]
    pairs = list(combinations(range(len(planes)), 2))
    equal = [pair for pair in pairs if _are_equal(planes[pair[0]], planes[pair[1]])]
    if not equal or len(equal) == len(pairs):  # of a grey image, the search for balls says so
        return
    first, second = equal[0]
    if images:
        raise FrameSetError(
            f"{name}: {images[first].name} and {images[second].name} show the same: name the image of each light"
        )
    letters = "RGB" if len(planes) == len("RGB") else [str(number) for number in range(1, len(planes) + 1)]
    raise FrameSetError(
        f"{name}: its channels {letters[first]} and {letters[second]} are equal, and two lights do not show two "
        "slopes: save it as the camera gave it, each channel under a light of its own"
    )


def _are_equal(first: NDArray[Any], second: NDArray[Any]) -> bool:
    light = float(np.percentile(first, 99.0))
    return float(np.ptp(first)) > 3.0 * SAME * light and float(np.abs(first - second).max()) <= SAME * light
