"""Quick look: a reduced height map of one raw frame, on the device, at once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import tifffile

from device.imaging.flat_field import LinearFrame, NormalizedImage, bin_bayer, flat_field_correct, make_flat_field
from device.inverse_map.model import InverseMap
from device.inverse_map.rest_height import enlarged
from device.inverse_map.skin_at_rest import SkinAtRest
from device.inverse_map.tabulated import TabulatedInverseMap
from device.quick_look.resting_skin import levelled, skin_at_rest
from device.surface import Float32Array, GradientField, HeightMap, integrate_dct, surface_slopes
from hal.frame import RawFrame

WIDEST_PX: Final = 512
"""A quick look has at most this many columns."""


@dataclass(frozen=True, slots=True, eq=False)
class QuickLookModel:
    """Model that the device keeps in memory between presses: the active calibration at quick-look size.

    binning : sensor pixels per quick-look pixel, in each direction
    flat_field : float32 array of shape (H / binning, W / binning, 3), the blurred reference
    slopes : the inverse map, tabulated
    pitch_um : distance of neighbouring sensor pixels on the skin, µm
    rest : noise of untouched skin; None where the calibration measured none
    """

    binning: int
    flat_field: Float32Array
    slopes: TabulatedInverseMap
    pitch_um: float
    rest: SkinAtRest | None = None

    @classmethod
    def prepare(
        cls, reference: RawFrame, inverse_map: InverseMap, pitch_um: float, rest: SkinAtRest | None = None
    ) -> QuickLookModel:
        """Return the model of a calibration's reference frame, inverse map and noise of untouched skin."""
        binning = quick_look_binning(reference.shape)
        flat_field = quick_look_field(reference)
        # Three planes, as a binned frame is: arithmetic between like layouts is several times as fast.
        planar = np.moveaxis(np.ascontiguousarray(np.moveaxis(flat_field, -1, 0)), 0, -1)
        return cls(binning, planar, TabulatedInverseMap.of(inverse_map, binning), pitch_um, rest)


@dataclass(frozen=True, slots=True, eq=False)
class QuickLook:
    """A reduced height map with what it was made from; height pitch is the sensor's times the binning.

    height : zero on skin at rest where that is seen, else of zero mean
    gradients : as estimated, without the prior of skin at rest
    """

    height: HeightMap
    gradients: GradientField
    intensity: NormalizedImage


def quick_look_binning(shape: tuple[int, int]) -> int:
    """Return the smallest even binning that brings a frame of `shape` (H, W) to at most `WIDEST_PX` columns."""
    binning = 2
    while shape[1] // binning > WIDEST_PX:
        binning += 2
    return binning


def quick_look_field(reference: RawFrame) -> Float32Array:
    """Return the flat field of quick looks, float32 array of shape (H / binning, W / binning, 3)."""
    return make_flat_field(bin_bayer(reference, quick_look_binning(reference.shape)))


def quick_look(frame: LinearFrame, model: QuickLookModel) -> QuickLook:
    """Return the quick look of a frame that was binned by `model.binning`.

    Raises
    ------
    CalibrationMismatch
        The frame's size is not that of the calibration.
    """
    intensity = flat_field_correct(frame, model.flat_field)
    gradients = model.slopes.gradients(intensity)
    # The DCT has no weights: where the map has no confidence the skin is taken as flat. Tabulated slopes are finite.
    trusted = np.minimum(np.float32(2.0) * gradients.weight, np.float32(1.0))
    rest = None if model.rest is None else skin_at_rest(intensity, model.rest)
    if rest is not None:
        trusted *= enlarged(rest.kept, trusted.shape)
    pitch_um = model.pitch_um * model.binning
    z_um = integrate_dct(gradients.p * trusted, gradients.q * trusted, pitch_um)
    if rest is not None:
        z_um = levelled(z_um, rest)
    return QuickLook(HeightMap(z_um, pitch_um), gradients, intensity)


# The quick look as files of a scan bundle: heights for programs, a picture for people.

HEIGHT_FILE: Final = "quick-look-um.tif"
PICTURE_FILE: Final = "quick-look.png"
_LIGHT: Final = (-0.55, -0.55, 0.63)


def write_quick_look(directory: Path, height: HeightMap) -> None:
    """Write the heights (float32 TIFF, µm) and the shaded picture (PNG, 8 bit) into a directory."""
    tifffile.imwrite(
        directory / HEIGHT_FILE, height.z_um, description=f"height, um; pixel pitch {height.pitch_um:g} um"
    )
    encoded = cv2.imencode(".png", shaded_picture(height))[1]
    (directory / PICTURE_FILE).write_bytes(encoded.tobytes())


def shaded_picture(height: HeightMap) -> np.ndarray:
    """Return diffuse shading from the upper left: uint8 array of shape (H, W)."""
    p, q = surface_slopes(height)
    cosine = (-p * _LIGHT[0] - q * _LIGHT[1] + _LIGHT[2]) / np.sqrt(1.0 + p * p + q * q)
    return np.asarray(np.clip(255.0 * (0.15 + 0.85 * cosine), 0.0, 255.0), np.uint8)
