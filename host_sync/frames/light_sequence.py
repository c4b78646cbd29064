"""The light-by-light sequence of a scan: what each light alone shows, without ambient light.

With all lights on, a channel also shows what the other lights put into it. Under its own light alone it does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from device.errors import FrameError, RecordError
from device.imaging.flat_field import DARK_FLOOR, NormalizedImage, bin_bayer
from device.imaging.frame_light import without_ambient
from device.surface import Float32Array

if TYPE_CHECKING:
    from device.bundles.scan import ScanBundle

CHANNELS: Final = 3

LIT: Final = 0.5
"""Intensity over the reference from which a light arrives."""

MIN_OWN: Final = 0.1
"""Less of its own light no channel shows."""

STEP: Final = 4
"""Step of the pixels that show how much of a channel's light is its own."""


@dataclass(frozen=True, slots=True, eq=False)
class LightSequence:
    """Single lights' frames.

    lights : the light that each channel shows most of, in the order R, G, B
    alone : float32 array of shape (H/2, W/2, 3), each channel under its own light alone, fractions of full scale
    """

    lights: tuple[str, ...]
    alone: Float32Array

    def over_untouched(self, intensity: NormalizedImage, flat_field: Float32Array) -> Float32Array:
        """Return what each light alone shows over what it shows of untouched skin: float32 array of shape (H, W, 3).

        intensity : of the frame under all lights, over its reference
        flat_field : the reference's light, shape (H, W, 3)

        Where a light arrives, its frame and that of all lights differ by the share of the other lights in its channel.
        """
        size = (flat_field.shape[1], flat_field.shape[0])
        found = np.empty(flat_field.shape, np.float32)
        for channel in range(CHANNELS):
            here = cv2.resize(np.ascontiguousarray(self.alone[..., channel]), size, interpolation=cv2.INTER_LINEAR)
            over = here / np.maximum(flat_field[..., channel], DARK_FLOOR)
            all_lights = intensity.values[::STEP, ::STEP, channel]
            lit = intensity.valid[::STEP, ::STEP] & (all_lights > LIT)
            own = float(np.median(over[::STEP, ::STEP][lit] / all_lights[lit])) if lit.any() else 1.0
            found[..., channel] = over / np.float32(max(own, MIN_OWN))
        return found


def read_light_sequence(scan: ScanBundle) -> LightSequence | str:
    """Return the sequence of a scan, or a sentence that says why it cannot be used; empty if none was taken."""
    exposures = scan.record.exposures
    if exposures.alone_moved:
        return "the object moved while each light was alone, so that those frames were left out"
    if not exposures.alone_files:
        return ""
    if len(exposures.alone_files) != CHANNELS:
        return f"{len(exposures.alone_files)} lights were taken alone, and {CHANNELS} are needed"
    try:
        dark = scan.dark_frame()
        if dark is None:
            return "each light was taken alone, but no frame under no light"
        seen = {
            light: bin_bayer(without_ambient(scan.named_frame(name), dark)).rgb
            for light, name in exposures.alone_files.items()
        }
    except (RecordError, FrameError) as error:
        return f"the frames of single lights cannot be read: {error}"
    own = {int(np.argmax(rgb.mean(axis=(0, 1)))): light for light, rgb in seen.items()}
    if len(own) != CHANNELS:
        return "two lights alone show most in the same channel"
    lights = tuple(own[channel] for channel in range(CHANNELS))
    alone = np.stack([seen[light][..., channel] for channel, light in enumerate(lights)], axis=-1)
    return LightSequence(lights, alone)
