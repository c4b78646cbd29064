"""From one frame to its height map: intensity, gradients, integration, level, uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import msgspec
import numpy as np

from device.calibration.candidates import NOISE_KEPT
from device.imaging.flat_field import LinearFrame
from device.inverse_map.skin_at_rest import MIN_RESTING
from device.surface.fields import Float32Array, GradientField, HeightMap, MaskArray
from hal.frame import RawFrame
from host_sync.calibration.calibrate import Calibration, Method
from host_sync.calibration.scale import HEIGHT_PER_PITCH
from host_sync.denoising.blur_correction import BLUR_PX, without_blur
from host_sync.frame_checks.colour_check import check_datum
from host_sync.frames.light_sequence import LightSequence
from host_sync.gradients.extrapolation import extrapolated
from host_sync.gradients.surface_slope_kernel import surface_slopes
from host_sync.integration.integrate import IntegrationReport, integrate
from host_sync.integration.zero_level import NO_ZERO, Datum, find_datum, no_datum
from host_sync.johnson2009.model import integrate_forward_difference
from host_sync.kernels.kept_memory import kept_memory
from host_sync.kernels.parallel_rows import BackgroundCall
from host_sync.reconstruction.perspective import seen_elevation, seen_slopes
from host_sync.reconstruction.raw_detail import raw_slope_sigma, with_raw_detail
from host_sync.reconstruction.rest_prior import RestPrior
from host_sync.reconstruction.slope_reading import SlopeReading, raise_on_warnings, read_slopes
from host_sync.results.files import DetailName
from host_sync.results.record import FrameCheck
from host_sync.uncertainty.calibration_uncertainty import CalibrationUncertainty, calibration_uncertainty
from host_sync.uncertainty.height_error import (
    HeightUncertainty,
    height_draws,
    height_uncertainty,
    nonintegrable_residual,
    reduced_size,
    slope_sigma,
)
from host_sync.uncertainty.lost_detail import lost_variance, with_lost_detail
from host_sync.uncertainty.slope_draws import SlopeDraws
from host_sync.uncertainty.slope_error import SlopeError


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
    extrapolated : bool array of shape (H, W), True where a slope lies beyond the calibration's training data
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
    """The surface that a frame shows, by `method` or the one that the calibration's held-out balls prefer.

    force : reconstruct a frame that the calibration cannot explain too; what speaks against it stays in `warnings`
    detail : of the height map and its slopes; raw where the calibration could not tell noise from detail
    sequence : frames of each light alone, of the same press: they show where a light is hidden
    keep_noise : apply no prior that skin rests, as an instrument's certificate asks, which measures noise

    Raises
    ------
    FrameError
        The frame is black or saturated.
    CalibrationMismatch
        Its size is not the calibration's, or it was made with other lights, gel, exposure or focus, shifted or turned.
    """
    chosen = method or calibration.preferred
    reading = read_slopes(frame, calibration, name, chosen, force=force, sequence=sequence)
    intensity, warnings = reading.first.intensity, reading.warnings
    gradients = read = reading.gradients
    shrinkage, viewpoint = calibration.shrinkage, calibration.viewpoint
    if viewpoint is not None:
        gradients = seen_slopes(read, viewpoint)
    prior = None if keep_noise or chosen != "direct" else RestPrior.of(gradients, reading.rest)
    if prior is not None:
        prior.apply(read)
        gradients = read if viewpoint is None else seen_slopes(read, viewpoint)
    solve = integrate_forward_difference if chosen == "paper" else integrate
    height, integration = solve(gradients, calibration.pitch_um)
    # Started only now: integration keeps all threads busy, the search for the zero one.
    before_heights = BackgroundCall(_BeforeHeights.of, reading)
    before_heights.start()
    noise = calibration.slope_noise
    if noise is not None and not (isinstance(frame, RawFrame) or frame.demosaiced):
        # What a calibration of raw frames gives back for demosaicing is not missing from images that came with colours.
        noise = msgspec.structs.replace(noise, blur_px=min(noise.blur_px, BLUR_PX), raw_blur_px=0.0)
    if noise is not None:
        height = without_blur(height, noise.blur_px)
    at_rest = None if prior is None else prior.at_rest(height.z_um.shape)
    found = find_datum(height, gradients, at_rest=at_rest) if reading.has_rest else no_datum(height, gradients)
    datum = found.at_rest(height, gradients)
    gain_sigma = calibration.skin_at_rest.gain_sigma if calibration.skin_at_rest else 0.0
    unlit = [] if datum.is_relative else check_datum(intensity, datum.skin, gain_sigma)
    warnings += unlit
    told = (FrameCheck("untouched skin", "refused", words=words) for words in unlit)
    checks = (*reading.first.checks, *told)
    if prior is not None:
        checks = (*checks, FrameCheck("skin at rest", "passed", prior.resting, MIN_RESTING, "of the field"))
    raise_on_warnings(warnings, name, force=force)
    if datum.is_relative:
        warnings += [NO_ZERO]
    height = datum.level(height)
    if viewpoint is not None:
        height = seen_elevation(height, viewpoint)
        gradients = seen_slopes(read, viewpoint, height, out=gradients)
    slopes = surface_slopes(height)
    integrated = gradients
    contradiction = nonintegrable_residual(integrated, *slopes)
    uncertainty = BackgroundCall(_uncertainty, height, integrated, contradiction, reading, datum, before_heights)
    uncertainty.start()
    shown, other, lost = height, None, None
    if shrinkage is not None:
        raw_gradients = reading.raw_gradients()
        if viewpoint is not None:
            raw_gradients = seen_slopes(raw_gradients, viewpoint, height)
        if prior is not None:
            prior.apply(raw_gradients)
        raw = solve(raw_gradients, calibration.pitch_um)[0]
        other = with_raw_detail(height, without_blur(raw, noise.raw_blur_px) if noise else raw)
        if noise is not None and detail == "shrunk":
            lost = lost_variance(surface_slopes(other), slopes, noise)
        if detail == "raw":
            shown, other, gradients = other, height, raw_gradients
    p, q = slopes if shown is height else surface_slopes(shown)
    strange = extrapolated(intensity, calibration.inverse.map, p, q, reading.first.meanwhile.result().strange)
    unsure = before_heights.result().unsure.with_unresolved(*slopes)
    kept = noise.shrunk_kept if noise else NOISE_KEPT
    slopes_sigma = slope_sigma(integrated, *slopes, contradiction, slope_error_of(calibration, chosen), unsure, kept)
    known = uncertainty.result()
    if lost is not None:
        slopes_sigma = with_lost_detail(slopes_sigma, lost)
    if shown is not height:
        slopes_sigma = raw_slope_sigma(slopes_sigma, *slopes, noise)
    return Reconstruction(
        method=chosen,
        height=shown,
        sigma_um=known.sigma_um,
        samples_um=known.samples_um,
        p=p,
        q=q,
        slope_sigma=slopes_sigma,
        gradients=gradients,
        integration=integration,
        extrapolated=strange,
        clipped_share=float(np.count_nonzero(intensity.clipped)) / intensity.clipped.size,
        warnings=tuple(warnings),
        frame_checks=checks,
        datum=datum,
        detail="raw" if shrinkage is None else detail,
        other=other,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _BeforeHeights:
    """What a result needs beside its heights and does not take from them, so that both are made at once.

    unsure : what the calibration does not know of slopes, on the reduced field (h, w)
    shadow : standard uncertainties of slopes p and q where a light is hidden, float32 arrays of shape (h, w); None
        where nothing corrects slopes
    draws : random numbers behind the samples of height errors
    """

    unsure: CalibrationUncertainty
    shadow: tuple[Float32Array, Float32Array] | None
    draws: SlopeDraws

    @classmethod
    def of(cls, reading: SlopeReading) -> _BeforeHeights:
        """That of a reading's result."""
        first, shape = reading.first, reading.first.intensity.shape
        size = reduced_size(shape)
        unsure = _calibration_uncertainty(reading, size)
        shadow = None if first.correction is None else first.correction.sigma(size)
        draws = height_draws(slope_error_of(first.calibration, reading.method), shape, unsure, shadow)
        return cls(unsure, shadow, draws)


def _uncertainty(
    height: HeightMap,
    gradients: GradientField,
    contradiction: Float32Array,
    reading: SlopeReading,
    datum: Datum,
    before_heights: BackgroundCall[_BeforeHeights],
) -> HeightUncertainty:
    """What is not known of heights.

    height : with shrunk detail, levelled to the datum
    gradients : as they were integrated, of a camera nearby times what elevation changes, with their confidence
    contradiction : as `nonintegrable_residual` returns it for them
    before_heights : of the same reading
    """
    before, calibration = before_heights.result(), reading.first.calibration
    return height_uncertainty(
        height,
        gradients,
        contradiction,
        slope_error_of(calibration, reading.method),
        datum,
        known_scale_share(calibration),
        calibration=before.unsure,
        shadow=before.shadow,
        draws=before.draws,
    )


def _calibration_uncertainty(reading: SlopeReading, size: tuple[int, int]) -> CalibrationUncertainty:
    """What the calibration does not know, on a field of `size` (w, h): of what corrects slopes, or of the map."""
    first = reading.first
    replicas = first.calibration.inverse.replicas if reading.method == "direct" else ()
    correction = first.correction
    if correction is None or correction.unsure is None:
        return calibration_uncertainty(first.intensity, replicas, size)
    of_correction = CalibrationUncertainty.of(correction.unsure(), size)
    if correction.left_alone is None or not correction.left_alone.any():
        return of_correction
    share = np.asarray(cv2.resize(correction.left_alone, size, interpolation=cv2.INTER_LINEAR), np.float32)
    return of_correction.mixed_with(calibration_uncertainty(first.intensity, replicas, size), share)


def slope_error_of(calibration: Calibration, method: Method) -> SlopeError:
    """The slope error of a method: the default's as measured, the paper's larger as its held-out balls say."""
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
    """Standard uncertainty of the height's scale, as a share, from what of it was measured."""
    scale = calibration.assessment.scale
    return float(np.hypot(HEIGHT_PER_PITCH * (scale.pixel_pitch_share or 0.0), scale.ball_radius_share or 0.0))
