"""From one frame to its height map: intensity, gradients, integration, level, uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from device.errors import CalibrationMismatch
from device.photometry import IntensityImage, LinearFrame, divide
from device.surface import Float32Array, GradientField, HeightMap, MaskArray, surface_slopes
from hal.frame import RawFrame
from host_sync.calibration.full_calibration import Calibration, Method
from host_sync.calibration.paper_model import estimate_gradients
from host_sync.calibration.scale_uncertainty import HEIGHT_PER_PITCH
from host_sync.calibration.slope_error import SlopeError
from host_sync.reconstruction.extrapolation import extrapolated
from host_sync.reconstruction.intensity_checks import check_intensity
from host_sync.reconstruction.intensity_kernel import raw_intensity
from host_sync.reconstruction.multigrid import IntegrationReport, integrate
from host_sync.reconstruction.plausibility import frame_doubts, rest_doubts
from host_sync.reconstruction.printed_integration import integrate_as_printed
from host_sync.reconstruction.rest_level import levelled, untouched_skin
from host_sync.reconstruction.slope_kernel import evaluate
from host_sync.reconstruction.uncertainty import contradicted_slope, height_uncertainty, slope_sigma, slopes_at_rest


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """One frame's surface, and how it came about.

    method : the method that estimated the slopes
    height : the height map, zero at untouched skin
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm
    draws_um : float32 array of shape (K, h, w), height errors that the data allow, over the field reduced, µm
    p, q : float32 arrays of shape (H, W), slopes of the height map
    slope_sigma : float32 array of shape (H, W), standard uncertainty of either of them
    gradients : the slopes as estimated per pixel, before integration
    integration : what the solver reports
    extrapolated : bool array of shape (H, W), True where a slope lies beyond what the calibration taught
    clipped_share : share of pixels with a saturated channel
    warnings : what speaks against the frame being of this calibration; it was reconstructed all the same
    """

    method: Method
    height: HeightMap
    sigma_um: Float32Array
    draws_um: Float32Array
    p: Float32Array
    q: Float32Array
    slope_sigma: Float32Array
    gradients: GradientField
    integration: IntegrationReport
    extrapolated: MaskArray
    clipped_share: float
    warnings: tuple[str, ...]

    @property
    def masked_share(self) -> float:
        """Share of pixels without a height."""
        return float(np.isnan(self.height.z_um).mean())


def reconstruct(
    frame: LinearFrame, calibration: Calibration, name: str, method: Method | None = None, *, force: bool = False
) -> Reconstruction:
    """The surface that a frame shows, by `method` or the one that the calibration's held-out balls prefer.

    force : reconstruct a frame that the calibration cannot explain too; what speaks against it stays in `warnings`

    Raises
    ------
    FrameError
        The frame is black or saturated.
    CalibrationMismatch
        Its size or channel order is not the calibration's, or it was made with other lights, gel, exposure or turned.
    """
    return reconstruct_intensity(divide(frame, calibration.divisor), calibration, name, method, force=force)


def reconstruct_raw(
    frame: RawFrame, calibration: Calibration, name: str, method: Method | None = None, *, force: bool = False
) -> Reconstruction:
    """The same from a raw frame, which becomes intensity in one pass; errors as for `reconstruct`."""
    return reconstruct_intensity(raw_intensity(frame, calibration.divisor), calibration, name, method, force=force)


def reconstruct_intensity(
    intensity: IntensityImage, calibration: Calibration, name: str, method: Method | None = None, *, force: bool = False
) -> Reconstruction:
    """The same from intensity under the calibration's divisor; errors as for `reconstruct`."""
    chosen = method or calibration.preferred
    check_intensity(intensity, calibration.divisor, name)
    warnings = frame_doubts(intensity, calibration.divisor, calibration.inverse.map)
    refuse_doubtful(warnings, name, force=force)
    gradients = estimate(intensity, calibration, chosen)
    solve = integrate_as_printed if chosen == "paper" else integrate
    height, integration = solve(gradients, calibration.pitch_um)
    at_rest = untouched_skin(gradients)
    warnings += rest_doubts(intensity, at_rest)
    refuse_doubtful(warnings, name, force=force)
    height = levelled(height, at_rest)
    p, q = surface_slopes(height)
    error = slope_error_of(calibration, chosen)
    contradiction = contradicted_slope(gradients, p, q)
    resting = slopes_at_rest(calibration.inverse.map)
    known = height_uncertainty(
        height, gradients, contradiction, error, resting, at_rest, known_scale_share(calibration)
    )
    return Reconstruction(
        method=chosen,
        height=height,
        sigma_um=known.sigma_um,
        draws_um=known.draws_um,
        p=p,
        q=q,
        slope_sigma=slope_sigma(gradients, p, q, contradiction, error),
        gradients=gradients,
        integration=integration,
        extrapolated=extrapolated(intensity, calibration.inverse.map, p, q),
        clipped_share=float(intensity.clipped.mean()),
        warnings=tuple(warnings),
    )


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
        scale_share=share * error.scale_share,
    )


def known_scale_share(calibration: Calibration) -> float:
    """Standard uncertainty of the height's scale, as a share, from what of it was measured."""
    scale = calibration.assessment.scale
    return float(np.hypot(HEIGHT_PER_PITCH * (scale.pixel_pitch_share or 0.0), scale.ball_radius_share or 0.0))


def refuse_doubtful(doubts: Sequence[str], name: str, *, force: bool) -> None:
    """Refuse a frame that something speaks against, unless it is forced.

    Raises
    ------
    CalibrationMismatch
        Says what speaks against it.
    """
    if doubts and not force:
        raise CalibrationMismatch(
            f"{name} was not made as its calibration was: {'; '.join(doubts)}. Use a calibration of these lights and "
            "this gel, or --force to reconstruct it all the same"
        )


def estimate(intensity: IntensityImage, calibration: Calibration, method: Method) -> GradientField:
    """Slopes per pixel by the method."""
    if method == "paper":
        return estimate_gradients(calibration.paper, intensity)
    return evaluate(calibration.inverse.map, intensity)
