"""Skin at rest in quick looks: its noise from frame to frame, as the calibration's presses show it, and its level.

Slopes of untouched skin are noise, and slopes of the free skin around an object do not close: without
this prior, an object stands in a bowl. Slopes shrink towards zero where light is that of skin at rest (see
`device.inverse_map.skin_at_rest`). What is left of height along one connected part of such skin is spread smoothly over
the rest of the field and subtracted. Parts that do not connect, such as the two sides of a step, keep their distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from device.balls.sphere import Ball
from device.errors import RecordError
from device.imaging.flat_field import NormalizedImage, bin_bayer, flat_field_correct
from device.inverse_map.model import read_arrays, write_arrays
from device.inverse_map.skin_at_rest import MIN_CELLS, RESTING, SkinAtRest
from device.surface import Float32Array, MaskArray
from hal.frame import RawFrame

REST_FILE: Final = "skin-at-rest.npz"
_COARSER: Final = 2
"""Side in quick-look pixels of a pixel of the image in which skin at rest is found, for a quarter of the time."""


@dataclass(frozen=True, slots=True, eq=False)
class RestingSkin:
    """Skin at rest in a frame.

    kept : float32 array of shape (h, w), fraction of its slope that a cell keeps
    """

    kept: Float32Array

    @classmethod
    def of(cls, intensity: NormalizedImage, noise: SkinAtRest) -> RestingSkin | None:
        """Return the skin at rest in a quick look's intensity; None where too little of it is seen."""
        evidence = noise.evidence(_coarse(intensity))
        return cls(evidence.kept) if evidence.has_rest else None

    def kept_slopes(self, shape: tuple[int, ...]) -> Float32Array:
        """Return the fraction of its slope that each pixel keeps, float32 array of `shape` (H, W)."""
        return np.asarray(cv2.resize(self.kept, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)

    def levelled(self, z_um: Float32Array) -> Float32Array:
        """Return heights (H, W) that are level along each connected part of skin at rest, and zero on the largest."""
        resting = self.kept < RESTING
        cells_um = np.asarray(
            cv2.resize(_coarser(z_um), self.kept.shape[::-1], interpolation=cv2.INTER_AREA), np.float32
        )
        labels, parts = ndimage.label(resting)
        level_um = np.asarray(ndimage.mean(cells_um, labels, np.arange(parts + 1)), np.float32)
        largest = 1 + int(np.bincount(labels[resting])[1:].argmax())
        off_um = _spread(np.where(resting, cells_um - level_um[labels], np.float32(0.0)), resting.astype(np.float32))
        off_um += level_um[largest]
        return np.asarray(z_um - cv2.resize(off_um, z_um.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


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


def _spread(values: Float32Array, known: Float32Array) -> Float32Array:
    """Return values (h, w) that continue smoothly from where they are known; `known` is their weight, 0 to 1.

    Means over ever coarser cells fill what is not known: an approximation of the solution of Laplace's equation.
    """
    if min(values.shape) < 2:
        return np.full_like(values, (values * known).sum() / max(float(known.sum()), 1e-9))
    size = ((values.shape[1] + 1) // 2, (values.shape[0] + 1) // 2)
    weight = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA), np.float32)
    mean = cv2.resize(values * known, size, interpolation=cv2.INTER_AREA) / np.maximum(weight, np.float32(1e-6))
    coarser = _spread(np.asarray(mean, np.float32), np.minimum(np.float32(2.0) * weight, np.float32(1.0)))
    wide = cv2.resize(coarser, values.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(known * values + (np.float32(1.0) - known) * wide, np.float32)
