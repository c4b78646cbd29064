"""Checks of a calibration that was read: arrays of the shapes that kernels trust, numbers that are numbers.

The types were checked when it was read. Kernels check no index, so that a table which points beyond its end would read
foreign memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from typing import Any, Final

import msgspec
import numpy as np

from device.balls.sphere import Viewpoint
from device.inverse_map.model import InverseMap
from device.inverse_map.training_domain import TrainingDomain
from host_sync.calibration.calibrate import METHODS, Calibration
from host_sync.denoising.frame_noise import NullColour
from host_sync.frame_checks.light_levels import cells_shape
from host_sync.frame_checks.pigment_pattern import ReferencePattern, WindowGrid
from host_sync.frames.frame_set_file import MAX_LIGHTS
from host_sync.johnson2009.lookup_table import CANDIDATE_FIELDS, LookupTable
from host_sync.johnson2009.spherical_harmonics import FULL_ORDER, HarmonicFit
from host_sync.light.model import PLACES, TERMS
from host_sync.light_groups import NUMBERS_OF_TERMS
from host_sync.results.record import SlopeNoise
from host_sync.uncertainty.slope_error import SlopeError

SHAPES: Final[dict[str, dict[str, str]]] = {
    "Calibration": {"flat_field": "H W 3"},
    "TrainingPress": {"picture": "h w 3"},
    "InverseFit": {"kept": "n", "ball_error_deg": "n"},
    "HeldOutReadings": {"slope": "n 2", "truth": "n 2", "place": "n 2", "ball": "n", "radius_px": "balls"},
    "ReflectanceMaps": {"mean": "n n 3", "variance": "n n 3", "count": "n n"},
    "HarmonicFit": {"coefficients": "terms 3"},
    "LookupTable": {"low": "3", "step": "3", "bin_of": "n n n", "first": "filled", "candidates": "m fields"},
    "ReferencePattern": {"squares": "n side side", "spectra": "n side half"},
    "LevelModel": {"low": "3", "high": "3"},
    "SlopeResponse": {"terms": "3 2 3"},
    "LayoutModel": {"rest": "h w 3"},
    "LightPositionModel": {"gradient": "cells 3 2"},
    "FittedLight": {"shift_px": "balls 2"},
    "LightModel": {
        "sources": "s 5",
        "strengths": "3 s",
        "haze": "3",
        "residual": f"3 {TERMS} {PLACES}",
        "sigma": "3",
        "source_sigma": "3",
    },
    "IlluminationMap": {"nodes": "h w 3"},
    "FrameNoise": {"covariance": "3 3", "ratios": "3"},
    "SkinAtRest": {"covariance": "h w 3 3", "pooled": "h w 3 3", "roughness": "h w 3", "darkness": "h w 3"},
    "NullColour": {"channels": "3 3 3", "slopes": "3 3 2"},
    "Shrinkage": {"whitening": "3 3 3", "threshold": "3", "kept": "3"},
    "LightGroups": {"flat_field": "H W lights", "typical": "lights"},
    "MattLights": {"directions": "lights k 2", "tolerance": "lights"},
    "GridPose": {"parameters": "k", "covariance": "k k"},
}
"""Shape of every array by record and field; one letter or word is one number within a record."""

MAY_BE_NAN: Final = {("ReflectanceMaps", "mean"), ("ReflectanceMaps", "variance"), ("InverseFit", "ball_error_deg")}
MAY_BE_EMPTY: Final = {"LightModel.sources", "LightModel.strengths"}
"""Arrays of a light model without sources."""

LARGEST_SIDE: Final = 32_768
LARGEST_GAIN: Final = 10.0
LARGEST_PLACE: Final = 10.0
LARGEST_COEFFICIENT: Final = 1e6
MIN_FOLDS: Final = 2
MIN_HEIGHT_PX: Final = 1.0
LARGEST_BLUR_PX: Final = 5.0


class Unsound(ValueError):
    """A calibration that was read holds what no calibration does. The message names it."""


def check_sound(calibration: Calibration, name: str) -> None:
    """Refuse a calibration that cannot be used; `name` is that of its file.

    Raises
    ------
    Unsound, RecordError
        Names what is wrong.
    """
    for record in _records(calibration):
        if isinstance(record, InverseMap):
            _check_map(record, calibration.flat_field.shape[:2], name)
        else:
            _check_arrays(record)
    for one in (calibration, *calibration.beside):
        _check_field(one)
        _check_errors(one.slope_error, one.slope_noise)
        _check_fitted_lights(one)
        _check_viewpoint(one.viewpoint)
        _check_null_colour(one.null_colour)
    _check_lights(calibration)


def _records(value: Any) -> Iterator[Any]:
    """Yield the record, and those within it; what is within an inverse map is its own business."""
    if is_dataclass(value) or isinstance(value, msgspec.Struct) or hasattr(value, "_fields"):
        yield value
        if not isinstance(value, InverseMap):
            for name in _names(value):
                yield from _records(getattr(value, name))
    elif type(value) is tuple:
        for one in value:
            yield from _records(one)


def _names(record: Any) -> tuple[str, ...]:
    if is_dataclass(record):
        return tuple(one.name for one in fields(record))
    return tuple(getattr(record, "__struct_fields__", None) or record._fields)


def _check_arrays(record: Any) -> None:
    known = SHAPES.get(type(record).__name__, {})
    sizes: dict[str, int] = {"fields": CANDIDATE_FIELDS}
    for name in _names(record):
        value = getattr(record, name)
        for array in value if type(value) is tuple else (value,):
            if isinstance(array, np.ndarray):
                _check_shape(array.shape, known[name], sizes, f"{type(record).__name__}.{name}")
                if (type(record).__name__, name) not in MAY_BE_NAN and not np.isfinite(array).all():
                    raise Unsound(f"{type(record).__name__}.{name} is not finite")
    if isinstance(record, LookupTable):
        _check_table(record)
    elif isinstance(record, HarmonicFit) and not (
        0 <= record.order <= FULL_ORDER and sizes["terms"] == (record.order + 1) ** 2
    ):
        raise Unsound(f"harmonics of order {record.order} with {sizes['terms']} terms")
    elif isinstance(record, ReferencePattern) and (
        sizes["n"] != record.grid.count or sizes["side"] != record.grid.side or sizes["half"] != sizes["side"] // 2 + 1
    ):
        raise Unsound("a pattern in other windows than its grid's")


def _check_shape(shape: tuple[int, ...], wanted: str, sizes: dict[str, int], name: str) -> None:
    words = wanted.split()
    fits = len(words) == len(shape) and all(
        size == (int(word) if word.isdigit() else sizes.setdefault(word, size))
        for word, size in zip(words, shape, strict=True)
    )
    if not fits or (0 in shape and name not in MAY_BE_EMPTY):
        raise Unsound(f"{name} has the shape {shape}")


def _check_table(table: LookupTable) -> None:
    """Refuse a table that points beyond its end."""
    inside = table.first[0] == 0 and table.first[-1] == len(table.candidates) and (np.diff(table.first) > 0).all()
    if not inside or table.bin_of.min() < 0 or table.bin_of.max() >= table.filled_bins or not (table.step > 0.0).all():
        raise Unsound("a lookup table that points beyond its end")


def _check_map(inverse: InverseMap, shape: tuple[int, ...], name: str) -> None:
    InverseMap.from_arrays(inverse.arrays(), name)
    domain: TrainingDomain = inverse.domain
    widths = np.array([domain.cell, domain.spread, inverse.max_trained_slope, *domain.low])
    if inverse.shape != shape or not np.isfinite(widths).all() or min(domain.cell, domain.spread) <= 0.0:
        raise Unsound(f"an inverse map of a field of {inverse.shape}")
    arrays = [array for array in inverse.arrays().values() if array.dtype.kind == "f"]
    if not all(np.isfinite(array).all() for array in arrays) or 0 in domain.distance.shape:
        raise Unsound("an inverse map that is not finite")


def _check_field(calibration: Calibration) -> None:
    """Refuse parts that are of fields of different sizes."""
    rows, columns, _ = calibration.flat_field.shape
    model, cells = calibration.frame_model, cells_shape((rows, columns))
    grid = model.pattern.reference.grid if model.pattern.reference else None
    if not (
        max(rows, columns) <= LARGEST_SIDE
        and float(calibration.flat_field.min()) >= 0.0
        and 0.0 < calibration.pitch_um < np.inf
        and set(calibration.held_out_deg) == (set(METHODS) if calibration.paper else {"direct"})
        and (calibration.paper is not None or calibration.preferred == "direct")
        and model.layout.rest.shape[:2] == cells
        and len(model.position.gradient) == cells[0] * cells[1]
        and (grid is None or grid == WindowGrid.of((rows, columns)))
    ):
        raise Unsound("its parts are of fields of different sizes")


def _check_lights(calibration: Calibration) -> None:
    """Refuse groups that are not those of the calibrations beside, or name lights that are not there."""
    lights, beside = calibration.lights, calibration.beside
    if lights is None:
        if beside:
            raise Unsound("calibrations in addition to one of three lights")
        return
    count = lights.flat_field.shape[2]
    known = {number for group in lights.groups for number in group} == set(range(count))
    directions = lights.matt.directions.shape
    if not (
        known
        and len(lights.groups) == 1 + len(beside)
        and len(lights.names) == lights.typical.size == directions[0] == count <= MAX_LIGHTS
        and directions[1] in NUMBERS_OF_TERMS
        and all(one.flat_field.shape == calibration.flat_field.shape and not one.beside for one in beside)
        and lights.flat_field.shape[:2] == calibration.flat_field.shape[:2]
    ):
        raise Unsound("groups of lights that do not go with its calibrations")


def _check_fitted_lights(calibration: Calibration) -> None:
    """Refuse sources that stand on no side of the skin, or a coat that no skin has."""
    light = calibration.light
    for model in (light.model, *light.folds):
        numbers = [value for value in asdict(model).values() if isinstance(value, float)]
        if not (
            model.shape == calibration.flat_field.shape[:2]
            and np.isfinite(numbers).all()
            and bool((model.sources[:, 2] > 0.0).all())
            and min(float(model.sigma.min()), float(model.source_sigma.min())) > 0.0
            and bool((model.strengths >= 0.0).all())
            and float(model.rest(np.zeros(1), np.zeros(1)).min()) > 0.0
            and min(model.gloss_width, model.tail) > 0.0
            and float(np.abs(model.residual).max()) < LARGEST_COEFFICIENT
        ):
            raise Unsound("sources and a coat that no instrument has")
    if not 0.0 <= light.confirmed <= 1.0:
        raise Unsound("a light model of which balls confirm less than nothing or more than all")
    if len(light.folds) < min(MIN_FOLDS, len(light.shift_px)):
        raise Unsound("a light model without folds")


def _check_viewpoint(viewpoint: Viewpoint | None) -> None:
    """Refuse a camera that stands nowhere over the skin."""
    if viewpoint is None:
        return
    places = viewpoint.column, viewpoint.row, viewpoint.height_px
    if not (np.isfinite(places).all() and viewpoint.height_px >= MIN_HEIGHT_PX):
        raise Unsound("a camera that is not above the skin")


def _check_null_colour(null_colour: NullColour | None) -> None:
    """Refuse a null colour that counts every slope as zero, or beyond measure."""
    if null_colour is not None and not 0.0 < null_colour.limit < LARGEST_COEFFICIENT:
        raise Unsound(f"its null colour holds for slopes up to {null_colour.limit:g}, which no skin has")


def _check_errors(error: SlopeError, noise: SlopeNoise | None) -> None:
    """Refuse figures by tilt that are not as many as tilts."""
    parts = [error.tilt_deg, error.pixel_deg, error.patch_deg, *error.ball_gains]
    if any(abs(gain) > LARGEST_GAIN for ball in error.ball_gains for gain in ball):
        raise Unsound("gains of slopes that are not those of a map")
    places = np.array(error.ball_places)
    if places.size and (len(places) != len(error.ball_gains) or not np.abs(places).max() < LARGEST_PLACE):
        raise Unsound("gains of balls outside of the field")
    alike = len({len(part) for part in parts}) == 1 and len(error.tilt_deg) > 0
    if noise is not None:
        if not all(0.0 <= blur_px <= LARGEST_BLUR_PX for blur_px in (noise.blur_px, noise.raw_blur_px)):
            raise Unsound("a blur that no camera has")
        alike = alike and len({len(part) for part in (noise.tilt_deg, noise.raw_deg, noise.shrunk_deg)}) == 1
        parts += [noise.tilt_deg, noise.raw_deg, noise.shrunk_deg]
    if not alike or not all(np.isfinite(part).all() for part in parts) or not 0.0 < error.patch_px < LARGEST_SIDE:
        raise Unsound("errors of slopes that are not as many as their tilts")
