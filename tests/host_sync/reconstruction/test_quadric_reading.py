"""Slopes of pixels gain what a quadratic function of the normal reads otherwise than the map."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
from makers_skin import SHAPE

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array, GradientField
from host_sync.kernels.cell_rows import cell_px, middles_of_cells
from host_sync.lights.normal_quadric import TERMS, FittedQuadric, NormalQuadric
from host_sync.light.cell_correction import CellCorrection, SlopePair
from host_sync.reconstruction.quadric_reading import read_by_quadric

CELL = cell_px(SHAPE)
COEFFICIENTS = np.zeros((TERMS, 1, 3))
COEFFICIENTS[:2, 0] = 0.7 * np.stack([np.cos([1.6, 3.7, 5.8]), np.sin([1.6, 3.7, 5.8])])
MODEL = NormalQuadric(SHAPE, 0, COEFFICIENTS, None)
WEAKER = replace(MODEL, coefficients=0.98 * COEFFICIENTS)
ALL_ALIKE = FittedQuadric(MODEL, (MODEL, MODEL))
EVERYWHERE = np.ones(SHAPE, np.bool_)
FLATTER = 0.97


def slopes(column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A hill of long waves on level skin, at columns (w,) and rows (h,)."""
    across, down = column[None, :] - 160.0, row[:, None] - 120.0
    z = 14.0 * np.exp(-(across**2 + down**2) / 60.0**2)
    return -2.0 * across / 60.0**2 * z, -2.0 * down / 60.0**2 * z


P, Q = slopes(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
TILT_OF_CELLS = np.hypot(*slopes(*reversed(middles_of_cells((SHAPE[0] // CELL, SHAPE[1] // CELL), CELL))))
AT = tuple(part.ravel().astype(np.float64) for part in np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0])))
VALUES = MODEL.at(*AT).shown(np.stack([P.ravel(), Q.ravel()], axis=-1)).reshape(*SHAPE, 3).astype(np.float32)
IMAGE = NormalizedImage(VALUES, EVERYWHERE, ~EVERYWHERE)


def flat_map() -> InverseMap:
    """A map that reads this frame's slopes 3 % too flat."""

    def on_grid(_: Float32Array, column: np.ndarray, row: np.ndarray) -> Float32Array:
        return (FLATTER * np.stack(slopes(column, row), axis=-1)).astype(np.float32)

    return cast(InverseMap, SimpleNamespace(on_grid=on_grid))


def corrected(correction: CellCorrection) -> tuple[np.ndarray, np.ndarray]:
    read = GradientField(
        (FLATTER * P).astype(np.float32), (FLATTER * Q).astype(np.float32), EVERYWHERE, np.ones(SHAPE, np.float32)
    )
    correction.apply(read)
    np.testing.assert_array_equal(read.weight, 1.0)
    return read.p, read.q


def deviations(correction: CellCorrection) -> SlopePair:
    """What its folds make slopes unsure by."""
    assert correction.unsure is not None
    return correction.unsure()


def test_slopes_that_a_map_reads_too_flat_become_right() -> None:
    p, q = corrected(read_by_quadric(IMAGE, flat_map(), ALL_ALIKE))
    steep = np.hypot(P, Q) > 0.03
    assert np.hypot(p - P, q - Q)[steep].mean() < 0.2 * (1.0 - FLATTER) * np.hypot(P, Q)[steep].mean()
    gain = (p * P + q * Q)[steep].sum() / (P * P + Q * Q)[steep].sum()
    assert abs(gain - 1.0) < 0.002


def test_level_skin_stays_as_it_is_read() -> None:
    correction = read_by_quadric(IMAGE, flat_map(), ALL_ALIKE)
    level = TILT_OF_CELLS < 0.004
    assert level.any()
    assert not correction.p[level].any()
    assert not correction.q[level].any()


def test_folds_that_read_otherwise_make_slopes_unsure() -> None:
    assert not np.any(deviations(read_by_quadric(IMAGE, flat_map(), ALL_ALIKE)))
    correction = read_by_quadric(IMAGE, flat_map(), FittedQuadric(MODEL, (MODEL, WEAKER)))
    p, q = deviations(correction)
    sigma = np.sqrt((p**2 + q**2).sum(axis=0))
    steep = TILT_OF_CELLS > 0.1
    # Two folds that differ by 2 %: their mean is off by half of that, and the jackknife doubles its variance by K - 1.
    np.testing.assert_allclose(sigma[steep] / TILT_OF_CELLS[steep], 0.01, rtol=0.15)


def test_cells_with_a_saturated_pixel_are_left_as_the_map_reads_them() -> None:
    clipped = np.zeros(SHAPE, np.bool_)
    clipped[100, 130:150] = True
    correction = read_by_quadric(replace(IMAGE, clipped=clipped), flat_map(), ALL_ALIKE)
    here = np.s_[100 // CELL, 130 // CELL : 150 // CELL]
    assert not correction.p[here].any()
    assert correction.left_alone is not None
    assert (correction.left_alone[here] == 1.0).all()
    assert (correction.left_alone[TILT_OF_CELLS > 0.03] == 0.0).mean() > 0.98


def test_cells_that_the_quadric_does_not_explain_are_left_as_the_map_reads_them() -> None:
    """A channel is dark over a patch of the hill, as beside dust."""
    values = IMAGE.values.copy()
    values[100:120, 130:150, 0] *= 0.3
    correction = read_by_quadric(replace(IMAGE, values=values), flat_map(), ALL_ALIKE)
    here = np.s_[100 // CELL : 120 // CELL, 130 // CELL : 150 // CELL]
    assert not correction.p[here].any()
    assert correction.left_alone is not None
    assert (correction.left_alone[here] == 1.0).all()


def test_a_pixel_that_is_not_known_moves_no_slope() -> None:
    values = IMAGE.values.copy()
    values[100, 140] = np.nan
    correction = read_by_quadric(replace(IMAGE, values=values), flat_map(), ALL_ALIKE)
    assert np.isfinite(correction.p).all()
    assert np.isfinite(deviations(correction)).all()


def test_in_shadow_the_correction_of_the_shadow_counts_and_what_is_not_known_of_the_map() -> None:
    own = read_by_quadric(IMAGE, flat_map(), ALL_ALIKE)
    assert own.with_shadow(None) is own
    half = np.zeros_like(own.p)
    half[:, : half.shape[1] // 2] = 1.0
    half[:, half.shape[1] // 2] = 0.25
    other = CellCorrection(0.1 * half, 0.2 * half, 0.03 * half, 0.04 * half, half, CELL, 0.1)
    both = own.with_shadow(other)
    lit, edge = half == 0.0, half == 0.25
    np.testing.assert_array_equal(both.p[lit], own.p[lit])
    np.testing.assert_array_equal(both.p[half == 1.0], other.p[half == 1.0])
    np.testing.assert_allclose(both.q[edge], 0.75 * own.q[edge] + other.q[edge], rtol=1e-6)
    np.testing.assert_array_equal(both.sigma_p, other.sigma_p)
    assert both.weight == other.weight
    assert both.unsure is own.unsure
    assert both.left_alone is not None
    assert (both.left_alone >= half).all()
    assert own.left_alone is not None
    np.testing.assert_array_equal(both.left_alone[lit], own.left_alone[lit])
