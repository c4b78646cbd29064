"""Branches of the inverse map: variables beside intensity, each with its curve.

One reads the root of intensity: shot noise is even in it, and shadows are not stretched.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from device.inverse_map.near_light import IlluminationMap, NearLightModel, between_nodes, rows_between_nodes
from device.inverse_map.regressor import FeatureRegressor, colour_terms, position_exponents
from device.surface import Float32Array, Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class RootIntensity:
    """Makes the root of intensity of intensity; it is the same at every place."""

    def seen(self, intensity: Float32Array, _place: NDArray[Any]) -> Float32Array:
        """Return roots of intensities (N, 3)."""
        return np.sqrt(np.maximum(intensity, np.float32(0.0)))

    def seen_rows(self, values: Float32Array, _across: Float32Array, _down: Float32Array) -> Float32Array:
        """Return the same of whole rows (h, w, 3)."""
        return np.sqrt(np.maximum(values, np.float32(0.0)))


Reading = IlluminationMap | NearLightModel | RootIntensity
"""Makes of intensity and place the colours that a curve is a function of."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A curve of the map that reads slopes of intensity and place.

    reading : makes its colours; None where it reads intensity itself
    curve : what reads them
    share : its weight, 0 to 1
    at_rest : what it reads on untouched skin, which is subtracted (see `RawLightBranch`); None to subtract nothing
    """

    reading: Reading | None
    curve: FeatureRegressor
    share: float
    at_rest: Float32Array | None = None

    def u_at(self, intensity: Float32Array, place: Float64Array) -> Float64Array:
        """Return the stereographic slopes (N, 2) of intensities (N, 3) at position variables (N, 2)."""
        u = self.curve.at(intensity if self.reading is None else self.reading.seen(intensity, place), place)
        return u if self.at_rest is None else u - between_nodes(self.at_rest, place)

    def u_rows(self, values: Float32Array, across: Float32Array, down: Float32Array) -> Float32Array:
        """Return the same of whole rows (h, w, 3) at position variables `across` (w,) and `down` (h,)."""
        colours = values if self.reading is None else self.reading.seen_rows(values, across, down)
        u, _ = self.curve.rows(colours, across, down)
        return u if self.at_rest is None else u - rows_between_nodes(self.at_rest, across, down)


@dataclass(frozen=True, slots=True, eq=False)
class RawLightBranch:
    """A curve that reads light, and its part in the map.

    field : light of untouched skin
    curve : what reads it; its colours are light relative to the field's mean
    share : its weight, 0 to 1; the map's other curve has the rest
    at_rest : stereographic slope that the curve reads on untouched skin, at the field's nodes, float32 array of shape
        (h, w, 2), which is taken off its readings; None in files of before that was done
    """

    field: IlluminationMap
    curve: FeatureRegressor
    share: float
    at_rest: Float32Array | None = None

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        rest = {} if self.at_rest is None else {"at_rest": self.at_rest}
        return self.curve.arrays() | self.field.arrays() | {"share": np.array(self.share)} | rest

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> RawLightBranch | None:
        """Return what `arrays` wrote, None where there are none; KeyError, ValueError or RecordError when malformed."""
        if not arrays:
            return None
        share = float(arrays["share"])
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a share of {share}")
        field = IlluminationMap.from_arrays(arrays)
        at_rest = np.asarray(arrays["at_rest"], np.float32) if "at_rest" in arrays else None
        if at_rest is not None and (at_rest.shape != (*field.nodes.shape[:2], 2) or not np.isfinite(at_rest).all()):
            raise ValueError(f"slopes of untouched skin of shape {at_rest.shape}")
        return cls(field, FeatureRegressor.from_arrays(arrays, source, linear=True), share, at_rest)


@dataclass(frozen=True, slots=True, eq=False)
class RootCurve:
    """A curve that reads the root of intensity, and its part in the map.

    curve : its colours are roots of intensity
    share : its weight, 0 to 1
    """

    curve: FeatureRegressor
    share: float

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return self.curve.arrays() | {"share": np.array(self.share)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> RootCurve | None:
        """Return what `arrays` wrote, None where there are none; KeyError, ValueError or RecordError when malformed."""
        if not arrays:
            return None
        share = float(arrays["share"])
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a share of {share}")
        return cls(FeatureRegressor.from_arrays(arrays, source, linear=True), share)


@dataclass(frozen=True, slots=True, eq=False)
class NearLightBranch:
    """A curve that reads the slopes of a matt skin under near lights.

    field : where the lights stand
    curve : what reads them; its colours are p, q and brightness
    """

    field: NearLightModel
    curve: FeatureRegressor

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `from_arrays` is its inverse."""
        return self.curve.arrays() | self.field.arrays()

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> NearLightBranch | None:
        """Return what `arrays` wrote, None where there are none; KeyError, ValueError or RecordError when malformed."""
        if not arrays:
            return None
        return cls(NearLightModel.from_arrays(arrays), FeatureRegressor.from_arrays(arrays, source, linear=True))


# Flat bias of a curve, its slope on untouched skin, which has none: it is subtracted from every slope.
#
# A smooth curve that is fitted to balls misses zero at intensity 1 by a few thousandths, differently over the field;
# integrated, that is a bowl under everything. So every feature φ of a curve is replaced by its difference from the same
# feature of untouched skin, φ(I, x, y) - φ(1, x, y): untouched skin then has slope 0 whatever the coefficients are, and
# the fit and its held-out balls know it. For a curve of intensity the difference is a linear map of coefficients; for
# one of light the reading of untouched skin is a smooth field, kept at the places at which the light is kept.


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
    return np.asarray(curve.at(field.at(place), place).reshape(rows, columns, 2), np.float32)
