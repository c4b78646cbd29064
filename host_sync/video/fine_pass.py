"""Coarse frames, passes over every pixel of the others, and the standard uncertainty of a frame's heights.

Passes are few, for memory bounds their time. The uncertainty is that of samples, as for a single frame, on a field
reduced once more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import msgspec
import numpy as np

from device.balls.sphere import Viewpoint
from device.imaging.flat_field import LinearFrame, NormalizedImage
from device.inverse_map.skin_at_rest import RestEvidence
from device.surface import Float32Array, GradientField, HeightMap, MaskArray, surface_slopes
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.gradients.inverse_map_kernel import SlopeKernel
from host_sync.integration.zero_level import Datum
from host_sync.kernels.cell_rows import WIDEST_CELLS, bordered, expanded_at
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.fit import FittedLight
from host_sync.light.reading import CellCorrection, correct_slopes
from host_sync.reconstruction.heights import RestPrior
from host_sync.reconstruction.reading_uncertainty import known_scale_share, slope_error_of
from host_sync.reconstruction.slope_reading import MIN_FACING, seen_slopes, uncorrected
from host_sync.uncertainty.calibration_uncertainty import CalibrationUncertainty, calibration_uncertainty
from host_sync.uncertainty.height_error import height_uncertainty, nonintegrable_residual

MAX_NEARNESS: Final = 0.1
"""Elevation over the camera's height up to which five terms of a series are exact to single precision."""


class FineCorrection:
    """Change that a coarse reading brings to slopes of a frame of full size, as planes over cells.

    viewpoint : of the camera that sees the slopes; None of one far away
    """

    def __init__(self, reading: CoarseReading, cell: int, viewpoint: Viewpoint | None = None) -> None:
        size = reading.gain_p.shape[::-1]
        kept, factor = np.ones_like(reading.gain_p), reading.weight
        if reading.prior is not None:
            kept, more = (
                np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_LINEAR), np.float32)
                for part in (reading.prior.kept, reading.prior.weight)
            )
            factor = factor * more
        self._planes = bordered(np.stack([reading.gain_p, reading.gain_q, kept, factor]))
        self._cell = cell
        place = (0.0, 0.0, 0.0)
        if viewpoint is not None:
            place = (viewpoint.column, viewpoint.row, 1.0 / viewpoint.height_px)
        self._place = np.array(place, np.float32)

    def apply(self, gradients: GradientField) -> None:
        """Write corrected slopes, as the camera sees them (`seen_slopes`), and weights over those of a field (H, W)."""
        slopes = gradients.p, gradients.q, gradients.weight
        parallel_rows(_apply, gradients.p.shape, self._planes, self._cell, self._place, *slopes)


@njit(cache=True, nogil=True)
def _apply(planes: Any, cell: int, place: Any, p: Any, q: Any, weight: Any, first: int, last: int) -> None:
    """Correct the rows `first` to `last` - 1."""
    upper, step = np.empty((4, p.shape[1]), np.float32), np.empty((4, p.shape[1]), np.float32)
    column, row, nearness = place
    across = np.empty(p.shape[1], np.float32)
    for c in range(across.size):
        across[c] = (np.float32(c) - column) * nearness
    expanded = -1
    for r in range(first, last):
        expanded, share = expanded_at(planes, r, cell, expanded, upper, step)
        _apply_row(upper, step, share, across, (np.float32(r) - row) * nearness, p[r], q[r], weight[r])


@njit(cache=True, error_model="numpy")
def _apply_row(upper: Any, step: Any, share: Any, across: Any, down: Any, p: Any, q: Any, weight: Any) -> None:
    one, least = np.float32(1.0), np.float32(MIN_FACING)
    for c in range(p.size):
        kept = upper[2, c] + share * step[2, c]
        steep = kept * (p[c] + upper[0, c] + share * step[0, c])
        rise = kept * (q[c] + upper[1, c] + share * step[1, c])
        seen = one / max(one + across[c] * steep + down * rise, least)
        p[c] = seen * steep
        q[c] = seen * rise
        weight[c] *= upper[3, c] + share * step[3, c]


def block_moments(values: Float32Array, cell: int, size: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Return means of planes (3, H, W), and of their squares, over `size` (h, w) cells: arrays of shape (3, h, w)."""
    rows, columns = size
    mean, square = np.empty((3, rows, columns), np.float32), np.empty((3, rows, columns), np.float32)
    parallel_rows(_write_moments, (rows, columns * cell**2), values, cell, mean, square)
    return mean, square


@njit(cache=True, nogil=True)
def _write_moments(values: Any, cell: int, mean: Any, square: Any, first: int, last: int) -> None:
    """Fill the rows `first` to `last` - 1 of cells."""
    rows, columns = values.shape[1:]
    total, squares = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for i in range(first, last):
        bottom = min((i + 1) * cell, rows)
        for channel in range(3):
            total[:] = np.float32(0.0)
            squares[:] = np.float32(0.0)
            for r in range(i * cell, bottom):
                _add_row(values[channel, r], total, squares)
            _mean_of_cells(total, cell, bottom - i * cell, mean[channel, i])
            _mean_of_cells(squares, cell, bottom - i * cell, square[channel, i])


@njit(cache=True)
def _add_row(values: Any, total: Any, squares: Any) -> None:
    for c in range(total.size):
        total[c] += values[c]
        squares[c] += values[c] * values[c]


@njit(cache=True)
def _mean_of_cells(total: Any, cell: int, rows: int, mean: Any) -> None:
    for j in range(mean.size):
        right = min((j + 1) * cell, total.size)
        own = np.float32(0.0)
        for c in range(j * cell, right):
            own += total[c]
        mean[j] = own / np.float32(rows * (right - j * cell))


def level(height: HeightMap, zero_um: float, viewpoint: Viewpoint | None = None) -> tuple[float, int]:
    """Write elevations over a zero, as `seen_elevation` has them, over heights; return the largest and their number.

    viewpoint : of the camera that saw the slopes; None of one far away
    """
    z_um = height.z_um
    nearness = 0.0 if viewpoint is None else 1.0 / (viewpoint.height_px * height.pitch_um)
    highest, known = np.empty(len(z_um), np.float32), np.empty(len(z_um), np.int64)
    parallel_rows(_take_zero_off, z_um.shape, z_um, np.float32(zero_um), np.float32(nearness), highest, known)
    return float(highest.max()), int(known.sum())


@njit(cache=True, nogil=True)
def _take_zero_off(z: Any, zero: Any, nearness: Any, highest: Any, known: Any, first: int, last: int) -> None:
    for r in range(first, last):
        highest[r], lowest, known[r] = _take_off(z[r], zero)
        if max(highest[r], -lowest) * nearness > np.float32(MAX_NEARNESS):
            for c in range(z.shape[1]):
                z[r, c] = -np.expm1(-z[r, c] * nearness) / nearness
            highest[r] = -np.expm1(-highest[r] * nearness) / nearness
        elif nearness > np.float32(0.0) and known[r] > 0:
            _elevate_row(z[r], nearness)
            _elevate_row(highest[r : r + 1], nearness)


@njit(cache=True)
def _take_off(z: Any, zero: Any) -> tuple[Any, Any, int]:
    """Take the zero off a row; return its largest and smallest height, and the number of finite ones."""
    highest, lowest, known = np.float32(-np.inf), np.float32(np.inf), 0
    for c in range(z.size):
        over = z[c] - zero
        z[c] = over
        known += np.isfinite(over)
        highest = over if over > highest else highest
        lowest = over if over < lowest else lowest
    return highest, lowest, known


@njit(cache=True)
def _elevate_row(z: Any, nearness: Any) -> None:
    """Write (1 - exp(-z n)) / n over z by its series."""
    one, half, third = np.float32(1.0), np.float32(1.0 / 2.0), np.float32(1.0 / 3.0)
    fourth, fifth = np.float32(1.0 / 4.0), np.float32(1.0 / 5.0)
    for c in range(z.size):
        x = z[c] * nearness
        z[c] *= one - half * x * (one - third * x * (one - fourth * x * (one - fifth * x)))


# Frames at reduced size, on which what changes slowly over the field is found: elevation, hidden lights, skin at rest.
#
# All of these are long waves, so that their cost need not grow with the pixels of a frame.

WIDEST_PX: Final = 384
"""Columns of a coarse frame, at most."""

CELLS_ACROSS: Final = 64
"""Cells along a frame's columns on which the light model is solved, at most: its changes are long waves. Shadows of
sources have edges: under them a frame that is not reduced has as many cells as one alone."""


def at_size(calibration: Calibration, reference: LinearFrame, flat_field: Float32Array) -> Calibration:
    """Return the calibration of the same field at the reference's size: positions are fractions of the field.

    reference, flat_field : untouched skin at that size, and what frames are divided by
    """
    finer = reference.shape[1] / calibration.flat_field.shape[1]
    error = calibration.slope_error
    return replace(
        calibration,
        flat_field=flat_field,
        frame_model=FrameModel.of(reference, flat_field, []),
        pitch_um=calibration.pitch_um / finer,
        inverse=replace(calibration.inverse, map=replace(calibration.inverse.map, shape=reference.shape)),
        slope_error=msgspec.structs.replace(
            error, patch_px=error.patch_px * finer, elevation=error.elevation.enlarged(finer)
        ),
        elevation=calibration.elevation.enlarged(finer),
        viewpoint=None if calibration.viewpoint is None else calibration.viewpoint.enlarged(finer),
        light=calibration.light.for_shape(reference.shape),
    )


def corrects_coarsely(columns: int, light: FittedLight, method: Method) -> bool:
    """Return whether sources correct slopes of frames so wide on fewer cells than those of a single frame."""
    return columns > WIDEST_PX and method == "direct" and light.has_sources and light.confirmed > 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CoarseReading:
    """Slopes of a coarse frame and what they gained: arrays of shape (h, w).

    gradients : corrected slopes and their weights, skin at rest included
    gain_p, gain_q, weight : what slopes gained, and by which factor their weight changed
    prior : of skin at rest; None without
    correction : of the light model; None without a confirmed one
    """

    gradients: GradientField
    gain_p: Float32Array
    gain_q: Float32Array
    weight: Float32Array
    prior: RestPrior | None
    correction: CellCorrection | None

    @property
    def has_rest(self) -> bool:
        """True unless the light shows that no skin is untouched."""
        return self.correction is None or self.correction.has_rest


def read_coarse(
    image: NormalizedImage,
    evidence: RestEvidence | None,
    calibration: Calibration,
    method: Method,
    kernel: SlopeKernel,
    *,
    is_whole: bool,
) -> CoarseReading:
    """Return the slopes of a coarse image, corrected as those of a single frame are.

    evidence : of skin at rest; None without a reference
    kernel : the compiled inverse map of the calibration
    is_whole : the image is not reduced, and its slopes are those of a frame reconstructed alone
    """
    gradients = uncorrected(image, calibration, method, kernel=kernel)
    read_p, read_q, sure = gradients.p.copy(), gradients.q.copy(), gradients.weight.copy()
    correction, light = None, calibration.light
    if method == "direct" and light.confirmed:
        correction = correct_slopes(
            gradients, image, light, calibration.prior_sigma, calibration.elevation,
            rest=evidence, cells_across=WIDEST_CELLS if is_whole and light.has_sources else CELLS_ACROSS,
        )  # fmt: skip
        correction.apply(gradients)
    gain_p, gain_q = gradients.p - read_p, gradients.q - read_q
    weight = np.asarray(gradients.weight / np.maximum(sure, np.float32(1e-12)), np.float32)
    prior = None
    if evidence is not None and method == "direct" and (correction is None or correction.has_rest):
        viewpoint = calibration.viewpoint
        seen = gradients if viewpoint is None else seen_slopes(gradients, viewpoint)
        prior = RestPrior.of(seen, [evidence], calibration.prior_sigma)
        if prior is not None:
            prior.apply(gradients)
    return CoarseReading(gradients, gain_p, gain_q, weight, prior, correction)


SIGMA_COLUMNS_PX: Final = 160
"""Columns of the field on which errors are drawn, at most: they are long waves."""


class FrameSigma:
    """Uncertainty of the heights of coarse frames.

    calibration : of coarse frames
    """

    def __init__(self, calibration: Calibration, method: Method) -> None:
        rows, columns, _ = calibration.flat_field.shape
        self._step = -(-columns // SIGMA_COLUMNS_PX)
        self._size = (-(-columns // self._step), -(-rows // self._step))
        error, step = slope_error_of(calibration, method), float(self._step)
        self._error = msgspec.structs.replace(
            error,
            patch_px=error.patch_px / step,
            pixel_deg=tuple(part / step for part in error.pixel_deg),
            elevation=error.elevation.enlarged(1.0 / step),
        )
        self._replicas = calibration.inverse.replicas if method == "direct" else ()
        self._scale = known_scale_share(calibration)

    def write(
        self,
        height: HeightMap,
        image: NormalizedImage,
        reading: CoarseReading,
        datum: Datum,
        z_um: Float32Array,
        out: Float32Array,
    ) -> None:
        """Write the uncertainty (µm, NaN where there is no height) of a frame of full size to `out`.

        height : of the coarse frame, over its zero
        z_um : heights of full size, float32 array of shape (H, W), as `out`
        """
        gradients, correction = reading.gradients, reading.correction
        nonintegrable = nonintegrable_residual(gradients, *surface_slopes(height))
        if correction is None or correction.slope_deviations is None:
            unknown = calibration_uncertainty(image, self._replicas, self._size)
        else:
            unknown = CalibrationUncertainty.of(correction.slope_deviations(), self._size)
        found = height_uncertainty(
            HeightMap(self._less(height.z_um), height.pitch_um * self._step),
            GradientField(
                self._less(gradients.p, gradients.valid),
                self._less(gradients.q, gradients.valid),
                self._less(gradients.valid.astype(np.float32)) > 0.0,
                self._less(gradients.weight),
            ),
            self._less(nonintegrable),
            self._error,
            replace(datum, skin=self._less(datum.skin.astype(np.float32)) > np.float32(0.5)),
            self._scale,
            calibration=unknown,
            shadow=None if correction is None else correction.sigma(self._size),
        )
        size = (out.shape[1], out.shape[0])
        cv2.resize(np.nan_to_num(found.sigma_um, nan=float(np.nanmax(found.sigma_um))), size, dst=out)
        np.copyto(out, np.nan, where=~np.isfinite(z_um))

    def _less(self, field: Float32Array, known: MaskArray | None = None) -> Float32Array:
        """Return means over cells of a field of coarse pixels, 0 where it is not known."""
        here = np.isfinite(field) if known is None else known
        whole = field if here.all() else np.where(here, field, np.float32(0.0))
        return np.asarray(cv2.resize(whole, self._size, interpolation=cv2.INTER_AREA), np.float32)
