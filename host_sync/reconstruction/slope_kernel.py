"""The inverse map at every pixel in one pass over memory: the workstation's form of `InverseMap.gradients`.

Along one row the position is a polynomial in the column alone, so that a row first folds its own place into the
coefficients. Pixels are taken in short runs (`slope_run`). Rows are independent: the result is the same with any number
of threads.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from device.inverse_map import CLIPPED_CONFIDENCE, LOST_EXCESS, InverseMap
from device.light_field import LightField
from device.photometry import IntensityImage
from device.polynomials import colour_exponents, position_exponents
from device.slope_curve import SlopeCurve
from device.surface import Float32Array, GradientField, MaskArray
from host_sync.reconstruction.colour_planes import as_stored, colour_rows
from host_sync.reconstruction.colour_polynomial import tabled_degree, term_numbers
from host_sync.reconstruction.row_bands import in_bands
from host_sync.reconstruction.slope_run import (
    EXCESS,
    ONE,
    PLANES,
    SLOPE,
    TRUST,
    ZERO,
    add_waves_to_u,
    begin,
    load,
    load_light,
    load_near,
    run_length,
    take_slopes,
    take_trust,
    take_u,
    take_variables,
)
from host_sync.reconstruction.wave_run import tabled_waves, wave_factor

POWERS: Final = 3
"""Powers 0 to 2 of a position variable."""


def evaluate(inverse_map: InverseMap, image: IntensityImage) -> GradientField:
    """Slope, validity and confidence of every pixel of a full-size image, equal to the portable evaluation.

    Raises
    ------
    CalibrationMismatch
        The image is not of the map's field.
    """
    return SlopeKernel(inverse_map).evaluate(image)


class SlopeKernel:
    """An inverse map as the compiled evaluation reads it, to be used for many images.

    out : receives slopes, validity and confidence each time; None for new arrays each time
    """

    def __init__(self, inverse_map: InverseMap, out: GradientField | None = None) -> None:
        self._map = inverse_map
        self._out = out
        light = inverse_map.light
        share = 0.0 if light is None else light.share
        near = inverse_map.near
        self._limits = _limits(inverse_map.curve)
        self._own = _tabled(inverse_map.own, 1.0 - share)
        self._near = _NO_LIGHTS if near is None else near.field.by_powers()
        self._lit = self._own if light is None else _tabled(light.curve, share)
        self._light = _DARK if light is None else _light_by_column(light.field, inverse_map.shape[1])

    def evaluate(self, image: IntensityImage) -> GradientField:
        """As the function `evaluate`."""
        self._map.check_size(image.shape)
        out = self._out or empty_gradients(image.shape)
        in_bands(
            _evaluate,
            image.shape,
            *as_stored(image.values),
            np.ascontiguousarray(image.valid),
            np.ascontiguousarray(image.clipped),
            self._limits,
            self._own,
            self._near,
            self._lit,
            self._light,
            out.p,
            out.q,
            out.weight,
            out.valid,
        )
        return out


def empty_gradients(shape: tuple[int, int]) -> GradientField:
    """A gradient field of shape (H, W) for `SlopeKernel` to fill; its pixels mean nothing yet."""
    p, q, weight = (np.empty(shape, np.float32) for _ in range(3))
    return GradientField(p, q, np.empty(shape, np.bool_), weight)


class _Curve(NamedTuple):
    """A curve as the kernel reads it.

    limits : float32 array of shape (5, 3): low, high, centre, 1 / scale, and 1 / spread in every channel
    degree, place : its degrees in colour, as tabled, and in position
    coefficients : by component, powers of column and row position, and colour term, times the curve's share: float32
        array of shape (2, 3, 3, M)
    waves : as `tabled_waves` returns them
    wave_coefficients : the same of its waves, float32 array of shape (2, 3, 3, W)
    """

    limits: Float32Array
    degree: int
    place: int
    coefficients: Float32Array
    waves: Float32Array
    wave_coefficients: Float32Array


_DARK: Final = np.zeros((0, 3, 0), np.float32)
"""No light: the map has no curve that reads it."""

_NO_LIGHTS: Final = np.zeros((0, 3, POWERS, POWERS), np.float32)
"""No directions of lights: the map has no curve that reads near lights' slopes."""


def _tabled(curve: SlopeCurve, share: float) -> _Curve:
    numbers = term_numbers(curve.colour_degree)
    degree, monomials = tabled_degree(curve.colour_degree), len(numbers)
    table = np.zeros((2, POWERS, POWERS, len(colour_exponents(degree))), np.float32)
    waves = np.zeros((2, POWERS, POWERS, curve.waves.count), np.float32)
    for term, (i, j) in enumerate(position_exponents(curve.position_degree)):
        own = np.float32(share) * curve.coefficients[:, term].T
        table[:, i, j, numbers] = own[:, :monomials]
        waves[:, i, j] = np.float32(wave_factor(curve.waves)) * own[:, monomials:]
    return _Curve(_limits(curve), degree, curve.position_degree, table, tabled_waves(curve.waves), waves)


def _limits(curve: SlopeCurve) -> Float32Array:
    """What a curve's colours are clipped to and scaled by; see `_Curve`."""
    colours = curve.colours
    per_spread = np.full(3, 1.0 / colours.spread, np.float32)
    return np.stack([colours.low, colours.high, colours.centre, np.float32(1.0) / colours.scale, per_spread])


def _light_by_column(field: LightField, columns: int) -> Float32Array:
    """Light at every column along the rows of its places: float32 array of shape (n, 3, W)."""
    across = ((2.0 * np.arange(columns) + 1.0) / columns - 1.0).astype(np.float32)
    down = np.linspace(-1.0, 1.0, len(field.nodes), dtype=np.float32)
    return np.ascontiguousarray(np.moveaxis(field.rows(across, down), 2, 1))


@njit(cache=True, nogil=True)
def _evaluate(
    values: Float32Array, by_plane: bool, usable: MaskArray, clipped: MaskArray, limits: Float32Array,
    own: _Curve, near: Float32Array, lit: _Curve, light: Float32Array,
    p: Float32Array, q: Float32Array, weight: Float32Array, valid: MaskArray, first: int, last: int,
) -> None:  # fmt: skip
    """Fill the rows `first` to `last` - 1 of p, q, weight, valid.

    limits : of the colours that tell whether the balls taught a pixel
    near : directions of lights for a curve `own` that reads near lights' slopes, or empty: it reads intensity
    light : by places and columns for the curve `lit`, or empty
    """
    rows, columns = p.shape
    length = run_length(columns)
    run, spare = np.empty((PLANES, length), np.float32), np.empty((3, length), np.float32)
    for row in range(first, last):
        down = np.float32((2.0 * row + 1.0) / rows - 1.0)
        along, light_along = _at_row(own.coefficients, down), _at_row(lit.coefficients, down)
        waves_along, light_waves_along = _at_row(own.wave_coefficients, down), _at_row(lit.wave_coefficients, down)
        near_along = _directions_at_row(near, down)
        for start in range(0, columns, length):
            end = min(start + length, columns)
            part = slice(start, end)
            seen = colour_rows(values, by_plane, row, start, end, spare)
            begin(start, columns, run)
            if len(light):
                at = (down + ONE) * np.float32(0.5 * (len(light) - 1))
                top = min(int(at), len(light) - 2)
                share = at - np.float32(top)
                load_light(seen, start, light[top], light[top + 1], share, run)
                take_variables(run, lit.limits)
                take_u(run, lit.degree, lit.place, light_along, False)
                add_waves_to_u(run, lit.waves, light_waves_along)
            if len(near):
                load_near(seen, near_along, run)
            else:
                load(seen, run)
            take_variables(run, own.limits)
            take_u(run, own.degree, own.place, along, len(light) > 0)
            add_waves_to_u(run, own.waves, waves_along)
            if len(near):
                load(seen, run)
                take_variables(run, limits)
            take_slopes(run)
            take_trust(run)
            _store(
                run, usable[row, part], clipped[row, part], p[row, part], q[row, part], weight[row, part],
                valid[row, part],
            )  # fmt: skip


@njit(cache=True)
def _store(run: Any, usable: Any, clipped: Any, p: Any, q: Any, weight: Any, valid: Any) -> None:
    """Write what came out for the pixels of a run."""
    across, down, excess, trust = run[SLOPE], run[SLOPE + 1], run[EXCESS], run[TRUST]
    for k in range(p.size):
        p[k] = across[k]
        q[k] = down[k]
    for k in range(valid.size):
        valid[k] = usable[k] & (excess[k] < np.float32(LOST_EXCESS))
    for k in range(weight.size):
        known = trust[k] if valid[k] else ZERO
        weight[k] = known * np.float32(CLIPPED_CONFIDENCE) if clipped[k] else known


@njit(cache=True)
def _at_row(coefficients: Float32Array, down: np.float32) -> Float32Array:
    """Coefficients at one row: float32 array of shape (2, 3, M) by powers of the column's position."""
    components, powers, _, terms = coefficients.shape
    along = np.zeros((components, powers, terms), np.float32)
    for component in range(components):
        for i in range(powers):
            power = ONE
            for j in range(powers):
                for term in range(terms):
                    along[component, i, term] += power * coefficients[component, i, j, term]
                power *= down
    return along


@njit(cache=True)
def _directions_at_row(near: Float32Array, down: np.float32) -> Float32Array:
    """Directions of lights at one row: float32 array of shape (2, 3, 3) by powers of the column, or empty."""
    along = near[..., 0].copy()
    power = ONE
    for j in range(1, near.shape[3]):
        power *= down
        along += power * near[..., j]
    return along
