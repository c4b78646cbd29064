"""The paper's method whole: reflectance maps, spherical harmonics, lookup table, refinement and gate (section 5.1).

It assumes that reflectance is the same everywhere in the field; `device.inverse_map` does not.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from device.ball import BallSamples
from device.errors import RecordError
from device.photometry import IntensityImage
from device.surface import GradientField
from host_sync.calibration.gate_settings import gate_settings, pixel_noise
from host_sync.calibration.lookup_table import LookupTable, build_table, colour_cube
from host_sync.calibration.reflectance_map import ReflectanceMaps, sample_reflectance
from host_sync.calibration.reflectance_surface import reflectance_surface
from host_sync.calibration.spherical_harmonics import LAMBERTIAN_ORDER, HarmonicFit, fit_harmonics
from host_sync.reconstruction.candidate_refinement import GateSettings
from host_sync.reconstruction.gradient_kernel import estimate_slopes

CLIPPED_CONFIDENCE: Final = 0.03
"""Confidence in the slope of a pixel with a saturated channel: its neighbours decide, yet no hole is torn."""

UNTOUCHED_NOISE: Final = 5.0
"""A colour within this many standard deviations of pixel noise from intensity 1 is untouched skin."""

_TABLE_ARRAYS: Final = ("low", "step", "bin_of", "first", "candidates")
_MAP_ARRAYS: Final = ("mean", "variance", "count")


@dataclass(frozen=True, slots=True, eq=False)
class PaperModel:
    """Everything the paper's method learns from balls.

    maps : observed intensity by slope
    lambertian, harmonics : its sums of spherical harmonics of orders 2 and 5
    table : slope candidates by colour
    settings : what refinement and gate weigh by
    """

    maps: ReflectanceMaps
    lambertian: HarmonicFit
    harmonics: HarmonicFit
    table: LookupTable
    settings: GateSettings

    @property
    def residual_order_2(self) -> tuple[float, float, float]:
        """Root mean square residual of the Lambertian approximation, intensity, one a channel."""
        return self.lambertian.residual

    @property
    def residual_order_5(self) -> tuple[float, float, float]:
        """The same of the harmonics up to order 5."""
        return self.harmonics.residual

    def save(self, path: Path) -> None:
        """Write the model to an npz file; `load_paper_model` reads back the same bits."""
        arrays: dict[str, NDArray[Any]] = {
            "reach": np.array(self.maps.reach),
            "settings": np.array(self.settings, np.float32),
        }
        for name, fit in (("lambertian", self.lambertian), ("harmonics", self.harmonics)):
            arrays |= {f"{name}_coefficients": fit.coefficients, f"{name}_residual": np.array(fit.residual)}
        arrays |= {f"table_{name}": getattr(self.table, name) for name in _TABLE_ARRAYS}
        arrays |= {f"maps_{name}": getattr(self.maps, name) for name in _MAP_ARRAYS}
        with path.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)


def fit_paper_model(samples: BallSamples) -> PaperModel:
    """The paper's model learned from samples of balls.

    Raises
    ------
    CalibrationError
        The balls show too few different slopes.
    """
    maps = sample_reflectance(samples)
    lambertian, harmonics = fit_harmonics(maps, LAMBERTIAN_ORDER), fit_harmonics(maps)
    surface = reflectance_surface(maps, harmonics)
    noise = pixel_noise(samples)
    table = build_table(surface, *colour_cube(samples.intensity, noise), UNTOUCHED_NOISE * noise)
    return PaperModel(maps, lambertian, harmonics, table, gate_settings(maps, surface, noise))


def estimate_gradients(model: PaperModel, image: IntensityImage) -> GradientField:
    """Slope, validity and relative confidence of every pixel (paper, eqs. 5 to 8)."""
    table = model.table
    p, q, weight = estimate_slopes(
        np.ascontiguousarray(image.values, np.float32),
        np.ascontiguousarray(image.valid),
        table.low,
        table.step,
        table.bin_of,
        table.first,
        table.candidates,
        model.settings,
    )
    weight[image.clipped] *= np.float32(CLIPPED_CONFIDENCE)
    return GradientField(p, q, weight > 0.0, weight)


def load_paper_model(path: Path) -> PaperModel:
    """The model that `PaperModel.save` wrote.

    Raises
    ------
    RecordError
        The file is missing, damaged, or holds something else.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return _from_arrays({name: arrays[name] for name in arrays.files})
    except (OSError, ValueError, TypeError, KeyError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise RecordError(f"{path} holds no model of the paper's method ({error}): calibrate again") from error


def _from_arrays(arrays: Mapping[str, NDArray[Any]]) -> PaperModel:
    maps = ReflectanceMaps(float(arrays["reach"]), *(arrays[f"maps_{name}"] for name in _MAP_ARRAYS))
    lambertian, harmonics = (_harmonics(arrays, name) for name in ("lambertian", "harmonics"))
    table = LookupTable(*(arrays[f"table_{name}"] for name in _TABLE_ARRAYS))
    return PaperModel(maps, lambertian, harmonics, table, GateSettings(*arrays["settings"]))


def _harmonics(arrays: Mapping[str, NDArray[Any]], name: str) -> HarmonicFit:
    coefficients = arrays[f"{name}_coefficients"]
    red, green, blue = (float(value) for value in arrays[f"{name}_residual"])
    return HarmonicFit(round(float(np.sqrt(len(coefficients)))) - 1, coefficients, (red, green, blue))
