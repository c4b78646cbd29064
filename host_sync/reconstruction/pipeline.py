"""From one frame to its height map: intensity, gradients, integration, level, uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from device.errors import CalibrationMismatch
from device.photometry import IntensityImage, LinearFrame, divide
from device.surface import Float32Array, GradientField, HeightMap, surface_slopes
from hal.frame import RawFrame
from host_sync.calibration.full_calibration import Calibration, Method
from host_sync.calibration.paper_model import estimate_gradients
from host_sync.reconstruction.intensity_checks import check_intensity
from host_sync.reconstruction.intensity_kernel import raw_intensity
from host_sync.reconstruction.level import levelled, untouched_skin
from host_sync.reconstruction.multigrid import IntegrationReport, integrate
from host_sync.reconstruction.plausibility import frame_doubts, rest_doubts
from host_sync.reconstruction.printed_integration import integrate_as_printed
from host_sync.reconstruction.slope_kernel import evaluate
from host_sync.reconstruction.uncertainty import contradicted_slope, height_uncertainty, raised_slopes, slope_sigma


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
    _refuse(warnings, name, force=force)
    gradients = estimate(intensity, calibration, chosen)
    solve = integrate_as_printed if chosen == "paper" else integrate
    height, integration = solve(gradients, calibration.pitch_um)
    at_rest = untouched_skin(gradients)
    warnings += rest_doubts(intensity, at_rest)
    _refuse(warnings, name, force=force)
    height = levelled(height, at_rest)
    p, q = surface_slopes(height)
    raised = raised_slopes(intensity, calibration.inverse.map, calibration.slope_error)
    contradiction = contradicted_slope(gradients, p, q)
    scale_share = calibration.assessment.scale.height_share or 0.0
    known = height_uncertainty(height, gradients, raised, contradiction, calibration.slope_error, at_rest, scale_share)
    return Reconstruction(
        method=chosen,
        height=height,
        sigma_um=known.sigma_um,
        draws_um=known.draws_um,
        p=p,
        q=q,
        slope_sigma=slope_sigma(gradients, p, q, contradiction, calibration.slope_error),
        gradients=gradients,
        integration=integration,
        clipped_share=float(intensity.clipped.mean()),
        warnings=tuple(warnings),
    )


def _refuse(doubts: Sequence[str], name: str, *, force: bool) -> None:
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
