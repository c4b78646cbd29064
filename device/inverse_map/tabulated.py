"""The inverse map as tables: what the handheld looks slopes up in, one gather a table instead of hundreds of products.

The stereographic slope u (see `inverse_map`) is tabulated over quantised intensity, one table for every term of a
polynomial in position, and the tables are summed at each pixel:

    u(I, x, y) = Σ_k T_k(bin of I) x^i(k) y^j(k)

A single table of colour alone would throw position away. Bins are even in intensity, in which a diffuse skin is nearly
linear, and lie so that a flat, untouched skin (intensity 1) is a bin's centre: it reads as flat as the map itself reads
it. Elsewhere a bin's width shows as noise of a few tenths of a degree (tests/device/inverse_map/test_tabulated.py).

Only the map's curve of intensity is tabulated, from its slopes at a few intensities and places, between which it is
interpolated: a second curve would take the time of a second table, and change little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import CLIPPED_CONFIDENCE, LOST_EXCESS, TRUSTED_EXCESS, InverseMap
from device.inverse_map.regressor import (
    DARK_OFFSET,
    FeatureScaler,
    blocks_of,
    field_position,
    monomials,
    position_exponents,
)
from device.surface import Float32Array, Float64Array, GradientField, MaskArray, stereographic_size

BINS: Final = 64
"""Bins a channel: 6 tables of 2 MB, few of whose lines a frame touches."""

POSITION_DEGREE: Final = 2
NODES: Final = 13
"""Intensities a channel at which the map is asked, even in their logarithm."""

PLACES: Final = 4
"""Places along each side of the field at which the map is asked."""

BAND_ROWS: Final = 64
"""So many rows are looked up at a time: what stands between two steps then stays in the second-level cache."""

NEGLIGIBLE: Final = 1e-5
"""A term of position that nowhere adds more slope than this is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedInverseMap:
    """An inverse map tabulated for images of one size.

    colours : the map's colour space, asked only for how far an intensity lies outside it
    first, per_bin : float32 arrays of shape (3,), intensity of the first bin's centre and bins per unit of intensity
    kept : powers of the column's and of the row's position in each term that is there
    terms : for each of them its table of u, float32 array of shape (BINS³, 2)
    across : powers of the columns' position, each column once for either component of u: float32 array (K, 2 W)
    down : powers of the rows' position, float32 array of shape (K, H, 1)
    steepest : slope that no pixel's exceeds
    """

    colours: FeatureScaler
    first: Float32Array
    per_bin: Float32Array
    kept: tuple[tuple[int, int], ...]
    terms: tuple[Float32Array, ...]
    across: Float32Array
    down: Float32Array
    steepest: float

    @classmethod
    def of(cls, inverse_map: InverseMap, binning: int) -> TabulatedInverseMap:
        """Return the tables of a map, for images binned by `binning`."""
        low, high = inverse_map.curve.colours.intensity_range()
        width = (high - low) / (BINS - 1)
        first = 1.0 - np.round((1.0 - low) / width) * width
        centres = first + width * np.arange(BINS)[:, None]
        terms = _tables(inverse_map, low, high, centres)
        kept = [k for k, term in enumerate(terms) if np.abs(term).max() > NEGLIGIBLE or k == 0]
        return cls(
            inverse_map.curve.colours,
            first.astype(np.float32),
            (1.0 / width).astype(np.float32),
            tuple(position_exponents(POSITION_DEGREE)[k] for k in kept),
            tuple(np.ascontiguousarray(terms[k].T) for k in kept),
            *_place_powers(inverse_map.shape, binning),
            inverse_map.steepest_read,
        )

    def resized(self, shape: tuple[int, int], binning: int) -> TabulatedInverseMap:
        """Return the tables for images of a full-size field of `shape` (H, W) that are binned by `binning`."""
        across, down = _place_powers(shape, binning)
        return replace(self, across=across, down=down)

    def gradients(self, image: NormalizedImage) -> GradientField:
        """Return the slope, validity and relative confidence of every pixel, as the map itself would give them."""
        p, q = (np.empty(image.shape, np.float32) for _ in range(2))
        outside = np.empty(image.shape, np.bool_)
        largest = np.float32(stereographic_size(self.steepest) ** 2)
        for band in blocks_of(len(p), BAND_ROWS):
            index, outside[band] = self._bins(image.values[band])
            u = self._sum(index, self.down[:, band])
            square = u * u
            scale: Float32Array = square[:, 0::2] + square[:, 1::2]
            steep = np.flatnonzero(scale > largest)
            beyond = np.sqrt(scale.flat[steep] / largest)
            np.minimum(scale, largest, out=scale)
            scale *= np.float32(-0.25)
            scale += np.float32(1.0)
            scale.flat[steep] *= beyond  # these keep their direction
            np.divide(u[:, 0::2], scale, out=p[band])
            np.divide(u[:, 1::2], scale, out=q[band])
        valid, weight = self._trust(image, outside)
        return GradientField(p, q, valid, weight)

    def _bins(self, values: Float32Array) -> tuple[NDArray[np.intp], MaskArray]:
        """Return the index into a table, and True in the outermost bins and beyond; arrays of shape (H, W)."""
        number = np.zeros(values.shape[:2], np.int32)
        outside = np.zeros(values.shape[:2], np.bool_)
        last = np.float32(BINS - 1)
        for channel in range(3):
            at = values[..., channel] - self.first[channel]
            at *= self.per_bin[channel]
            outside |= (at < 1.0) | (at > last - 1.0)
            np.clip(at, np.float32(0.0), last, out=at)
            at += np.float32(0.5)
            number *= BINS
            number += at.astype(np.int32)
        return number.astype(np.intp), outside

    def _sum(self, index: NDArray[np.intp], down: Float32Array) -> Float32Array:
        """Return both components of u side by side: float32 array of shape (H, 2 W); `down` of these rows."""
        total = np.zeros((index.shape[0], 2 * index.shape[1]), np.float32)
        pairs = np.empty(index.shape, np.float64)
        looked_up = pairs.view(np.float32)
        for table, (i, j) in zip(self.terms, self.kept, strict=True):
            # One gather brings both components when they pass for one number of 64 bits.
            np.take(table.view(np.float64)[:, 0], index, out=pairs, mode="clip")
            if i:
                looked_up *= self.across[i]
            if j:
                looked_up *= down[j]
            total += looked_up
        return total

    def _trust(self, image: NormalizedImage, outside: MaskArray) -> tuple[MaskArray, Float32Array]:
        """Return the validity and the confidence of every pixel.

        Only colours in the outermost bins and beyond can lie outside the calibrated ones.
        """
        valid = image.valid.copy()
        weight = np.where(image.clipped, np.float32(CLIPPED_CONFIDENCE), np.float32(1.0))
        if outside.any():
            _, excess = self.colours.variables(image.values[outside])
            valid[outside] &= excess < LOST_EXCESS
            weight[outside] /= (1.0 + (excess / np.float32(TRUSTED_EXCESS)) ** 2) ** 2
        weight *= valid
        return valid, weight


def _tables(inverse_map: InverseMap, low: Float64Array, high: Float64Array, centres: Float64Array) -> Float32Array:
    """Return coefficients of u in position at every bin: float32 array of shape (K, 2, BINS³)."""
    logs = np.log(np.stack([low, high]) + DARK_OFFSET)
    nodes = np.linspace(logs[0], logs[1], NODES)
    asked = np.stack(np.meshgrid(*(np.exp(nodes) - DARK_OFFSET).T, indexing="ij"), axis=-1).reshape(-1, 3)
    tables = _position_coefficients(inverse_map, asked.astype(np.float32)).reshape(NODES, NODES, NODES, -1)
    at = np.clip(np.log(np.maximum(centres, 0.0) + DARK_OFFSET), logs[0], logs[1])
    for channel in range(3):
        spread = spline_weights((at[:, channel] - logs[0, channel]) / (nodes[1] - nodes[0])[channel], NODES)
        tables = np.tensordot(tables, spread, axes=(0, 1))  # the first axis goes in, its bins come out last
    return tables.reshape(-1, 2, BINS**3).astype(np.float32)


def spline_weights(at: Float64Array, nodes: int) -> Float64Array:
    """Return the weight of each of `nodes` even nodes in the cubic spline through them: float64 array (N, nodes).

    Its ends are "not-a-knot". scipy.interpolate gives the same, but takes a third of the start to import.

    at : places in steps from the first node, float64 array of shape (N,)
    """
    values = np.eye(nodes)
    system = np.diag(np.full(nodes, 4.0)) + np.eye(nodes, k=1) + np.eye(nodes, k=-1)
    system[0, :3] = system[-1, -3:] = (1.0, -2.0, 1.0)
    bends = np.zeros((nodes, nodes))
    bends[1:-1] = 6.0 * np.diff(values, 2, axis=0)
    second = np.linalg.solve(system, bends)
    left = np.clip(np.floor(at).astype(np.intp), 0, nodes - 2)
    after = (at - left)[:, None]
    before = 1.0 - after
    straight = before * values[left] + after * values[left + 1]
    return np.asarray(straight + ((before**3 - before) * second[left] + (after**3 - after) * second[left + 1]) / 6.0)


def _position_coefficients(inverse_map: InverseMap, intensity: Float32Array) -> Float64Array:
    """Return the least-squares coefficients of u over the field, float64 array (N, K, 2), at N intensities (N, 3)."""
    at = (np.arange(PLACES) + 0.5) * (2.0 / PLACES) - 1.0
    places = np.stack([axis.ravel() for axis in np.meshgrid(at, at)], axis=-1)
    u = np.stack([inverse_map.curve.at(intensity, np.tile(place, (len(intensity), 1))) for place in places])
    basis = monomials(places, POSITION_DEGREE)
    return np.asarray(np.tensordot(np.linalg.pinv(basis), u, axes=1).transpose(1, 0, 2))


def _place_powers(full: tuple[int, int], binning: int) -> tuple[Float32Array, Float32Array]:
    """Return powers of the positions of binned columns and rows of a field `full` (H, W), as a table keeps them."""
    shape = (full[0] // binning, full[1] // binning)
    column, row = (np.arange(size) * binning + 0.5 * (binning - 1) for size in shape[::-1])
    across = np.repeat(field_position(column, np.zeros_like(column), full)[:, 0], 2)
    down = field_position(np.zeros_like(row), row, full)[:, 1, None]
    powers = range(POSITION_DEGREE + 1)
    first, second = (np.stack([place**i for i in powers]).astype(np.float32) for place in (across, down))
    return first, second
