"""Channels of a camera's frames: the full scale of their counts, and two that hold the same picture.

Cameras of 10, 12 and 14 bit write their counts into 16 bit as they are, or shifted. The frames of one set show which:
together they hold no count above the full scale, and where light is clipped, many pixels hold the same highest count.
Channels are equal where a file is named twice or a channel was copied.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from hal.frame import RawFrame
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set_file import Encoding
from host_sync.frames.image_info import Pixels

COUNTS: Final = 1 << 16
LEAST_BITS: Final = 9
"""Frames that hold smaller counts alone are dark ones of 16 bit."""

AMBIGUOUS_BITS: Final = 14
"""Up to so many bits, frames in sRGB may as well be dim ones of 16 bit."""

CLIPPED_PIXELS: Final = 64
NEAR_TOP: Final = 0.9
"""Counts from this share of the highest one on are compared with it."""

SPIKE: Final = 16.0
"""Times as many pixels as at other counts near it hold the highest count where light is clipped."""

SPIKE_COUNTS: Final = 8
"""So many other counts must be there: an image of few values shows no spike."""


FAR: Final = 1.5
FEW: Final = 0.01
"""A stated full scale is wrong where light is clipped, or more than a few counts lie, so many times away from it."""


def count_values(images: Iterable[Pixels | RawFrame]) -> NDArray[np.int64]:
    """Return how many samples of all images of 16 bit hold each count: int64 array of 65536 entries."""
    total = np.zeros(COUNTS, np.int64)
    for image in images:
        if not isinstance(image, RawFrame) and image.dtype == np.uint16:
            total += np.bincount(image.ravel(), minlength=COUNTS)
    return total


def full_scale_of(
    histogram: NDArray[np.int64], stated: int | None, encoding: Encoding, given: int | None = None
) -> int:
    """Return the full scale of frames of 16 bit.

    histogram : of the counts of all frames that share it
    stated : what a file's header says; header fields for the highest sample are used in several senses, so that one
        that is no limit of a number of bits, or that counts exceed, is passed over
    given : what the user gives, which is returned

    Raises
    ------
    FrameSetError
        It changes what the frames show and is not certain; or counts contradict the given one.
    """
    held = np.flatnonzero(histogram)
    peak = int(held[-1]) if held.size else 0
    bits = peak.bit_length()
    level = clip_level(held, histogram[held])
    if given is not None:
        _check_given(histogram, level, given)
        return given
    if level is not None:
        return int(level)
    if stated is not None and peak <= stated < COUNTS - 1 and _is_limit(stated):
        return stated
    if not LEAST_BITS <= bits < 16:
        return COUNTS - 1
    full_scale = (1 << bits) - 1
    if encoding == "srgb" and histogram[full_scale] < CLIPPED_PIXELS:
        if bits > AMBIGUOUS_BITS:
            return COUNTS - 1
        raise FrameSetError(
            f"no frame of 16 bit holds a count above {peak}: state full_scale, {full_scale} for a camera of {bits} bit "
            f"or {COUNTS - 1} for dim frames; sRGB values depend on it"
        )
    return full_scale


def _check_given(histogram: NDArray[np.int64], level: float | None, given: int) -> None:
    """Refuse a full scale far above the count at which light is clipped, or far below many counts."""
    if level is not None and level < given / FAR:
        raise FrameSetError(f"full_scale: {given} is stated, and light is clipped at {level:.0f}: correct it")
    above = int(histogram[int(FAR * given) :].sum())
    if above > CLIPPED_PIXELS and above > FEW * histogram.sum():
        peak = np.flatnonzero(histogram)[-1]
        raise FrameSetError(f"full_scale: {given} is stated, and counts reach {peak}: correct it")


def clip_level(values: NDArray[Any], counts: NDArray[np.int64]) -> float | None:
    """Return the highest value where it stands out from those below, as light that is clipped makes it; None where not.

    values : those that occur, in ascending order
    counts : how often each does
    """
    if not values.size or counts[-1] < CLIPPED_PIXELS:
        return None
    below = counts[(values >= NEAR_TOP * values[-1]) & (values < values[-1])]
    if below.size < SPIKE_COUNTS or counts[-1] < SPIKE * below.mean():
        return None
    return float(values[-1])


def _is_limit(count: int) -> bool:
    """Return whether a count is the largest of a number of bits, shifted or not."""
    return count > 0 and (count // (count & -count) + 1).bit_count() == 1 and count.bit_length() >= LEAST_BITS


COARSE_PX: Final = 100
"""Length of a frame's shorter side in which channels are compared: averages of blocks show little of JPEG's losses."""

EQUAL_WITHIN: Final = 0.05
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
    return (
        float(np.ptp(first)) > 3.0 * EQUAL_WITHIN * light
        and float(np.abs(first - second).max()) <= EQUAL_WITHIN * light
    )
