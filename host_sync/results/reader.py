"""The surface in a result folder: height map, uncertainties and record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import msgspec
import numpy as np

from device.surface import Float32Array, HeightMap, MaskArray
from host_sync.results.doubts import result_doubts
from host_sync.results.field_file import MAX_TILE_VALUES, read_field, read_mask, read_samples
from host_sync.results.files import (
    EXTRAPOLATED_FILE,
    HEIGHT_FILE,
    HEIGHT_SIGMA_FILE,
    OTHER_HEIGHT_FILES,
    SAMPLES_FILE,
    SLOPE_SIGMA_FILE,
    UNTOUCHED_FILE,
    DetailName,
    other_detail,
)
from host_sync.results.record import Doubt, ResultRecord, read_record

MAX_SAMPLES_RATIO: Final = 4
"""Values of all samples over those of the height map; honest results stay below 1."""

WHOLE_SAMPLES_PX: Final = 512
WHOLE_SAMPLES_RATIO: Final = 16
"""The same of fields up to so many columns wide, whose samples are not reduced."""

MAX_SQUARE: Final = np.float32(9.0)
"""Largest p² + q² for which the slope noise is looked up; steeper pixels are as noisy as these."""

FieldT = TypeVar("FieldT")


@dataclass(frozen=True, slots=True, eq=False)
class ResultSurface:
    """One reconstruction's surface and its uncertainty; a field is None when the folder does not hold it.

    samples_um : float32 array of shape (K, h, w), Monte Carlo samples of the height error on a reduced grid, µm
    slope_sigma : float32 array of shape (H, W), standard uncertainty of either slope, NaN where invalid
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm, NaN where invalid
    extrapolated : bool array of shape (H, W), True where a slope lies beyond the calibration's training samples
        and the skin is not known to be untouched
    other : the height map with the other detail
    untouched : bool array of shape (H, W), True on the untouched skin that the zero was taken from
    stated : doubts of a surface that is no result of its own; None reads them from record and folder
    """

    folder: Path
    record: ResultRecord
    height: HeightMap
    samples_um: Float32Array | None = None
    slope_sigma: Float32Array | None = None
    sigma_um: Float32Array | None = None
    extrapolated: MaskArray | None = None
    other: HeightMap | None = None
    untouched: MaskArray | None = None
    stated: tuple[Doubt, ...] | None = None

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Every reason to distrust the heights."""
        return result_doubts(self.folder, self.record) if self.stated is None else self.stated

    @property
    def detail(self) -> DetailName:
        """Return which detail the height map holds."""
        return self.record.surface_detail

    def with_detail(self, detail: DetailName | None) -> ResultSurface:
        """Return the surface with a kind of detail.

        It stays as it is where that detail is its own, it has no other, or None is asked for.
        """
        if detail in (None, self.detail) or self.other is None:
            return self
        return replace(
            self,
            height=self.other,
            other=self.height,
            slope_sigma=self._slope_sigma(other_detail(self.detail)),
            record=msgspec.structs.replace(self.record, surface_detail=other_detail(self.detail)),
        )

    @property
    def noise_height_px(self) -> float | None:
        """Fine noise of heights over that of slopes, pixels; None where it was not measured."""
        noise = self.record.slope_noise
        return None if noise is None else noise.raw_height_px if self.detail == "raw" else noise.shrunk_height_px

    def pixel_noise_sigma(self) -> Float32Array | None:
        """Return the pixel noise of either slope of raw detail: float32 array of shape (H, W); None for other detail.

        Shrunk detail has lost of the surface what it has lost of noise: nothing is taken off it.
        """
        noise = self.record.slope_noise
        if noise is None or self.detail != "raw" or self.other is None:
            return None
        return np.asarray(np.sqrt(noise.variance(_squared_slope(self.other), "raw")), np.float32)

    def _slope_sigma(self, detail: DetailName) -> Float32Array | None:
        """Return the standard uncertainty of the slopes with the other detail."""
        noise, smooth = self.record.slope_noise, self.height if self.detail == "shrunk" else self.other
        if self.slope_sigma is None or noise is None or smooth is None:
            return self.slope_sigma
        more = noise.added_variance(_squared_slope(smooth)) * np.float32(1.0 if detail == "raw" else -1.0)
        return np.asarray(np.sqrt(np.maximum(self.slope_sigma**2 + more, np.float32(0.0))), np.float32)


def _squared_slope(height: HeightMap) -> Float32Array:
    """p² + q² of a height map, 0 where it has none: float32 array of shape (H, W)."""
    down, across = np.gradient(height.z_um / np.float32(height.pitch_um))
    return np.asarray(np.nan_to_num(np.minimum(across * across + down * down, MAX_SQUARE)), np.float32)


def read_result(folder: Path, *, samples: bool = True) -> ResultSurface:
    """Return the surface in a result folder.

    samples : whether to read the Monte Carlo samples and the slope uncertainty too

    Raises
    ------
    UnreadableResult
        A file is missing or damaged, or does not fit the record.
    """
    record = read_record(folder)
    shape = (record.rows, record.columns)
    limit = max_sample_values(shape)
    other = _optional(
        folder / OTHER_HEIGHT_FILES[other_detail(record.surface_detail)], lambda path: read_field(path, shape)
    )
    return ResultSurface(
        folder=folder,
        record=record,
        height=HeightMap(read_field(folder / HEIGHT_FILE, shape), record.pixel_pitch_um),
        samples_um=_optional(folder / SAMPLES_FILE, lambda path: read_samples(path, limit)) if samples else None,
        slope_sigma=_optional(folder / SLOPE_SIGMA_FILE, lambda path: read_field(path, shape)) if samples else None,
        sigma_um=_optional(folder / HEIGHT_SIGMA_FILE, lambda path: read_field(path, shape)),
        extrapolated=_optional(folder / EXTRAPOLATED_FILE, lambda path: read_mask(path, shape)),
        other=None if other is None else HeightMap(other, record.pixel_pitch_um),
        untouched=_optional(folder / UNTOUCHED_FILE, lambda path: read_mask(path, shape)),
    )


def max_sample_values(shape: tuple[int, int]) -> int:
    """Most values in the Monte Carlo samples of a height map: they are on a reduced grid."""
    ratio = MAX_SAMPLES_RATIO if shape[1] > WHOLE_SAMPLES_PX else WHOLE_SAMPLES_RATIO
    return max(ratio * shape[0] * shape[1], MAX_TILE_VALUES)


def _optional(path: Path, read: Callable[[Path], FieldT]) -> FieldT | None:
    """Return what is read, or None when there is no such file."""
    return read(path) if path.is_file() else None
