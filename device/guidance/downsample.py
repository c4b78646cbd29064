"""Raw frames downsampled to small colour images: one Bayer quad per block, cheap enough for every live frame.

Why not the camera's own low-resolution stream: its grey values have been through the image pipeline and no longer
measure light, and slope and depth need colour. Picking quads costs a fraction of a millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.imaging.flat_field import SATURATED
from device.surface.fields import Float32Array
from hal.frame import RawFrame

MAX_COLUMNS: Final = 160


@dataclass(frozen=True, slots=True, eq=False)
class ReducedFrame:
    """A small image of the live stream.

    rgb : float32 array of shape (h, w, 3), linear light as a fraction of full scale
    clipped_fraction : fraction of pixels with a saturated channel
    at_ns : start of the exposure, monotonic ns
    """

    rgb: Float32Array
    clipped_fraction: float
    at_ns: int

    def picture(self) -> np.ndarray:
        """The image for a screen: uint8 array of shape (h, w, 3), R, G, B, with gamma applied."""
        return np.asarray(255.0 * np.sqrt(np.clip(self.rgb, 0.0, 1.0)) + 0.5, np.uint8)


def downsample_step(shape: tuple[int, int]) -> int:
    """Sensor pixels per pixel of the small image: the smallest even step that leaves at most `MAX_COLUMNS` columns."""
    step = 2
    while shape[1] // step > MAX_COLUMNS:
        step += 2
    return step


def downsample_bayer(frame: RawFrame) -> ReducedFrame:
    """The small image of a raw frame, from the middle quad of every block."""
    step = downsample_step(frame.shape)
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
    return ReducedFrame(rgb, float((brightest >= limit).mean()), frame.sensor_timestamp_ns)
