"""Skin at rest in quick looks: its noise from frame to frame, as the calibration's presses show it, and its level.

Without this prior an object stands in a bowl. Slopes shrink towards zero where light is that of skin at rest (see
`device.inverse_map.skin_at_rest`); the cosine transform has no weights, but `rest_height` levels what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import Ball
from device.errors import RecordError
from device.imaging.flat_field import NormalizedImage, bin_bayer, flat_field_correct
from device.inverse_map.model import read_arrays, write_arrays
from device.inverse_map.rest_height import enlarged, rest_height
from device.inverse_map.skin_at_rest import MIN_CELLS, MIN_RESTING, RestEvidence, SkinAtRest
from device.surface import Float32Array, MaskArray
from hal.frame import RawFrame

REST_FILE: Final = "skin-at-rest.npz"
_COARSER: Final = 2
"""Side in quick-look pixels of a pixel of the image in which skin at rest is found, for a quarter of the time."""


def skin_at_rest(intensity: NormalizedImage, noise: SkinAtRest) -> RestEvidence | None:
    """Return where a quick look shows skin at rest; None where that is too little."""
    evidence = noise.evidence(_coarse(intensity))
    return evidence if evidence.fraction >= MIN_RESTING else None


def levelled(z_um: Float32Array, rest: RestEvidence) -> Float32Array:
    """Return heights (H, W) that are level on skin at rest, and zero on its largest part."""
    return np.asarray(z_um - enlarged(rest_height(_coarser(z_um), rest.kept, rest.lit), z_um.shape), np.float32)


def measure_rest(
    reference: Float32Array, presses: Sequence[tuple[RawFrame, Sequence[Ball]]], binning: int
) -> SkinAtRest | None:
    """Return the noise of untouched skin; None where the field is too small.

    reference : float32 array of shape (H / binning, W / binning, 3), the flat field of quick looks
    presses : frames of the calibration, each with its balls in sensor pixels
    """
    scale = binning * _COARSER
    shown = []
    for frame, balls in presses:
        image = _coarse(flat_field_correct(bin_bayer(frame, binning), reference))
        shown.append((image, [_scaled(ball, scale) for ball in balls]))
    noise = SkinAtRest.of(shown, reference)
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
    levels = arrays["levels"]
    if levels.shape != (2,):
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
    rows, columns, *_ = size = found.covariance.shape
    if size[2:] != (3, 3) or min(rows, columns) < MIN_CELLS or found.pooled.shape != size:
        raise RecordError(f"{path}: holds arrays of wrong shapes: calibrate again")
    if found.roughness.shape != size[:3] or found.darkness.shape != size[:3]:
        raise RecordError(f"{path}: holds arrays of wrong shapes: calibrate again")
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
