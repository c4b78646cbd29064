"""The position-aware inverse map: from intensity and place in the field straight to slope.

Near lights make the reflectance change over the field, so that one colour means different slopes in different places.
The map is a curve of log intensity, a polynomial with or without waves (see `slope_curve`), whose every coefficient is
itself a polynomial in position. It predicts the stereographic slope. Where held-out balls gain by it, its place is
taken by a curve that reads what a matt skin's slopes would be under near lights (see `near_field`); and a further curve
reads the frame's light, not divided by the reference, and the map is the weighted mean of both.

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
from device.curve_readings import LightCurve, NearCurve
from device.errors import CalibrationMismatch, RecordError
from device.leverage import Leverage
from device.photometry import IntensityImage
from device.polynomials import field_position
from device.slope_curve import SlopeCurve, with_prefix
from device.stereographic import slope_from_stereographic
from device.surface import Float32Array, Float64Array, GradientField

TRUSTED_EXCESS: Final = 0.5
"""Distance outside the calibrated colours, in standard deviations, at which confidence has fallen to a quarter."""

CLIPPED_CONFIDENCE: Final = 0.3
"""Confidence in the slope of a pixel with a saturated channel: the other two still say much (docs/accuracy.md)."""

LOST_EXCESS: Final = 6.0
"""Distance outside the calibrated colours, in standard deviations, from which a slope means nothing."""

_BLOCK_ROWS: Final = 64


@dataclass(frozen=True, slots=True, eq=False)
class InverseMap:
    """The fitted map.

    shape : (H, W) of the full-size field that positions are scaled by
    domain : the colours that the balls showed
    curve : the curve that reads intensity; alone where there are no others, and always what the quick look tabulates
    steepest : slope up to which the balls taught it; what lies beyond is extrapolated
    light : the curve that reads light, None where it would not help
    leverage : of the curve that reads intensity, None where one ball alone taught it
    near : the curve in its place that reads a matt skin's slopes, None where it would not help
    """

    shape: tuple[int, int]
    domain: ColourDomain
    curve: SlopeCurve
    steepest: float
    light: LightCurve | None = None
    leverage: Leverage | None = None
    near: NearCurve | None = None

    @property
    def own(self) -> SlopeCurve:
        """The curve that slopes are read with beside that of light."""
        return self.curve if self.near is None else self.near.curve

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
        p, q, excess = (np.empty(image.shape, np.float32) for _ in range(3))
        for rows in _blocks(image.shape[0]):
            p[rows], q[rows], excess[rows] = self._block(image.values[rows], rows, binning)
        valid = image.valid & (excess < LOST_EXCESS)
        confidence = np.where(image.clipped, CLIPPED_CONFIDENCE, 1.0) / (1.0 + (excess / TRUSTED_EXCESS) ** 2) ** 2
        weight = np.where(valid, confidence, 0.0).astype(np.float32)
        return GradientField(p, q, valid, weight)

    def _block(
        self, values: Float32Array, rows: slice, binning: int
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        height, width, _ = values.shape
        centre = 0.5 * (binning - 1)
        column = np.arange(width) * binning + centre
        row = np.arange(rows.start, rows.start + height) * binning + centre
        across = field_position(column, np.zeros_like(column), self.shape)[:, 0].astype(np.float32)
        down = field_position(np.zeros_like(row), row, self.shape)[:, 1].astype(np.float32)
        slope, excess = self._rows(values, across, down)
        return slope[..., 0], slope[..., 1], excess

    def on_grid(self, values: Float32Array, column: NDArray[Any], row: NDArray[Any]) -> Float32Array:
        """Slopes of shape (h, w, 2) for intensities of shape (h, w, 3) at full-size columns (w,) and rows (h,)."""
        across = ((2.0 * column + 1.0) / self.shape[1] - 1.0).astype(np.float32)
        down = ((2.0 * row + 1.0) / self.shape[0] - 1.0).astype(np.float32)
        slopes = np.empty((*values.shape[:2], 2), np.float32)
        for rows in _blocks(len(row)):
            slopes[rows], _ = self._rows(values[rows], across, down[rows])
        return slopes

    def _rows(
        self, values: Float32Array, across: Float32Array, down: Float32Array
    ) -> tuple[Float32Array, Float32Array]:
        """Slopes (h, w, 2) and excess (h, w) of whole rows at position variables (w,) and (h,)."""
        if self.near is None:
            u, excess = self.curve.rows(values, across, down)
        else:
            u, _ = self.near.curve.rows(self.near.field.seen_rows(values, across, down), across, down)
            _, excess = self.curve.colours.variables(values)
        if self.light is not None:
            lit, _ = self.light.curve.rows(self.light.field.seen_rows(values, across, down), across, down)
            u += np.float32(self.light.share) * (lit - u)
        return np.asarray(slope_from_stereographic(u), np.float32), excess

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Slopes of shape (N, 2) for intensities of shape (N, 3) at full-size pixel coordinates."""
        place = field_position(column.astype(np.float64), row.astype(np.float64), self.shape)
        near, light = self.near, self.light
        u = self.curve.at(intensity, place) if near is None else near.curve.at(near.field.seen(intensity, place), place)
        if light is not None:
            u += light.share * (light.curve.at(light.field.seen(intensity, place), place) - u)
        return slope_from_stereographic(u)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything as arrays, for an npz file; `from_arrays` is its inverse."""
        named = {f"domain_{name}": array for name, array in self.domain.arrays().items()} | self.curve.arrays()
        for prefix, part in (("light", self.light), ("near", self.near), ("leverage", self.leverage)):
            if part is not None:
                named |= {f"{prefix}_{name}": array for name, array in part.arrays().items()}
        return named | {"shape": np.array(self.shape), "steepest": np.array(self.steepest)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> InverseMap:
        """The map that `arrays` wrote; `source` names the file in errors.

        Raises
        ------
        RecordError
            An array is missing or of another shape.
        """
        try:
            domain = ColourDomain.from_arrays(with_prefix(arrays, "domain_"))
            rows, columns = (int(size) for size in arrays["shape"])
            steepest = float(arrays["steepest"])
            curve = SlopeCurve.from_arrays(arrays, source)
            light = LightCurve.from_arrays(with_prefix(arrays, "light_"), source)
            near = NearCurve.from_arrays(with_prefix(arrays, "near_"), source)
            named = with_prefix(arrays, "leverage_")
            leverage = Leverage.from_arrays(named, curve) if named else None
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise RecordError(f"{source} holds no inverse map ({error}): calibrate again") from error
        return cls((rows, columns), domain, curve, steepest, light, leverage, near)


def _blocks(rows: int) -> Iterator[slice]:
    for start in range(0, rows, _BLOCK_ROWS):
        yield slice(start, min(start + _BLOCK_ROWS, rows))
