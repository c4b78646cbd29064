"""The mean of frames of one press that did not move.

A pixel's noise falls with the root of the number of frames. The sum keeps fractions of a count: its counts, black and
white level are multiples of a single frame's. A pixel that is saturated in any frame stays so.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.guidance.downsample import downsample_step
from device.guidance.guide import box_smoothed
from device.imaging.flat_field import SATURATED, bin_bayer
from device.surface.fields import Float32Array
from hal.frame import RawFrame

MAX_CHANGE: Final = 0.008
"""Change of smoothed light, 99th percentile relative to the brightest, from which a frame has moved: an edge that is
shifted by a pixel. Still frames of the twin change by 0.003 to 0.007."""

MAX_FRAMES: Final = 1000

_MAX_COUNT: Final = np.iinfo(np.uint16).max


class FrameMean:
    """The mean of raw frames of equal settings, without rounding to whole counts.

    frames : summed so far, at most `MAX_FRAMES`
    """

    def __init__(self, first: RawFrame) -> None:
        self._first = first
        self._sum: NDArray[np.uint32] = first.mosaic.astype(np.uint32)
        self._brightest = first.mosaic.copy()
        self.frames = 1

    def add(self, frame: RawFrame) -> None:
        """Add a frame."""
        self._sum += frame.mosaic
        np.maximum(self._brightest, frame.mosaic, out=self._brightest)
        self.frames += 1

    def frame(self) -> RawFrame:
        """The mean; with one frame that frame itself."""
        first = self._first
        if self.frames == 1:
            return first
        scale = max(int(_MAX_COUNT // first.white_level_dn), 1)
        limit = first.black_level_dn + SATURATED * (first.white_level_dn - first.black_level_dn)
        mosaic = np.empty_like(first.mosaic)
        for row, (total, brightest) in enumerate(zip(self._sum, self._brightest, strict=True)):
            mean = (total * np.uint32(scale) + np.uint32(self.frames // 2)) // np.uint32(self.frames)
            saturated = brightest.astype(np.uint32) * np.uint32(scale)
            mosaic[row] = np.minimum(np.where(brightest >= limit, saturated, mean), _MAX_COUNT)
        return replace(
            first,
            mosaic=mosaic,
            black_level_dn=first.black_level_dn * scale,
            white_level_dn=first.white_level_dn * scale,
        )


def smoothed(frame: RawFrame) -> Float32Array:
    """A small smoothed image of a frame, relative to its brightest parts: float32 array of shape (h, w, 3)."""
    smooth = small_light(frame)
    return smooth / brightest_light(smooth)


def small_light(frame: RawFrame) -> Float32Array:
    """A small smoothed image of a frame, fractions of full scale: float32 array of shape (h, w, 3)."""
    return box_smoothed(bin_bayer(frame, downsample_step(frame.shape)).rgb)


def brightest_light(smooth: Float32Array) -> np.float32:
    """The 99th percentile of a small image, above zero."""
    return np.float32(max(float(np.percentile(smooth, 99)), 1e-6))
