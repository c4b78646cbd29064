"""The inverse map at every pixel in one pass over memory, and over cells of pixels.

The kernel is the workstation's form of `InverseMap.gradients`. Along one row the position is a polynomial in the column
alone, so that a row first folds its own place into the coefficients. Pixels are processed in short runs
(`block_kernels`). Rows are independent: the result does not depend on the number of threads.

The mean intensity of a cell has less noise than a pixel's, by the root of its pixels. A single pixel's noise passes
through a curved map and adds to its mean slope; over a contact that sums up to height.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import CLIPPED_CONFIDENCE, LOST_EXCESS, InverseMap
from device.inverse_map.near_light import PLACE_DEGREE, rows_between_nodes
from device.inverse_map.regressor import FeatureRegressor, colour_exponents, position_exponents
from device.surface import Float32Array, GradientField, MaskArray, stereographic_size
from host_sync.denoising.frame_noise import NullColour
from host_sync.gradients.block_kernels import (
    EXCESS,
    ONE,
    PLANES,
    SLOPE,
    TRUST,
    ZERO,
    add_fourier_terms_to_u,
    begin,
    begin_at_zero,
    begin_below_rest,
    eval_regressor,
    gather_u,
    load,
    load_light,
    load_near,
    load_root,
    run_length,
    take_off_bias,
    take_off_bump,
    take_off_noise,
    take_slopes,
    take_variables,
    write_confidence,
)
from host_sync.gradients.polynomial_kernel import fourier_factor, tabled_degree, tabulated_fourier_terms, term_numbers
from host_sync.kernels.cell_rows import WHOLE_CELL, as_stored, colour_rows, means_of_cells, middles_of_cells
from host_sync.kernels.jit import njit
from host_sync.kernels.parallel_rows import parallel_rows

POWERS: Final = 3
"""Powers 0 to 2 of a position variable."""


def evaluate(
    inverse_map: InverseMap,
    image: NormalizedImage,
    null_colour: NullColour | None = None,
    shrunk: NormalizedImage | None = None,
) -> GradientField:
    """Return the slope, validity and confidence of every pixel of a full-size image, equal to the portable evaluation.

    null_colour : of the image's noise, which is taken off slopes as `NullColour.read` does
    shrunk : the image with its noise shrunk, which the null colour needs

    Raises
    ------
    CalibrationMismatch
        The image is not of the map's field.
    """
    return SlopeKernel(inverse_map, null_colour=null_colour).evaluate(image, shrunk)


class SlopeKernel:
    """An inverse map as the compiled evaluation reads it, to be used for many images.

    out : receives slopes, validity and confidence each time; None for new arrays each time
    null_colour : of the noise of images that are given with shrunk ones
    """

    def __init__(
        self, inverse_map: InverseMap, out: GradientField | None = None, null_colour: NullColour | None = None
    ) -> None:
        self._map = inverse_map
        self._out = out
        self._null_colour = None if null_colour is None else _by_output(null_colour)
        self._limit = np.float32(0.0 if null_colour is None else null_colour.limit)
        self._largest = np.float32(stereographic_size(inverse_map.steepest_read) ** 2)
        light, near, root = inverse_map.light, inverse_map.near, inverse_map.root
        self._limits = _limits(inverse_map.curve)
        self._own = _tabled(inverse_map.own, inverse_map.own_fraction)
        self._near = _NO_LIGHTS if near is None else near.field.by_powers()
        self._min_volume = np.float32(0.0 if near is None else near.field.min_volume)
        self._lit = self._own if light is None else _tabled(light.curve, light.share)
        self._root = _absent(self._own) if root is None else _tabled(root.curve, root.share)
        self._light = _DARK if light is None else _by_column(light.field.nodes, inverse_map.shape[1])
        self._rest = _by_column(-_light_at_rest(inverse_map), inverse_map.shape[1])
        bias = _NO_BIAS if inverse_map.noise_bias is None else inverse_map.noise_bias
        self._bias = _by_column(-bias, inverse_map.shape[1])
        bump = inverse_map.rest_bump
        self._bump = _DARK if bump is None else _by_column(-bump, inverse_map.shape[1])

    def evaluate(self, image: NormalizedImage, shrunk: NormalizedImage | None = None) -> GradientField:
        """As the function `evaluate`."""
        self._map.check_size(image.shape)
        out = self._out or empty_gradients(image.shape)
        quiet, null_colour = image, _NO_NULL_COLOUR
        if shrunk is not None and self._null_colour is not None:
            self._map.check_size(shrunk.shape)
            quiet, null_colour = shrunk, self._null_colour
        parallel_rows(
            _evaluate,
            image.shape,
            *as_stored(image.values),
            np.ascontiguousarray(image.valid),
            np.ascontiguousarray(image.clipped),
            self._limits,
            self._own,
            self._near,
            self._min_volume,
            self._lit,
            self._light,
            self._root,
            self._rest,
            self._bias,
            self._bump,
            *as_stored(quiet.values),
            null_colour,
            self._limit,
            self._largest,
            out.p,
            out.q,
            out.weight,
            out.valid,
        )
        return out


def empty_gradients(shape: tuple[int, int]) -> GradientField:
    """Return a gradient field of shape (H, W) for `SlopeKernel` to fill; its pixels mean nothing yet."""
    p, q, weight = (np.empty(shape, np.float32) for _ in range(3))
    return GradientField(p, q, np.empty(shape, np.bool_), weight)


class _Curve(NamedTuple):
    """A curve as the kernel reads it.

    share : its weight among the curves, 0 of a curve that is not there
    limits : float32 array of shape (5, 3): low, high, centre, 1 / scale, and 1 / spread in every channel
    degree, place : its degrees in colour, as tabled, and in position
    coefficients : by component, powers of column and row position, and colour term, times the curve's share: float32
        array of shape (2, 3, 3, M)
    waves : as `tabulated_fourier_terms` returns them
    wave_coefficients : the same of its waves, float32 array of shape (2, 3, 3, W)
    """

    share: np.float32
    limits: Float32Array
    degree: int
    place: int
    coefficients: Float32Array
    waves: Float32Array
    wave_coefficients: Float32Array


_DARK: Final = np.zeros((0, 3, 0), np.float32)
"""No light: the map has no curve that reads it."""

_NO_BIAS: Final = np.zeros((2, 2, 2), np.float32)
"""Slopes of untouched skin of a map that has none."""

_NO_NULL_COLOUR: Final = np.zeros((0, 3, 3), np.float32)
"""Nothing is known of the image's noise."""

_NO_LIGHTS: Final = np.zeros((0, 3, PLACE_DEGREE + 1, PLACE_DEGREE + 1), np.float32)
"""No directions of lights: the map has no curve that reads near lights' slopes."""


def _tabled(curve: FeatureRegressor, share: float) -> _Curve:
    numbers = term_numbers(curve.colour_degree)
    degree, monomials = tabled_degree(curve.colour_degree), len(numbers)
    table = np.zeros((2, POWERS, POWERS, len(colour_exponents(degree))), np.float32)
    waves = np.zeros((2, POWERS, POWERS, curve.waves.count), np.float32)
    for term, (i, j) in enumerate(position_exponents(curve.position_degree)):
        shared = np.float32(share) * curve.coefficients[:, term].T
        table[:, i, j, numbers] = shared[:, :monomials]
        waves[:, i, j] = np.float32(fourier_factor(curve.waves)) * shared[:, monomials:]
    own = np.float32(share), _limits(curve), degree, curve.position_degree
    return _Curve(*own, table, tabulated_fourier_terms(curve.waves), waves)


def _absent(curve: _Curve) -> _Curve:
    """Return a curve that is not there, of the types of one that is."""
    return curve._replace(share=np.float32(0.0))


def _limits(curve: FeatureRegressor) -> Float32Array:
    """Return what a curve's colours are clipped to and scaled by; see `_Curve`."""
    colours = curve.colours
    per_spread = np.full(3, 1.0 / colours.spread, np.float32)
    return np.stack([colours.low, colours.high, colours.centre, np.float32(1.0) / colours.scale, per_spread])


def _by_column(nodes: Float32Array, columns: int) -> Float32Array:
    """Return what nodes (n, m, C) hold at every column along their rows: float32 array of shape (n, C, W)."""
    across = ((2.0 * np.arange(columns) + 1.0) / columns - 1.0).astype(np.float32)
    down = np.linspace(-1.0, 1.0, len(nodes), dtype=np.float32)
    return np.ascontiguousarray(np.moveaxis(rows_between_nodes(nodes, across, down), 2, 1))


def _by_output(null_colour: NullColour) -> Float32Array:
    """Return a null colour as the kernel reads it: float32 array (5, 3, 3), first three channels, then two slopes."""
    return np.ascontiguousarray(np.moveaxis(np.concatenate([null_colour.channels, null_colour.slopes], axis=-1), -1, 0))


def _light_at_rest(inverse_map: InverseMap) -> Float32Array:
    """Return what the curve of light, its share in it, reads on untouched skin: nodes (n, m, 2)."""
    light = inverse_map.light
    return _NO_BIAS if light is None or light.at_rest is None else np.float32(light.share) * light.at_rest


@njit(cache=True, nogil=True)
def _evaluate(
    values: Float32Array, by_plane: bool, usable: MaskArray, clipped: MaskArray, limits: Float32Array,
    own: _Curve, near: Float32Array, min_volume: np.float32, lit: _Curve, light: Float32Array, root: _Curve,
    rest: Float32Array, bias: Float32Array, bump: Float32Array,
    quiet: Float32Array, quiet_by_plane: bool, null_colour: Float32Array, limit: np.float32, largest: np.float32,
    p: Float32Array, q: Float32Array, weight: Float32Array, valid: MaskArray, first: int, last: int,
) -> None:  # fmt: skip
    """Fill the rows `first` to `last` - 1 of p, q, weight, valid.

    limits : of the training domain
    near : directions of lights for a curve `own` that reads near lights' slopes, or empty: it reads intensity
    min_volume : of these directions
    light : by places and columns for the curve `lit`, or empty
    root : the curve that reads the root of intensity
    rest : minus what the curve `lit`, its share in it, reads on untouched skin, by places and columns
    bias : minus what noise adds to the curves' mean, likewise
    bump : minus what they read where intensity is 1, likewise, or empty: nothing
    quiet, quiet_by_plane : the image with its noise shrunk
    null_colour, limit : of that noise, as of `_by_output`, or empty: noise stays
    largest : square of the stereographic slope that no pixel's exceeds
    """
    rows, columns = p.shape
    length = run_length(columns)
    rooted = root.share > ZERO
    curves = 1 + int(len(light) > 0) + int(rooted)
    run, spare = np.empty((PLANES, length), np.float32), np.empty((2, 3, length), np.float32)
    for row in range(first, last):
        down = np.float32((2.0 * row + 1.0) / rows - 1.0)
        along, light_along = _at_row(own.coefficients, down), _at_row(lit.coefficients, down)
        waves_along, light_waves_along = _at_row(own.wave_coefficients, down), _at_row(lit.wave_coefficients, down)
        root_along, root_waves_along = _at_row(root.coefficients, down), _at_row(root.wave_coefficients, down)
        near_along = _directions_at_row(near, down)
        for start in range(0, columns, length):
            end = min(start + length, columns)
            part = slice(start, end)
            seen = colour_rows(values, by_plane, row, start, end, spare[0])
            begin(start, columns, run)
            if len(light):
                top, share = _between(down, len(rest))
                begin_below_rest(start, rest[top], rest[top + 1], share, run)
                top, share = _between(down, len(light))
                load_light(seen, start, light[top], light[top + 1], share, run)
                take_variables(run, lit.limits)
                eval_regressor(run, lit.degree, lit.place, light_along)
                add_fourier_terms_to_u(run, lit.waves, light_waves_along)
                gather_u(run, lit.share, True)
            if rooted:
                begin_at_zero(run)
                load_root(seen, run)
                take_variables(run, root.limits)
                eval_regressor(run, root.degree, root.place, root_along)
                add_fourier_terms_to_u(run, root.waves, root_waves_along)
                gather_u(run, root.share, len(light) == 0)
            begin_at_zero(run)
            if len(near):
                load_near(seen, near_along, min_volume, run)
            else:
                load(seen, run)
            take_variables(run, own.limits)
            eval_regressor(run, own.degree, own.place, along)
            add_fourier_terms_to_u(run, own.waves, waves_along)
            gather_u(run, own.share, curves == 1)
            if len(near):
                load(seen, run)
                take_variables(run, limits)
            write_confidence(run, curves)
            if len(bump):
                top, share = _between(down, len(bump))
                take_off_bump(seen, start, bump[top], bump[top + 1], share, run)
            top, share = _between(down, len(bias))
            take_off_bias(start, bias[top], bias[top + 1], share, run)
            if len(null_colour):
                shrunk = colour_rows(quiet, quiet_by_plane, row, start, end, spare[1])
                take_off_noise(
                    seen, shrunk, null_colour[..., 0] + down * null_colour[..., 2], null_colour[..., 1], limit, run
                )
            take_slopes(run, largest)
            _store(
                run, usable[row, part], clipped[row, part], p[row, part], q[row, part], weight[row, part],
                valid[row, part],
            )  # fmt: skip


@njit(cache=True)
def _between(down: np.float32, count: int) -> tuple[int, np.float32]:
    """Return the index of the node before a row's position variable, and the fraction of the way to the next.

    count : of nodes, even over the field
    """
    at = (down + ONE) * np.float32(0.5 * (count - 1))
    before = min(int(at), count - 2)
    return before, at - np.float32(before)


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
    """Return coefficients at one row: float32 array of shape (2, 3, M) by powers of the column's position."""
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
    """Return directions of lights at one row: float32 array of shape (2, 3, 4) by powers of the column, or empty."""
    along = near[..., 0].copy()
    power = ONE
    for j in range(1, near.shape[3]):
        power *= down
        along += power * near[..., j]
    return along


def cell_slopes(image: NormalizedImage, inverse_map: InverseMap, cell: int) -> GradientField:
    """Return the slopes of cells of `cell` x `cell` pixels, shape (h, w).

    Beyond the field its last row and column are repeated. A cell of which more than a thousandth is invalid is invalid:
    its slope and weight are 0.
    """
    size = -(-image.shape[0] // cell), -(-image.shape[1] // cell)
    valid = means_of_cells(image.valid.astype(np.float32)[..., None], size, cell)[..., 0] > WHOLE_CELL
    row, column = middles_of_cells(size, cell)
    means = np.nan_to_num(means_of_cells(image.values, size, cell), nan=1.0).astype(np.float32)
    slopes = np.where(valid[..., None], inverse_map.on_grid(means, column, row), np.float32(0.0))
    p, q = (np.ascontiguousarray(slopes[..., axis]) for axis in (0, 1))
    return GradientField(p, q, valid, valid.astype(np.float32))
