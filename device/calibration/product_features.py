"""Features of a curve at the pixels of balls, and the normal equations of their fit, without a table of all of them.

A feature is a term of colour times a monomial of place. Products of two features of a polynomial are monomials of
colour times monomials of place again, of twice the degree: their sums over pixels, a few thousand, are all that a Gram
matrix of a hundred thousand elements holds, for a tenth of the work.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.inverse_map.regressor import (
    RandomFourierFeatures,
    blocks_of,
    colour_exponents,
    colour_rows,
    monomial_rows,
    position_exponents,
    sum_of_products,
)
from device.surface import Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class ProductFeatures:
    """The features of one form at pixels, F of them: every term of colour times every monomial of place.

    colours : float64 array of shape (N, 3), variables of colour
    place : float64 array of shape (N, 2), position variables
    colour_degree, position_degree, waves : which terms there are, as `FeatureRegressor` has them
    scale : float64 array of shape (F,), by which features are multiplied
    rest : variables of colour of untouched skin, whose features are taken off: float64 array of shape (1, 3) where they
        are alike everywhere, else (N, 3); None where nothing is taken off
    kept : sums over pixels, by a digest of what they are of, for forms that differ in scale alone, or in a rest that is
        alike everywhere; None where nothing is kept
    """

    colours: Float64Array
    place: Float64Array
    colour_degree: int
    position_degree: int
    waves: RandomFourierFeatures
    scale: Float64Array
    rest: Float64Array | None
    kept: MutableMapping[bytes, Float64Array] | None = None

    def normal_equations(
        self, rows: NDArray[np.intp], weight: Float64Array, wanted: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the Gram matrix (F, F) and moments (F, C) of the pixels `rows`.

        weight : shape (N,)
        wanted : values to fit, shape (N, C)
        """
        if not self.waves.count and (self.rest is None or len(self.rest) == 1):
            gram, moment = self._of_sums(rows, weight, wanted)
        elif self.kept is None or self.waves.count:  # no other form has the same waves
            gram, moment = self._summed(rows, weight, wanted)
        else:
            gram, moment = self._kept_summed(self.kept, rows, weight, wanted)
        gram *= self.scale
        gram *= self.scale[:, None]
        return gram, moment * self.scale[:, None]

    def times(self, rows: NDArray[np.intp], coefficients: Float64Array) -> Float64Array:
        """Return what coefficients (F, C) make of the features of pixels `rows`: float64 array of shape (n, C)."""
        places, columns = len(position_exponents(self.position_degree)), coefficients.shape[1]
        scaled = (coefficients * self.scale[:, None]).reshape(-1, places, columns)
        found = np.empty((len(rows), columns))
        for at in blocks_of(len(rows)):
            place = monomial_rows(self.place[rows[at]].T, self.position_degree)
            found[at] = sum_of_products(self._terms(rows[at]), place, scaled)
        return found

    def powers(self, rows: NDArray[np.intp], matrix: Float64Array) -> Float64Array:
        """|φᵀ M|² of a matrix M (F, C) and the features φ of pixels `rows`: float64 array of shape (n,)."""
        scaled, found = self.scale[:, None] * matrix, np.empty(len(rows))
        for at in blocks_of(len(rows)):
            found[at] = ((self._plain(rows[at]) @ scaled) ** 2).sum(axis=1)
        return found

    def table(self) -> Float64Array:
        """Return all features of all pixels, float64 array of shape (N, F)."""
        return self.scale * self._plain(np.arange(len(self.place)))

    def _plain(self, rows: NDArray[np.intp]) -> Float64Array:
        """Return features before they are scaled, float64 array of shape (n, F)."""
        place = np.ascontiguousarray(monomial_rows(self.place[rows].T, self.position_degree).T)
        terms = np.ascontiguousarray(self._terms(rows).T)
        return np.asarray((terms[:, :, None] * place[:, None, :]).reshape(len(rows), -1))

    def _terms(self, rows: NDArray[np.intp]) -> Float64Array:
        """Return terms of colour less those of untouched skin: float64 array of shape (M, n)."""
        terms = self._colour_terms(self.colours[rows])
        if self.rest is not None:
            terms -= self._colour_terms(self.rest if len(self.rest) == 1 else self.rest[rows])
        return terms

    def _colour_terms(self, colours: Float64Array) -> Float64Array:
        return colour_rows(colours.T, self.colour_degree, self.waves)

    def _summed(
        self, rows: NDArray[np.intp], weight: Float64Array, wanted: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the normal equations, not scaled, block by block of pixels."""
        count = len(self.scale)
        gram, moment = np.zeros((count, count)), np.zeros((count, wanted.shape[1]))
        for at in blocks_of(len(rows)):
            root = np.sqrt(weight[rows[at], None])
            # Both sides of a Gram matrix are one array, so that half of it need not be computed.
            features = self._plain(rows[at])
            features *= root
            gram += features.T @ features
            moment += features.T @ (root * wanted[rows[at]])
        return gram, moment

    def _kept_summed(
        self,
        kept: MutableMapping[bytes, Float64Array],
        rows: NDArray[np.intp],
        weight: Float64Array,
        wanted: Float64Array,
    ) -> tuple[Float64Array, Float64Array]:
        """Return the normal equations of a form whose untouched skin changes with place, not scaled."""
        degrees = np.array([self.colour_degree, self.position_degree])
        at_rest = np.zeros(0) if self.rest is None else self.rest[rows]
        parts = self.colours[rows], self.place[rows], weight[rows], wanted[rows], at_rest
        key = _digest(degrees, *parts)
        if key not in kept:
            kept[key] = np.concatenate(self._summed(rows, weight, wanted), axis=1)
        count = len(self.scale)
        return kept[key][:, :count].copy(), kept[key][:, count:].copy()

    def _of_sums(
        self, rows: NDArray[np.intp], weight: Float64Array, wanted: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the normal equations of a polynomial, not scaled, from sums of monomials."""
        singles, columns = _pairs(self.position_degree, 2)[0], wanted.shape[1]
        products = _products(self.colour_degree, self.position_degree)
        places = int(_pairs(self.position_degree, 2).max()) + 1
        parts = self.colours[rows], self.place[rows], weight[rows], wanted[rows]
        sums = self._sums(*parts) if self.kept is None else self._kept_sums(self.kept, *parts)
        gram = sums[:, :places].ravel().take(products)
        moment = sums[_pairs(self.colour_degree, 3)[0], places:].reshape(len(gram), len(singles), columns)
        if self.rest is not None:
            # Untouched skin is alike everywhere: its terms times the constant are taken off the others.
            at_rest = self._colour_terms(self.rest)[:, 0]
            gram -= np.multiply.outer(at_rest, gram[0])
            gram -= np.multiply.outer(gram[:, :, 0].copy(), at_rest).swapaxes(2, 3)
            moment -= np.multiply.outer(at_rest, moment[0])
        count = len(self.scale)
        return gram.reshape(count, count), moment.reshape(count, columns)

    def _kept_sums(self, kept: MutableMapping[bytes, Float64Array], *parts: Float64Array) -> Float64Array:
        key = _digest(np.array([self.colour_degree, self.position_degree]), *parts)
        if key not in kept:
            kept[key] = self._sums(*parts)
        return kept[key]

    def _sums(
        self, colours: Float64Array, place: Float64Array, weight: Float64Array, wanted: Float64Array
    ) -> Float64Array:
        """Return sums over pixels of the products of colour monomials (rows) and place monomials (columns).

        Float64 array; the last columns hold the products times the wanted values too.
        """
        pairs = _pairs(self.position_degree, 2)
        count = int(pairs.max()) + 1 + len(pairs) * wanted.shape[1]
        sums: Float64Array = np.zeros((int(_pairs(self.colour_degree, 3).max()) + 1, count))
        for at in blocks_of(len(colours)):
            weighted = weight[at] * monomial_rows(place[at].T, 2 * self.position_degree)
            asked = (weighted[pairs[0]][:, None] * wanted[at].T).reshape(-1, weighted.shape[1])
            sums += monomial_rows(colours[at].T, 2 * self.colour_degree) @ np.concatenate([weighted, asked]).T
        return sums


def _digest(*arrays: NDArray[Any]) -> bytes:
    digest = blake2b(digest_size=16)
    for array in arrays:
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return digest.digest()


@cache
def _pairs(degree: int, variables: int) -> NDArray[np.intp]:
    """Return the index of the monomial of twice the degree that is the product of two: int array of shape (M, M)."""
    exponents = colour_exponents if variables == 3 else position_exponents
    number = {exponent: at for at, exponent in enumerate(exponents(2 * degree))}
    own = exponents(degree)
    return np.array([[number[tuple(np.add(one, other))] for other in own] for one in own], np.intp)


@cache
def _products(colour_degree: int, position_degree: int) -> NDArray[np.intp]:
    """Return the index of the sum that holds the product of two features.

    Int array of shape (M, K, M, K), by colour term and place monomial of either feature. Sums are counted row by row: a
    monomial of colour a row, one of place a column.
    """
    by_colour, by_place = _pairs(colour_degree, 3), _pairs(position_degree, 2)
    return by_colour[:, None, :, None] * (int(by_place.max()) + 1) + by_place[:, None, :]
