"""From one frame to its height map: intensity, slopes, heights over skin at rest, detail, uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from device.imaging.flat_field import LinearFrame
from device.surface import NOISE_KEPT, Float32Array, GradientField, HeightMap, MaskArray
from hal.frame import RawFrame
from host_sync.denoising.slope_noise import without_blur
from host_sync.gradients.confidence import extrapolated
from host_sync.integration.integrate import IntegrationReport, surface_slopes
from host_sync.integration.zero_level import Datum
from host_sync.kernels.parallel_rows import BackgroundCall
from host_sync.kernels.process_settings import kept_memory
from host_sync.reconstruction.heights import (
    Heights,
    RestingSlopes,
    noise_of,
    raw_slope_sigma,
    sharpened,
    with_raw_detail,
)
from host_sync.reconstruction.reading_uncertainty import HeightIndependentTerms, slope_error_of, uncertainty_of
from host_sync.reconstruction.slope_reading import SlopeReading, raise_on_warnings, read_slopes
from host_sync.results.files import DetailName
from host_sync.results.record import FrameCheck, SlopeNoise
from host_sync.uncertainty.height_error import nonintegrable_residual, slope_sigma
from host_sync.uncertainty.kernels import lost_variance, with_lost_detail

if TYPE_CHECKING:
    from host_sync.calibration.calibrate import Calibration, Method
    from host_sync.reconstruction.slope_reading import LightSequence


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """One frame's surface, and how it came about.

    method : the method that estimated the slopes
    height : the height map, zero at untouched skin
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm
    samples_um : float32 array of shape (K, h, w), height errors that the data allow, over the field reduced, µm
    p, q : float32 arrays of shape (H, W), slopes of the height map over its pixels
    slope_sigma : float32 array of shape (H, W), standard uncertainty of either of them
    gradients : the slopes as estimated per pixel; of a camera nearby how they rise over pixels
    integration : what the solver reports
    extrapolated : bool array of shape (H, W), True where a slope lies beyond the calibration's training data and the
        skin is not known to be untouched
    clipped_share : share of pixels with a saturated channel
    frame_checks : what was checked of the frame, with figure and limit, and what could not be checked
    warnings : what speaks against the frame being of this calibration, or its heights having a zero; it was
        reconstructed all the same
    datum : what the height's zero was taken from
    detail : which detail the height map holds
    other : the height map with the other detail on the same long waves, None where there is one kind only
    """

    method: Method
    height: HeightMap
    sigma_um: Float32Array
    samples_um: Float32Array
    p: Float32Array
    q: Float32Array
    slope_sigma: Float32Array
    gradients: GradientField
    integration: IntegrationReport
    extrapolated: MaskArray
    clipped_share: float
    warnings: tuple[str, ...]
    frame_checks: tuple[FrameCheck, ...]
    datum: Datum
    detail: DetailName = "raw"
    other: HeightMap | None = None

    @property
    def masked_share(self) -> float:
        """Share of pixels without a height."""
        return float(np.count_nonzero(np.isnan(self.height.z_um))) / self.height.z_um.size


@kept_memory()
def reconstruct(
    frame: LinearFrame | RawFrame,
    calibration: Calibration,
    name: str,
    method: Method | None = None,
    *,
    force: bool = False,
    detail: DetailName = "shrunk",
    sequence: LightSequence | None = None,
    keep_noise: bool = False,
) -> Reconstruction:
    """Return the surface that a frame shows, by `method` or the one that the calibration's held-out balls prefer.

    force : reconstruct a frame that the calibration cannot explain too; what speaks against it stays in `warnings`
    detail : of the height map and its slopes; raw where the calibration could not separate noise from detail
    sequence : frames of each light alone, of the same press: they show where a light is hidden
    keep_noise : apply no prior that skin rests, as an instrument's certificate asks, which measures noise

    Raises
    ------
    FrameError
        The frame is black or saturated.
    CalibrationMismatch
        Its size is not the calibration's, or it was made with other lights, gel, exposure or focus, shifted or turned.
    """
    reading = read_slopes(frame, calibration, name, method or calibration.preferred, force=force, sequence=sequence)
    resting = RestingSlopes.of(reading, keep_noise=keep_noise)
    integrated, integration = resting.integrate()
    # Started only now: integration keeps all threads busy, the search for the zero one.
    height_independent = BackgroundCall(HeightIndependentTerms.of, reading)
    height_independent.start()
    noise = noise_of(frame, calibration)
    heights = Heights.of(resting, sharpened(integrated, noise), reading)
    raise_on_warnings([*reading.warnings, *heights.unlit], name, force=force)
    slopes = surface_slopes(heights.height)
    nonintegrable = nonintegrable_residual(heights.gradients, *slopes)
    uncertainty = BackgroundCall(
        uncertainty_of, heights.height, heights.gradients, nonintegrable, reading, heights.datum, height_independent
    )
    uncertainty.start()
    surface = _Surface.of(heights, slopes, resting, reading, noise, detail)
    intensity, inverse_map = reading.first.intensity, calibration.inverse.map
    beyond = extrapolated(
        intensity, inverse_map, surface.p, surface.q, reading.first.uncorrected_results.result().out_of_domain
    )
    if resting.prior is not None and not heights.datum.is_relative:
        beyond &= ~heights.datum.skin
    calibration_sigma = height_independent.result().calibration_sigma.with_unresolved(*slopes)
    kept, error = noise.shrunk_kept if noise else NOISE_KEPT, slope_error_of(calibration, reading.method)
    sigma = slope_sigma(heights.gradients, *slopes, nonintegrable, error, calibration_sigma, kept)
    known = uncertainty.result()
    return Reconstruction(
        method=reading.method,
        height=surface.height,
        sigma_um=known.sigma_um,
        samples_um=known.samples_um,
        p=surface.p,
        q=surface.q,
        slope_sigma=surface.sigma(sigma, slopes, noise),
        gradients=surface.gradients,
        integration=integration,
        extrapolated=beyond,
        clipped_share=float(np.count_nonzero(intensity.clipped)) / intensity.clipped.size,
        warnings=(*reading.warnings, *heights.unlit, *heights.doubts),
        frame_checks=(
            *reading.first.checks,
            *(FrameCheck("untouched skin", "refused", words=words) for words in heights.unlit),
            *resting.check(),
        ),
        datum=heights.datum,
        detail=surface.detail,
        other=surface.other,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The surface with the detail that was asked for.

    height, other : with this detail, and with the other one; None where there is one kind only
    p, q : slopes of `height`, float32 arrays of shape (H, W)
    gradients : the slopes as estimated
    lost : variance of slopes that shrinkage took away, float32 array of shape (H, W); None where nothing is lost
    """

    height: HeightMap
    other: HeightMap | None
    p: Float32Array
    q: Float32Array
    gradients: GradientField
    detail: DetailName
    lost: Float32Array | None

    @classmethod
    def of(
        cls,
        heights: Heights,
        slopes: tuple[Float32Array, Float32Array],
        resting: RestingSlopes,
        reading: SlopeReading,
        noise: SlopeNoise | None,
        detail: DetailName,
    ) -> _Surface:
        """Return the surface of heights whose detail is shrunk and whose slopes are given."""
        if reading.first.calibration.shrinkage is None:
            return cls(heights.height, None, *slopes, heights.gradients, "raw", None)
        gradients, integrated = resting.integrate_detail(reading.raw_gradients(), heights.height)
        raw = with_raw_detail(heights.height, without_blur(integrated, noise.raw_blur_px) if noise else integrated)
        if detail == "raw":
            return cls(raw, heights.height, *surface_slopes(raw), gradients, detail, None)
        lost = None if noise is None else lost_variance(surface_slopes(raw), slopes, noise)
        return cls(heights.height, raw, *slopes, heights.gradients, detail, lost)

    def sigma(
        self, shrunk: Float32Array, slopes: tuple[Float32Array, Float32Array], noise: SlopeNoise | None
    ) -> Float32Array:
        """Return the standard uncertainty of its slopes (H, W) from that of slopes with shrunk detail."""
        if self.lost is not None:
            return with_lost_detail(shrunk, self.lost)
        return raw_slope_sigma(shrunk, *slopes, noise) if self.p is not slopes[0] else shrunk
