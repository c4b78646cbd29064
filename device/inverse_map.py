"""The position-aware inverse map: from intensity and place in the field straight to slope.

Near lights make the reflectance change over the field, so that one colour means different slopes in different places.
The map is the mean of a few polynomials, one in each curve of intensity (`colour_space`), whose every coefficient is
itself a polynomial in position. They predict the stereographic slope. Each errs in its own way, so that their mean errs
less than any of them.

Why a direct inverse: held-out balls prefer it to every inversion of a forward model that was tried
(docs/decisions/0004-direct-inverse.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.colour_domain import ColourDomain
from device.colour_space import ColourSpace
from device.errors import CalibrationMismatch, RecordError
from device.photometry import IntensityImage
from device.polynomials import colour_exponents, field_position, joint_terms, monomials, position_exponents
from device.stereographic import slope_from_stereographic
from device.surface import Float32Array, Float64Array, GradientField

TRUSTED_EXCESS: Final = 0.1
"""Distance from the calibrated colours, in standard deviations, at which confidence has fallen to a quarter."""

LOST_EXCESS: Final = 4.0
"""Distance from the calibrated colours, in standard deviations, from which a slope means nothing."""

TRUSTED_STEEPER: Final = 0.05
"""Share by which a slope may exceed the steepest that the balls taught until confidence has fallen to a quarter."""

CLIPPED_CONFIDENCE: Final = 0.03
"""Confidence in the slope of a pixel with a saturated channel: its neighbours decide, yet no hole is torn."""

MOST_DEGREE: Final = 16
"""No map has polynomials of a higher degree; a file that asks for one is not read."""

_BLOCK_ROWS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialMap:
    """One polynomial of the mean.

    colours : the curve of intensity that it is a polynomial in
    colour_degree, position_degree : its degrees
    coefficients : float32 array of shape (M, K, 2), M colour monomials, K position monomials, 0 outside `joint_terms`
    share : its weight in the mean
    """

    colours: ColourSpace
    colour_degree: int
    position_degree: int
    coefficients: Float32Array
    share: float

    def stereographic(self, intensity: Float32Array, place: Float64Array) -> Float64Array:
        """Its own slopes u (N, 2) at position variables `place` (N, 2)."""
        design = design_matrix(self.colours, self.colour_degree, self.position_degree, intensity, place)
        return design @ self.coefficients[joint_terms(self.colour_degree, self.position_degree)]


@dataclass(frozen=True, slots=True, eq=False)
class InverseMap:
    """The fitted map.

    shape : (H, W) of the full-size field that positions are scaled by
    members : the polynomials whose mean it is; their shares sum to 1
    domain : the colours that the balls showed
    steepest : slope up to which the balls taught it; what lies beyond is extrapolated
    """

    shape: tuple[int, int]
    members: tuple[PolynomialMap, ...]
    domain: ColourDomain
    steepest: float

    @property
    def position_degree(self) -> int:
        """The highest degree in position of any member."""
        return max(member.position_degree for member in self.members)

    def check_size(self, shape: tuple[int, int], binning: int = 1) -> None:
        """Refuse an image that is not of this field's size divided by `binning`.

        Raises
        ------
        CalibrationMismatch
            Says both sizes.
        """
        expected = (self.shape[0] // binning, self.shape[1] // binning)
        if shape != expected:
            raise CalibrationMismatch(
                f"the frame is {shape[1]}x{shape[0]} pixels but its calibration is for "
                f"{expected[1]}x{expected[0]}: use the calibration of this camera mode"
            )

    def gradients(self, image: IntensityImage, binning: int = 1) -> GradientField:
        """Slope, validity and relative confidence of every pixel of an image binned by `binning`.

        Raises
        ------
        CalibrationMismatch
            The image is not this field's size divided by `binning`.
        """
        self.check_size(image.shape, binning)
        p, q, weight = (np.empty(image.shape, np.float32) for _ in range(3))
        valid = image.valid.copy()
        for rows in _blocks(image.shape[0]):
            p[rows], q[rows] = self._block(image.values[rows], rows, binning)
            excess = self.domain.excess(image.values[rows])
            valid[rows] &= excess < LOST_EXCESS
            weight[rows] = self.confidence(p[rows], q[rows], excess)
        weight *= np.where(image.clipped, np.float32(CLIPPED_CONFIDENCE), np.float32(1.0))
        weight *= valid
        return GradientField(p, q, valid, weight)

    def confidence(self, p: Float32Array, q: Float32Array, excess: Float32Array) -> Float32Array:
        """Relative confidence, 0 to 1, in slopes whose colours lie `excess` outside the domain; arrays of one shape."""
        steeper = np.maximum(np.hypot(p, q) / np.float32(self.steepest) - np.float32(1.0), np.float32(0.0))
        doubt = (1.0 + (excess / np.float32(TRUSTED_EXCESS)) ** 2) * (
            1.0 + (steeper / np.float32(TRUSTED_STEEPER)) ** 2
        )
        return np.asarray(1.0 / doubt**2, np.float32)

    def _block(self, values: Float32Array, rows: slice, binning: int) -> tuple[Float32Array, Float32Array]:
        height, width, _ = values.shape
        centre = 0.5 * (binning - 1)
        column = np.arange(width) * binning + centre
        row = np.arange(rows.start, rows.start + height) * binning + centre
        across = field_position(column, np.zeros_like(column), self.shape)[:, 0].astype(np.float32)
        down = field_position(np.zeros_like(row), row, self.shape)[:, 1].astype(np.float32)
        u = np.zeros((height, width, 2), np.float32)
        for member in self.members:
            terms = monomials(member.colours.variables(values.reshape(-1, 3)), member.colour_degree)
            flat = np.float32(member.share) * member.coefficients.reshape(terms.shape[1], -1)
            per_position = (terms @ flat).reshape(height, width, -1, 2)
            for term, (i, j) in enumerate(position_exponents(member.position_degree)):
                u += per_position[:, :, term] * (across[None, :, None] ** i * down[:, None, None] ** j)
        slope = slope_from_stereographic(u)
        return slope[..., 0], slope[..., 1]

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Slopes of shape (N, 2) for intensities of shape (N, 3) at full-size pixel coordinates."""
        place = field_position(column.astype(np.float64), row.astype(np.float64), self.shape)
        u = np.zeros((len(column), 2))
        for member in self.members:
            u += member.share * member.stereographic(intensity, place)
        return slope_from_stereographic(u)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays, for an npz file; `from_arrays` is its inverse."""
        arrays = {f"domain_{name}": array for name, array in self.domain.arrays().items()}
        for number, member in enumerate(self.members):
            own = member.colours.arrays() | {
                "degrees": np.array([member.colour_degree, member.position_degree]),
                "coefficients": member.coefficients,
                "share": np.array(member.share),
            }
            arrays |= {f"member{number}_{name}": array for name, array in own.items()}
        facts = {"shape": np.array(self.shape), "steepest": np.array(self.steepest)}
        return facts | {"members": np.array(len(self.members))} | arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> InverseMap:
        """The map that `arrays` wrote; `source` names the file in errors.

        Raises
        ------
        RecordError
            An array is missing or of another shape.
        """
        try:
            members = tuple(
                _member(_with_prefix(arrays, f"member{number}_")) for number in range(int(arrays["members"]))
            )
            domain = ColourDomain.from_arrays(_with_prefix(arrays, "domain_"))
            rows, columns = (int(size) for size in arrays["shape"])
            return cls((rows, columns), members, domain, float(arrays["steepest"]))
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise RecordError(f"{source} holds no inverse map ({error}): calibrate again") from error


def design_matrix(
    colours: ColourSpace, colour_degree: int, position_degree: int, intensity: Float32Array, place: Float64Array
) -> Float64Array:
    """The products of `joint_terms` at N pixels: float64 array of shape (N, F).

    place : float64 array of shape (N, 2), position variables
    """
    by_colour = monomials(colours.variables(intensity).astype(np.float64), colour_degree)
    by_place = monomials(place, position_degree)
    colour, position = np.nonzero(joint_terms(colour_degree, position_degree))
    return np.asarray(by_colour[:, colour] * by_place[:, position])


def _member(arrays: Mapping[str, NDArray[Any]]) -> PolynomialMap:
    colour_degree, position_degree = (int(degree) for degree in arrays["degrees"])
    if not (0 <= colour_degree <= MOST_DEGREE and 0 <= position_degree <= MOST_DEGREE):
        raise ValueError(f"degrees {colour_degree} and {position_degree}, which no map has")
    coefficients = np.asarray(arrays["coefficients"], np.float32)
    expected = (len(colour_exponents(colour_degree)), len(position_exponents(position_degree)), 2)
    if coefficients.shape != expected:
        raise ValueError(f"coefficients of shape {coefficients.shape}, not {expected}")
    share = float(arrays["share"])
    return PolynomialMap(ColourSpace.from_arrays(arrays), colour_degree, position_degree, coefficients, share)


def _with_prefix(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _blocks(rows: int) -> Iterator[slice]:
    for start in range(0, rows, _BLOCK_ROWS):
        yield slice(start, min(start + _BLOCK_ROWS, rows))
