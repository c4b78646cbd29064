"""Uncertainty of a frame's heights: of its calibration, of shadows, of noise, of its zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import msgspec
import numpy as np

from device.surface import Float32Array, GradientField, HeightMap
from host_sync.integration.zero_level import Datum
from host_sync.kernels.parallel_rows import BackgroundCall
from host_sync.reconstruction.slope_reading import SlopeReading
from host_sync.results.record import HEIGHT_PER_PITCH
from host_sync.uncertainty.calibration_uncertainty import CalibrationUncertainty, calibration_uncertainty
from host_sync.uncertainty.height_error import (
    HeightUncertainty,
    SlopeDraws,
    height_draws,
    height_uncertainty,
    reduced_size,
)

if TYPE_CHECKING:
    from host_sync.calibration.calibrate import Calibration, Method
    from host_sync.uncertainty.slope_error import SlopeError


@dataclass(frozen=True, slots=True, eq=False)
class HeightIndependentTerms:
    """Parts of a result that do not depend on its heights, so that both are computed at once.

    calibration_sigma : standard uncertainty of slopes that the calibration leaves, on the reduced field (h, w)
    shadow : standard uncertainties of slopes p and q where a light is hidden, float32 arrays of shape (h, w); None
        where nothing corrects slopes
    draws : random numbers behind the samples of height errors
    """

    calibration_sigma: CalibrationUncertainty
    shadow: tuple[Float32Array, Float32Array] | None
    draws: SlopeDraws

    @classmethod
    def of(cls, reading: SlopeReading) -> HeightIndependentTerms:
        """Return the terms of a reading's result."""
        first, shape = reading.first, reading.first.intensity.shape
        size = reduced_size(shape)
        calibration = _calibration_uncertainty(reading, size)
        shadow = None if first.correction is None else first.correction.sigma(size)
        draws = height_draws(slope_error_of(first.calibration, reading.method), shape, calibration, shadow)
        return cls(calibration, shadow, draws)


def uncertainty_of(
    height: HeightMap,
    gradients: GradientField,
    nonintegrable: Float32Array,
    reading: SlopeReading,
    datum: Datum,
    height_independent: BackgroundCall[HeightIndependentTerms],
) -> HeightUncertainty:
    """Return the uncertainty of heights.

    height : with shrunk detail, levelled to the datum
    gradients : as they were integrated, of a camera nearby times what elevation changes, with their confidence
    nonintegrable : as `nonintegrable_residual` returns it for them
    height_independent : of the same reading
    """
    terms, calibration = height_independent.result(), reading.first.calibration
    return height_uncertainty(
        height,
        gradients,
        nonintegrable,
        slope_error_of(calibration, reading.method),
        datum,
        known_scale_share(calibration),
        calibration=terms.calibration_sigma,
        shadow=terms.shadow,
        draws=terms.draws,
    )


def _calibration_uncertainty(reading: SlopeReading, size: tuple[int, int]) -> CalibrationUncertainty:
    """Return the calibration's uncertainty, of corrections or of the map, on a field of `size` (w, h)."""
    first = reading.first
    replicas = first.calibration.inverse.replicas if reading.method == "direct" else ()
    correction = first.correction
    if correction is None or correction.slope_deviations is None:
        return calibration_uncertainty(first.intensity, replicas, size)
    of_correction = CalibrationUncertainty.of(correction.slope_deviations(), size)
    if correction.left_alone is None or not correction.left_alone.any():
        return of_correction
    share = np.asarray(cv2.resize(correction.left_alone, size, interpolation=cv2.INTER_LINEAR), np.float32)
    return of_correction.mixed_with(calibration_uncertainty(first.intensity, replicas, size), share)


def slope_error_of(calibration: Calibration, method: Method) -> SlopeError:
    """Return the slope error of a method: the default's as measured, the paper's larger by its held-out balls."""
    held_out = calibration.held_out_deg
    if method == "direct" or not held_out["paper"] > held_out["direct"]:
        return calibration.slope_error
    share = held_out["paper"] / held_out["direct"]
    error = calibration.slope_error
    return msgspec.structs.replace(
        error,
        pixel_deg=tuple(share * part for part in error.pixel_deg),
        patch_deg=tuple(share * part for part in error.patch_deg),
        ball_gains=tuple(tuple(share * gain for gain in ball) for ball in error.ball_gains),
    )


def known_scale_share(calibration: Calibration) -> float:
    """Return the standard uncertainty of the height's scale, as a share, from what of it was measured."""
    scale = calibration.assessment.scale
    return float(np.hypot(HEIGHT_PER_PITCH * (scale.pixel_pitch_share or 0.0), scale.ball_radius_share or 0.0))
