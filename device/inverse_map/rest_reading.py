"""Flat bias of a curve, its slope on untouched skin, which has none: it is subtracted from every slope.

A smooth curve that is fitted to balls misses zero at intensity 1 by a few thousandths, differently over the field;
integrated, that is a bowl under everything. So every feature φ of a curve is replaced by its difference from the same
feature of untouched skin, φ(I, x, y) - φ(1, x, y): untouched skin then has slope 0 whatever the coefficients are, and
the fit and its held-out balls know it. For a curve of intensity the difference is a linear map of coefficients; for one
of light the reading of untouched skin is a smooth field, kept at the places at which the light is kept.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.inverse_map.branches import Reading
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.polynomial_features import position_exponents
from device.inverse_map.regressor import FeatureRegressor, colour_terms
from device.surface.fields import Float32Array, Float64Array


def seen_at_rest(place: Float64Array, reading: Reading | None) -> Float32Array:
    """Return colours (N, 3) that a curve reads on untouched skin: intensity 1, or what `reading` makes of it."""
    ones = np.ones((len(place), 3), np.float32)
    return ones if reading is None else reading.seen(ones, place)


def flat_at_rest(curve: FeatureRegressor, coefficients: Float64Array, reading: Reading | None) -> Float64Array:
    """Return coefficients (M K, C) for features, from those for features less the features of untouched skin.

    The constant of colour takes what the others read of untouched skin. Not for a curve of light, whose colours of
    untouched skin differ from place to place: see `light_at_rest`.
    """
    place_terms = len(position_exponents(curve.position_degree))
    colours = seen_at_rest(np.zeros((1, 2)), reading)
    variables, _ = curve.colours.variables(colours)
    at_rest = colour_terms(variables.astype(np.float64), curve.colour_degree, curve.waves)[0]
    by_term = coefficients.reshape(len(at_rest), place_terms, -1).copy()
    by_term[0] -= np.tensordot(at_rest, by_term, axes=1)
    return np.asarray(by_term.reshape(coefficients.shape))


def light_at_rest(curve: FeatureRegressor, field: IlluminationMap) -> Float32Array:
    """Return the stereographic slope (h, w, 2) that a curve of light reads on untouched skin, at the field's nodes."""
    rows, columns = field.nodes.shape[:2]
    across, down = (np.linspace(-1.0, 1.0, count) for count in (columns, rows))
    place = np.stack(np.broadcast_arrays(across[None, :], down[:, None]), axis=-1).reshape(-1, 2)
    u = np.concatenate([curve.at(field.at(part), part) for part in _parts(place)])
    return np.asarray(u.reshape(rows, columns, 2), np.float32)


def _parts(place: NDArray[Any], size: int = 8192) -> list[NDArray[Any]]:
    """Return places in pieces whose features fit in memory."""
    return [place[first : first + size] for first in range(0, len(place), size)]
