"""A raw frame thinned to a small colour picture: one Bayer quad out of every block, so cheap that every frame is seen.

Why not the camera's own small stream: its grey has been through the picture pipeline, so it is no measure of light,
and without colour there is neither slope nor depth. Picking quads costs a fraction of a millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.photometry import SATURATED
from device.surface import Float32Array
from hal.frame import RawFrame

MOST_COLUMNS: Final = 160


@dataclass(frozen=True, slots=True, eq=False)
class ThinFrame:
    """One small picture of the live stream.

    rgb : float32 array of shape (h, w, 3), linear light as a share of full scale
    clipped_share : share of its pixels that are saturated in a channel
    at_ns : when the exposure began, monotonic ns
    """

    rgb: Float32Array
    clipped_share: float
    at_ns: int

    def picture(self) -> np.ndarray:
        """For the eye: uint8 array of shape (h, w, 3), R, G, B, brightened as a screen expects."""
        return np.asarray(255.0 * np.sqrt(np.clip(self.rgb, 0.0, 1.0)) + 0.5, np.uint8)


def thinning(shape: tuple[int, int]) -> int:
    """Sensor pixels per thin pixel in each direction: the smallest even number that leaves `MOST_COLUMNS` or fewer."""
    step = 2
    while shape[1] // step > MOST_COLUMNS:
        step += 2
    return step


def thin(frame: RawFrame) -> ThinFrame:
    """The small picture of a raw frame: the quad in the middle of every block."""
    step = thinning(frame.shape)
    rows, columns = (size // step * step for size in frame.shape)
    first = step // 2 // 2 * 2
    scale = np.float32(1.0 / (frame.white_level_dn - frame.black_level_dn))
    sites = [
        frame.mosaic[first + i // 2 : rows : step, first + i % 2 : columns : step].astype(np.float32) for i in range(4)
    ]
    colours = [[site for site, letter in zip(sites, frame.bayer_order, strict=True) if letter == c] for c in "RGB"]
    rgb = np.empty((*sites[0].shape, 3), np.float32)
    brightest = sites[0]
    for channel, same in enumerate(colours):
        rgb[..., channel] = same[0] if len(same) == 1 else np.float32(0.5) * (same[0] + same[1])
        for site in same:
            brightest = np.maximum(brightest, site)
    rgb -= np.float32(frame.black_level_dn)
    rgb *= scale
    limit = frame.black_level_dn + SATURATED / float(scale)
    return ThinFrame(rgb, float((brightest >= limit).mean()), frame.sensor_timestamp_ns)
