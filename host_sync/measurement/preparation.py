"""From a height map to the scale-limited surface: form removal, S-filter, L-filter (ISO 25178-3).

The operations are set up for the mask of one height map and then applied to its Monte Carlo samples as well. Nothing
else is done: no outlier is removed, no hole filled, nothing smoothed that the recipe does not state.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from device.surface.fields import Float32Array, HeightMap
from host_sync.errors import MeasurementError
from host_sync.filters.form import FormRemoval, PolynomialForm
from host_sync.filters.gaussian_regression import GaussianRegression
from host_sync.measurement.recipe import Recipe
from host_sync.measurement.sphere import SphereForm

_DEGREES: Final = {"mean": 0, "plane": 1}


class Preparation:
    """Form removal and filters of a recipe, for one height map.

    Parameters
    ----------
    height : the measured region
    recipe : form and filters

    Raises
    ------
    MeasurementError
        No pixel is valid, or the form is not determined.
    """

    def __init__(self, height: HeightMap, recipe: Recipe) -> None:
        valid = np.isfinite(height.z_um)
        if not valid.any():
            raise MeasurementError(
                "every pixel of the region is masked or beyond the calibration: choose another, or keep_extrapolated"
            )
        self._form = _form(recipe.form, height)
        formless = height.z_um if self._form is None else self._form.remove(height.z_um)
        self.valid = np.isfinite(formless)
        self._s, self._l = (
            None if index_um is None else GaussianRegression(self.valid, index_um / height.pitch_um)
            for index_um in (recipe.s_filter_um, recipe.l_filter_um)
        )
        self._l_px = None if recipe.l_filter_um is None else recipe.l_filter_um / height.pitch_um

    def apply(self, z_um: Float32Array) -> Float32Array:
        """The scale-limited surface: float32 array of shape (H, W), µm, NaN where invalid."""
        if self._form is not None:
            z_um = self._form.remove(z_um)
        if self._s is not None:
            z_um = self._s.mean(z_um)
        if self._l is not None:
            z_um = z_um - self._l.mean(z_um)
        return z_um

    def edge_share(self) -> float:
        """Fraction of valid pixels within half the L-filter's nesting index of a border or hole; 0 without L-filter."""
        if self._l_px is None:
            return 0.0
        framed = np.pad(self.valid.astype(np.uint8), 1)
        distance = cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
        return float((distance[self.valid] < 0.5 * self._l_px).mean())


def _form(name: str, height: HeightMap) -> FormRemoval | None:
    if name == "none":
        return None
    if name == "sphere":
        return SphereForm(height.pitch_um)
    degree = _DEGREES[name] if name in _DEGREES else int(name.rpartition("-")[2])
    return PolynomialForm(np.isfinite(height.z_um), degree)
