"""The position-aware inverse map, from intensity and place in the field straight to slope, and its file."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from device.errors import CalibrationMismatch, RecordError
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.branches import NearLightBranch, Part, RawLightBranch, RootCurve, RootIntensity
from device.inverse_map.near_light import between_nodes, is_node_grid, rows_between_nodes
from device.inverse_map.regressor import FeatureRegressor, blocks_of, field_position, with_prefix
from device.inverse_map.training_domain import Leverage, TrainingDomain
from device.surface import Float32Array, Float64Array, GradientField, slope_from_stereographic

TRUSTED_EXCESS: Final = 0.5
"""Distance outside the calibrated colours, in standard deviations, at which confidence has fallen to a quarter."""

CLIPPED_CONFIDENCE: Final = 0.3
"""Confidence in the slope of a pixel with a saturated channel: the other two still say much (docs/accuracy.md)."""

LOST_EXCESS: Final = 6.0
"""Distance outside the calibrated colours, in standard deviations, from which a slope means nothing."""

DISAGREEMENT: Final = 0.03
"""Standard deviation of the curves' stereographic slopes about their mean at which confidence has fallen to a half."""

REST_WIDTH: Final = 0.06
"""Distance of an intensity from untouched skin's at which a quarter of its reading is still taken off."""

REST_NODES: Final = 25

STEEPER_THAN_BALLS: Final = 1.5
"""Slope, relative to the steepest of the balls, that no pixel's exceeds: where no ball was, curves run to any value.
Corners without one gave heights of 75 mm (wyh5625/gelsight, eight presses, 349 x 240 pixels of 100 µm)."""

NO_HELD_OUT_DEG: Final = 5.0
"""Error of the inverse map's slopes that is assumed where too few balls were given to hold one out."""

_BLOCK_ROWS: Final = 64
ModelT = TypeVar("ModelT")


def slope_sigma_of(held_out_deg: float | None) -> float:
    """Return the standard uncertainty of a slope component for a mean angular error, degrees; None if not known."""
    known_deg = held_out_deg if held_out_deg is not None and np.isfinite(held_out_deg) else NO_HELD_OUT_DEG
    return float(np.tan(np.radians(known_deg)) / np.sqrt(np.pi / 2.0))


@dataclass(frozen=True, slots=True, eq=False)
class InverseMap:
    """The fitted map.

    shape : (H, W) of the full-size field that positions are scaled by
    domain : the colours that the balls showed
    curve : the curve that reads intensity; alone where there are no others, and always what the quick look tabulates
    max_trained_slope : largest slope of the training balls; steeper slopes are extrapolated
    light : the curve that reads light, None where it would not help
    leverage : of the curve that reads intensity, None where it was trained on one ball
    near : the curve in its place that reads a matt skin's slopes, None where it would not help
    root : the curve that reads the root of intensity, None where it would not help
    rest_bump : mean stereographic slope that curves which are free to misread untouched skin read there, nodes as of
        `noise_bias`; it is taken off what looks untouched, and less of what does not. None where they read 0
    noise_bias : what the noise of single full-size pixels adds to the mean stereographic slope of untouched skin, and
        what the reference's own noise adds to it where presses show free skin; float32 array of shape (h, w, 2) at
        places even over the field, borders included; None where not measured
    """

    shape: tuple[int, int]
    domain: TrainingDomain
    curve: FeatureRegressor
    max_trained_slope: float
    light: RawLightBranch | None = None
    leverage: Leverage | None = None
    near: NearLightBranch | None = None
    root: RootCurve | None = None
    noise_bias: Float32Array | None = None
    rest_bump: Float32Array | None = None

    @property
    def steepest_read(self) -> float:
        """Slope that no pixel's exceeds."""
        return STEEPER_THAN_BALLS * self.max_trained_slope

    @property
    def own(self) -> FeatureRegressor:
        """The curve that slopes are read with beside that of light."""
        return self.curve if self.near is None else self.near.curve

    @property
    def own_fraction(self) -> float:
        """Weight of `own`: what the curves of light and of the root leave."""
        return 1.0 - sum(part.share for part in (self.light, self.root) if part is not None)

    @property
    def parts(self) -> list[Part]:
        """Every curve that slopes are the mean of."""
        found = [Part(None if self.near is None else self.near.field, self.own, self.own_fraction)]
        if self.light is not None:
            found.append(Part(self.light.field, self.light.curve, self.light.share, self.light.at_rest))
        if self.root is not None:
            found.append(Part(RootIntensity(), self.root.curve, self.root.share))
        return found

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

    def gradients(self, image: NormalizedImage, binning: int = 1) -> GradientField:
        """Return the slope, validity and relative confidence of every pixel of an image binned by `binning`.

        Raises
        ------
        CalibrationMismatch
            The image is not this field's size divided by `binning`.
        """
        self.check_size(image.shape, binning)
        p, q, excess, spread = (np.empty(image.shape, np.float32) for _ in range(4))
        # Binned pixels are so much quieter that noise adds nothing to what they read.
        read_by = self if binning == 1 else self.quiet
        for rows in blocks_of(image.shape[0], _BLOCK_ROWS):
            p[rows], q[rows], excess[rows], spread[rows] = read_by._block(image.values[rows], rows, binning)
        valid = image.valid & (excess < LOST_EXCESS)
        confidence = np.where(image.clipped, CLIPPED_CONFIDENCE, 1.0) / (1.0 + (excess / TRUSTED_EXCESS) ** 2) ** 2
        confidence = confidence / (1.0 + spread * (1.0 / DISAGREEMENT**2))
        weight = np.where(valid, confidence, 0.0).astype(np.float32)
        return GradientField(p, q, valid, weight)

    def _block(
        self, values: Float32Array, rows: slice, binning: int
    ) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
        height, width, _ = values.shape
        centre = 0.5 * (binning - 1)
        column = np.arange(width) * binning + centre
        row = np.arange(rows.start, rows.start + height) * binning + centre
        across = field_position(column, np.zeros_like(column), self.shape)[:, 0].astype(np.float32)
        down = field_position(np.zeros_like(row), row, self.shape)[:, 1].astype(np.float32)
        slope, excess, spread = self._rows(values, across, down)
        return slope[..., 0], slope[..., 1], excess, spread

    @property
    def quiet(self) -> InverseMap:
        """The map for intensities without noise, as means over pixels are.

        `rest_bump` is then what the curves read of untouched skin, not that which noisy pixels need, and nothing of
        `noise_bias` is taken off.
        """
        if self.rest_bump is None:
            return self if self.noise_bias is None else replace(self, noise_bias=None)
        return replace(self, noise_bias=None, rest_bump=rest_nodes(replace(self, rest_bump=None)))

    def on_grid(self, values: Float32Array, column: NDArray[Any], row: NDArray[Any]) -> Float32Array:
        """Return slopes (h, w, 2) for intensities (h, w, 3) without noise at full-size columns (w,) and rows (h,)."""
        quiet = self.quiet
        across = ((2.0 * column + 1.0) / self.shape[1] - 1.0).astype(np.float32)
        down = ((2.0 * row + 1.0) / self.shape[0] - 1.0).astype(np.float32)
        slopes = np.empty((*values.shape[:2], 2), np.float32)
        for rows in blocks_of(len(row), _BLOCK_ROWS):
            slopes[rows], _, _ = quiet._rows(values[rows], across, down[rows])
        return slopes

    def _rows(
        self, values: Float32Array, across: Float32Array, down: Float32Array
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Return slopes (h, w, 2), excess (h, w) and the curves' variance (h, w) of whole rows.

        across, down : position variables, (w,) and (h,)
        """
        mean = np.zeros((*values.shape[:2], 2), np.float32)
        square = np.zeros(values.shape[:2], np.float32)
        for part in self.parts:
            u, share = part.u_rows(values, across, down), np.float32(part.share)
            mean += share * u
            square += share * (u * u).sum(axis=-1)
        spread = np.maximum(square - (mean * mean).sum(axis=-1), np.float32(0.0))
        if len(self.parts) == 1:
            spread[:] = 0.0
        if self.rest_bump is not None:
            mean -= rest_likeness(values)[..., None] * rows_between_nodes(self.rest_bump, across, down)
        if self.noise_bias is not None:
            mean -= rows_between_nodes(self.noise_bias, across, down)
        _, excess = self.curve.colours.variables(values)
        return np.asarray(slope_from_stereographic(mean, self.steepest_read), np.float32), excess, spread

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Return slopes of shape (N, 2) for intensities of shape (N, 3) of single pixels at full-size coordinates."""
        place = field_position(column.astype(np.float64), row.astype(np.float64), self.shape)
        return slope_from_stereographic(self.stereographic_of_noisy(intensity, place), self.steepest_read)

    def stereographic_of_noisy(self, intensity: Float32Array, place: Float64Array) -> Float64Array:
        """Return the stereographic slopes (N, 2) of single pixels' intensities (N, 3) at position variables (N, 2)."""
        u = self.stereographic_at(intensity, place)
        return u if self.noise_bias is None else u - between_nodes(self.noise_bias, place)

    def stereographic_at(self, intensity: Float32Array, place: Float64Array) -> Float64Array:
        """Return the stereographic slopes (N, 2) of intensities (N, 3) without noise at position variables (N, 2)."""
        u = np.zeros((len(place), 2))
        for part in self.parts:
            u += part.share * part.u_at(intensity, place)
        if self.rest_bump is not None:
            u -= rest_likeness(intensity)[..., None] * between_nodes(self.rest_bump, place)
        return u

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays, for an npz file; `from_arrays` is its inverse."""
        named = {f"domain_{name}": array for name, array in self.domain.arrays().items()} | self.curve.arrays()
        for prefix, part in (
            ("light", self.light),
            ("near", self.near),
            ("root", self.root),
            ("leverage", self.leverage),
        ):
            if part is not None:
                named |= {f"{prefix}_{name}": array for name, array in part.arrays().items()}
        if self.noise_bias is not None:
            named["noise_bias"] = self.noise_bias
        if self.rest_bump is not None:
            named["rest_bump"] = self.rest_bump
        return named | {"shape": np.array(self.shape), "steepest": np.array(self.max_trained_slope)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], source: str) -> InverseMap:
        """Return the map that `arrays` wrote; `source` names the file in errors.

        Raises
        ------
        RecordError
            An array is missing or of another shape.
        """
        try:
            domain = TrainingDomain.from_arrays(with_prefix(arrays, "domain_"))
            rows, columns = (int(size) for size in arrays["shape"])
            steepest = float(arrays["steepest"])
            curve = FeatureRegressor.from_arrays(arrays, source)
            light = RawLightBranch.from_arrays(with_prefix(arrays, "light_"), source)
            near = NearLightBranch.from_arrays(with_prefix(arrays, "near_"), source)
            root = RootCurve.from_arrays(with_prefix(arrays, "root_"), source)
            named = with_prefix(arrays, "leverage_")
            leverage = Leverage.from_arrays(named, curve) if named else None
            noise_bias, rest_bump = (_slope_nodes(arrays, name) for name in ("noise_bias", "rest_bump"))
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise RecordError(f"{source} holds no inverse map ({error}): calibrate again") from error
        return cls((rows, columns), domain, curve, steepest, light, leverage, near, root, noise_bias, rest_bump)


def _slope_nodes(arrays: Mapping[str, NDArray[Any]], name: str) -> Float32Array | None:
    if name not in arrays:
        return None
    nodes = np.asarray(arrays[name], np.float32)
    if not is_node_grid(nodes, 2):
        raise ValueError(f"a {name.replace('_', ' ')} of shape {nodes.shape}")
    return nodes


def rest_likeness(intensity: Float32Array) -> Float32Array:
    """Return the likeness of intensities (..., 3) to untouched skin, from 0 to 1.

    It is 1 at intensity 1, and a quarter at `REST_WIDTH` from it.
    """
    apart = ((intensity - np.float32(1.0)) ** 2).sum(axis=-1) * np.float32(1.0 / REST_WIDTH**2)
    return np.asarray(np.float32(1.0) / (np.float32(1.0) + apart) ** 2, np.float32)


def rest_nodes(inverse_map: InverseMap) -> Float32Array:
    """Return what a map's curves read on untouched skin, nodes (h, w, 2) as of `InverseMap.rest_bump`."""
    places = np.linspace(-1.0, 1.0, REST_NODES)
    place = np.stack(np.broadcast_arrays(places[None, :], places[:, None]), axis=-1).reshape(-1, 2)
    read = inverse_map.stereographic_at(np.ones((len(place), 3), np.float32), place)
    return np.asarray(read.reshape(REST_NODES, REST_NODES, 2), np.float32)


MODEL_FILE: Final = "inverse-map.npz"
MAX_MODEL_BYTES: Final = 64 << 20
"""A map takes a few megabytes; a file that unpacks to more than this is not unpacked."""

_READ_ERRORS: Final = (
    OSError,
    ValueError,
    TypeError,
    EOFError,
    LookupError,
    ArithmeticError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)
"""Errors of zipfile and numpy for bytes that are no model, or no longer."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write named arrays so that `read_arrays` returns them bit for bit."""
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def read_arrays(path: Path, build: Callable[[dict[str, NDArray[Any]]], ModelT]) -> ModelT:
    """Return what `build` makes of the named arrays in a file.

    Raises
    ------
    RecordError
        The file is missing, damaged or holds something else.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked_bytes = sum(member.file_size for member in archive.infolist())
        if unpacked_bytes > MAX_MODEL_BYTES:
            raise RecordError(f"{path}: unpacks to {unpacked_bytes / 1e6:.0f} MB, more than any model: calibrate again")
        with np.load(path, allow_pickle=False) as arrays:
            return build(dict(arrays))
    except _READ_ERRORS as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"{path}: holds no readable model ({error}): calibrate again") from error


def write_model(path: Path, inverse_map: InverseMap) -> None:
    """Write the map so that `read_model` returns it bit for bit."""
    write_arrays(path, inverse_map.arrays())


def read_model(path: Path) -> InverseMap:
    """Return the inverse map in a file; errors as for `read_arrays`."""
    return read_arrays(path, lambda arrays: InverseMap.from_arrays(arrays, str(path)))
