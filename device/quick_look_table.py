"""The inverse map as tables: what the handheld looks slopes up in, one gather a table instead of hundreds of products.

The stereographic slope u (see `inverse_map`) is tabulated over quantised intensity, one table for every term of a
polynomial in position, and the tables are summed at each pixel:

    u(I, x, y) = Σ_k T_k(bin of I) x^i(k) y^j(k)

A single table of colour alone would throw position away. Bins are even in intensity, in which a diffuse skin is nearly
linear, and lie so that a flat, untouched skin (intensity 1) is a bin's centre: it reads as flat as the map itself reads
it. Elsewhere a bin's width shows as noise of a few tenths of a degree (tests/device/test_quick_look_table.py).

Only the map's curve of intensity is tabulated, from its slopes at a few intensities and places, between which it is
interpolated: a second curve would take the time of a second table, and change little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from device.colour_space import DARK_OFFSET, ColourSpace
from device.inverse_map import CLIPPED_CONFIDENCE, LOST_EXCESS, TRUSTED_EXCESS, InverseMap
from device.photometry import IntensityImage
from device.polynomials import field_position, monomials, position_exponents
from device.surface import Float32Array, Float64Array, GradientField, MaskArray

BINS: Final = 64
"""Bins a channel: 6 tables of 2 MB, few of whose lines a frame touches."""

POSITION_DEGREE: Final = 2
NODES: Final = 13
"""Intensities a channel at which the map is asked, even in their logarithm."""

PLACES: Final = 4
"""Places along each side of the field at which the map is asked."""

NEGLIGIBLE: Final = 1e-5
"""A term of position that nowhere adds more slope than this is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class SlopeTable:
    """An inverse map tabulated for images of one size.

    colours : the map's colour space, asked only for how far an intensity lies outside it
    first, per_bin : float32 arrays of shape (3,), intensity of the first bin's centre and bins per unit of intensity
    kept : which terms of position are there
    terms : for each term of position its table of u, float32 array of shape (BINS³, 2)
    places : for each term its value at every pixel, once for each component of u: float32 array of shape (H, 2 W)
    """

    colours: ColourSpace
    first: Float32Array
    per_bin: Float32Array
    kept: tuple[int, ...]
    terms: tuple[Float32Array, ...]
    places: tuple[Float32Array, ...]

    @classmethod
    def of(cls, inverse_map: InverseMap, binning: int) -> SlopeTable:
        """The tables of a map, for images binned by `binning`."""
        low, high = inverse_map.curve.colours.intensity_range()
        width = (high - low) / (BINS - 1)
        first = 1.0 - np.round((1.0 - low) / width) * width
        centres = first + width * np.arange(BINS)[:, None]
        terms = _tables(inverse_map, low, high, centres)
        places = _place_terms(inverse_map.shape, binning)
        kept = [k for k, term in enumerate(terms) if np.abs(term).max() > NEGLIGIBLE or k == 0]
        return cls(
            inverse_map.curve.colours,
            first.astype(np.float32),
            (1.0 / width).astype(np.float32),
            tuple(kept),
            tuple(np.ascontiguousarray(terms[k].T) for k in kept),
            tuple(places[k] for k in kept),
        )

    def resized(self, shape: tuple[int, int], binning: int) -> SlopeTable:
        """The same tables for images of a full-size field of `shape` (H, W) that are binned by `binning`."""
        places = _place_terms(shape, binning)
        return replace(self, places=tuple(places[k] for k in self.kept))

    def gradients(self, image: IntensityImage) -> GradientField:
        """Slope, validity and relative confidence of every pixel, as the map itself would give them."""
        index, outside = self._bins(image.values)
        u = self._sum(index)
        p, q = u[:, 0::2], u[:, 1::2]
        scale: Float32Array = np.minimum(p * p + q * q, np.float32(3.61))
        scale *= np.float32(-0.25)
        scale += np.float32(1.0)
        valid, weight = self._trust(image, outside)
        return GradientField(np.divide(p, scale), np.divide(q, scale), valid, weight)

    def _bins(self, values: Float32Array) -> tuple[NDArray[np.intp], MaskArray]:
        """Index into a table, and True in the outermost bins and beyond; arrays of shape (H, W)."""
        index = np.zeros(values.shape[:2], np.intp)
        outside = np.zeros(values.shape[:2], np.bool_)
        last = np.float32(BINS - 1)
        for channel in range(3):
            at = (values[..., channel] - self.first[channel]) * self.per_bin[channel]
            outside |= (at < 1.0) | (at > last - 1.0)
            np.clip(at, np.float32(0.0), last, out=at)
            at += np.float32(0.5)
            index *= BINS
            index += at.astype(np.int32)
        return index, outside

    def _sum(self, index: NDArray[np.intp]) -> Float32Array:
        """Both components of u side by side: float32 array of shape (H, 2 W)."""
        total = np.zeros(self.places[0].shape, np.float32)
        pairs = np.empty(index.shape, np.float64)
        for table, place in zip(self.terms, self.places, strict=True):
            # One gather brings both components when they pass for one number of 64 bits.
            np.take(table.view(np.float64)[:, 0], index, out=pairs, mode="clip")
            looked_up = pairs.view(np.float32)
            looked_up *= place
            total += looked_up
        return total

    def _trust(self, image: IntensityImage, outside: MaskArray) -> tuple[MaskArray, Float32Array]:
        """Validity and confidence; only the outermost bins and beyond can lie outside the calibrated colours."""
        valid = image.valid.copy()
        weight = np.where(image.clipped, np.float32(CLIPPED_CONFIDENCE), np.float32(1.0))
        if outside.any():
            _, excess = self.colours.variables(image.values[outside])
            valid[outside] &= excess < LOST_EXCESS
            weight[outside] /= (1.0 + (excess / np.float32(TRUSTED_EXCESS)) ** 2) ** 2
        weight *= valid
        return valid, weight


def _tables(inverse_map: InverseMap, low: Float64Array, high: Float64Array, centres: Float64Array) -> Float32Array:
    """Coefficients of u in position at every bin: float32 array of shape (K, 2, BINS³)."""
    logs = np.log(np.stack([low, high]) + DARK_OFFSET)
    nodes = np.linspace(logs[0], logs[1], NODES)
    asked = np.stack(np.meshgrid(*(np.exp(nodes) - DARK_OFFSET).T, indexing="ij"), axis=-1).reshape(-1, 3)
    tables = _position_coefficients(inverse_map, asked.astype(np.float32)).reshape(NODES, NODES, NODES, -1)
    at = np.clip(np.log(np.maximum(centres, 0.0) + DARK_OFFSET), logs[0], logs[1])
    for channel in range(3):
        spread = CubicSpline(nodes[:, channel], np.eye(NODES))(at[:, channel])
        tables = np.tensordot(tables, spread, axes=(0, 1))  # the first axis goes in, its bins come out last
    return tables.reshape(-1, 2, BINS**3).astype(np.float32)


def _position_coefficients(inverse_map: InverseMap, intensity: Float32Array) -> Float64Array:
    """Least-squares coefficients of u over the field, float64 array of shape (N, K, 2), at N intensities (N, 3)."""
    at = (np.arange(PLACES) + 0.5) * (2.0 / PLACES) - 1.0
    places = np.stack([axis.ravel() for axis in np.meshgrid(at, at)], axis=-1)
    u = np.stack([inverse_map.curve.at(intensity, np.tile(place, (len(intensity), 1))) for place in places])
    basis = monomials(places, POSITION_DEGREE)
    return np.asarray(np.tensordot(np.linalg.pinv(basis), u, axes=1).transpose(1, 0, 2))


def _place_terms(full: tuple[int, int], binning: int) -> list[Float32Array]:
    """Every position monomial at the centres of binned pixels of a field `full` (H, W): float32 arrays (h, 2 w)."""
    shape = (full[0] // binning, full[1] // binning)
    column, row = (np.arange(size) * binning + 0.5 * (binning - 1) for size in shape[::-1])
    across = field_position(column, np.zeros_like(column), full)[:, 0]
    down = field_position(np.zeros_like(row), row, full)[:, 1]
    twice = np.repeat(across, 2)
    return [np.outer(down**j, twice**i).astype(np.float32) for i, j in position_exponents(POSITION_DEGREE)]
