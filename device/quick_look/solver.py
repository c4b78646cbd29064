"""Quick look: a reduced height map of one raw frame, on the device, at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from device.balls.sphere import Ball
from device.errors import RecordError
from device.imaging.flat_field import LinearFrame, NormalizedImage, bin_bayer, flat_field_correct, make_flat_field
from device.inverse_map.model import InverseMap, read_arrays, slope_sigma_of, write_arrays
from device.inverse_map.skin_at_rest import CALM, MIN_CELLS, MIN_RESTING, RESTING, RestEvidence, SkinAtRest
from device.inverse_map.tabulated import TabulatedInverseMap
from device.surface import (
    Float32Array,
    GradientField,
    HeightMap,
    MaskArray,
    enlarged,
    integrate_dct,
    rest_height,
    surface_slopes,
)
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
    slope_sigma : standard uncertainty of slopes
    """

    binning: int
    flat_field: Float32Array
    slopes: TabulatedInverseMap
    pitch_um: float
    rest: SkinAtRest | None
    slope_sigma: float

    @classmethod
    def prepare(
        cls,
        reference: RawFrame,
        inverse_map: InverseMap,
        pitch_um: float,
        rest: SkinAtRest | None = None,
        held_out_deg: float | None = None,
    ) -> QuickLookModel:
        """Return the model of a calibration's reference frame, inverse map and noise of untouched skin.

        held_out_deg : mean angular error on held-out balls; None where it is not known
        """
        binning = quick_look_binning(reference.shape)
        flat_field = make_flat_field(bin_bayer(reference, binning))
        # Three planes, as a binned frame is: arithmetic between like layouts is several times as fast.
        planar = np.moveaxis(np.ascontiguousarray(np.moveaxis(flat_field, -1, 0)), 0, -1)
        tabulated = TabulatedInverseMap.of(inverse_map, binning)
        return cls(binning, planar, tabulated, pitch_um, rest, slope_sigma_of(held_out_deg))


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
    height = HeightMap(integrate_dct(gradients.p * trusted, gradients.q * trusted, pitch_um), pitch_um)
    if rest is not None:
        height = levelled(height, rest, model.slope_sigma)
    return QuickLook(height, gradients, intensity)


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


# Skin at rest in quick looks: its noise from frame to frame, as the calibration's presses show it, and its level.
#
# Without this prior an object stands in a bowl. Slopes shrink towards zero where light is that of skin at rest (see
# `device.inverse_map.skin_at_rest`); the cosine transform has no weights, but `rest_height` levels what is left.

REST_FILE: Final = "skin-at-rest.npz"
_COARSER: Final = 2
"""Side in quick-look pixels of a pixel of the image in which skin at rest is found, for a quarter of the time."""


def skin_at_rest(intensity: NormalizedImage, noise: SkinAtRest) -> RestEvidence | None:
    """Return where a quick look shows skin at rest; None where that is too little."""
    evidence = noise.evidence(_coarse(intensity))
    return evidence if evidence.fraction >= MIN_RESTING else None


def levelled(height: HeightMap, rest: RestEvidence, slope_sigma: float) -> HeightMap:
    """Return heights that are level on skin at rest, and zero on its largest part; see `rest_height`."""
    resting, calm = (rest.lit & (rest.kept < most) for most in (RESTING, CALM))
    coarse = HeightMap(_coarser(height.z_um), height.pitch_um * _COARSER)
    error = enlarged(rest_height(coarse, resting, calm, slope_sigma), height.z_um.shape)
    return HeightMap(np.asarray(height.z_um - error, np.float32), height.pitch_um)


def measure_rest(reference: RawFrame, presses: Sequence[tuple[RawFrame, Sequence[Ball]]]) -> SkinAtRest | None:
    """Return the noise of untouched skin; None where the field is too small.

    presses : frames of the calibration, each with its balls in sensor pixels
    """
    binning = quick_look_binning(reference.shape)
    flat_field = make_flat_field(bin_bayer(reference, binning))
    shown = []
    for frame, balls in presses:
        image = _coarse(flat_field_correct(bin_bayer(frame, binning), flat_field))
        shown.append((image, [_scaled(ball, binning * _COARSER) for ball in balls]))
    noise = SkinAtRest.of(shown, flat_field)
    return noise and replace(noise, removes_light=False)  # drift of the lights is measured, not removed


def write_rest(path: Path, noise: SkinAtRest) -> None:
    """Write the noise of untouched skin so that `read_rest` returns it bit for bit."""
    write_arrays(
        path,
        {
            "covariance": noise.covariance,
            "pooled": noise.pooled,
            "roughness": noise.roughness,
            "darkness": noise.darkness,
            "levels": np.array([noise.gain_sigma, noise.offset_sigma]),
        },
    )


def read_rest(path: Path) -> SkinAtRest:
    """Return the noise of untouched skin in a file; errors as for `read_arrays`."""
    return read_arrays(path, lambda arrays: _noise_of(arrays, path))


def _noise_of(arrays: dict[str, NDArray[Any]], path: Path) -> SkinAtRest:
    levels, size = arrays["levels"], arrays["covariance"].shape
    shapes = {"pooled": size, "roughness": size[:3], "darkness": size[:3], "levels": (2,)}
    is_sized = size[2:] == (3, 3) and min(size[:2]) >= MIN_CELLS
    if not is_sized or any(arrays[name].shape != shape for name, shape in shapes.items()):
        raise RecordError(f"{path}: holds arrays of wrong shapes: calibrate again")
    found = SkinAtRest(
        covariance=np.asarray(arrays["covariance"], np.float32),
        pooled=np.asarray(arrays["pooled"], np.float32),
        roughness=np.asarray(arrays["roughness"], np.float32),
        darkness=np.asarray(arrays["darkness"], np.float32),
        gain_sigma=float(levels[0]),
        offset_sigma=float(levels[1]),
        removes_light=False,
    )
    variances = (found.roughness, found.darkness, levels)
    if not all(np.isfinite(one).all() and one.min() > 0.0 for one in variances):
        raise RecordError(f"{path}: holds values that are no variances: calibrate again")
    matrices = (found.covariance, found.pooled)
    if not all(np.isfinite(one).all() and np.linalg.eigvalsh(one).min() > 0.0 for one in matrices):
        raise RecordError(f"{path}: holds matrices that are no covariances: calibrate again")
    return found


def _coarse(intensity: NormalizedImage) -> NormalizedImage:
    """Return intensity over squares of `_COARSER` pixels."""
    planes = [_coarser(plane) for plane in np.moveaxis(intensity.values, -1, 0)]
    values = np.moveaxis(np.asarray(planes, np.float32), 0, -1)
    lit: MaskArray = np.ones(values.shape[:2], np.bool_)
    return NormalizedImage(values, lit, ~lit)


def _coarser(plane: Float32Array) -> Float32Array:
    """Return means over whole squares of `_COARSER` pixels of an array (H, W)."""
    rows, columns = (side // _COARSER for side in plane.shape)
    whole = plane[: rows * _COARSER, : columns * _COARSER]
    return np.asarray(cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)


def _scaled(ball: Ball, scale: int) -> Ball:
    """Return a ball in pixels of a binned image."""
    return Ball(
        (ball.column + 0.5) / scale - 0.5, (ball.row + 0.5) / scale - 0.5, ball.contact_radius_px / scale,
        ball.radius_px / scale,
    )  # fmt: skip
