"""From one frame to its height map: intensity, gradients, integration, level, uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from device.photometry import IntensityImage, LinearFrame, divide
from device.surface import Float32Array, GradientField, HeightMap, surface_slopes
from hal.frame import RawFrame
from host_sync.calibration.full_calibration import Calibration, Method
from host_sync.calibration.paper_model import estimate_gradients
from host_sync.reconstruction.intensity_checks import check_intensity
from host_sync.reconstruction.intensity_kernel import raw_intensity
from host_sync.reconstruction.level import levelled, untouched_skin
from host_sync.reconstruction.multigrid import IntegrationReport, integrate
from host_sync.reconstruction.printed_integration import integrate_as_printed
from host_sync.reconstruction.slope_kernel import evaluate
from host_sync.reconstruction.uncertainty import contradicted_slope, height_sigma_um, raised_slopes
from host_sync.softening import softened


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """One frame's surface, and how it came about.

    method : the method that estimated the slopes
    height : the height map, zero at untouched skin
    sigma_um : float32 array of shape (H, W), standard uncertainty of the height, µm
    p, q : float32 arrays of shape (H, W), slopes of the height map
    gradients : the slopes as estimated per pixel, before integration
    integration : what the solver reports
    clipped_share : share of pixels with a saturated channel
    """

    method: Method
    height: HeightMap
    sigma_um: Float32Array
    p: Float32Array
    q: Float32Array
    gradients: GradientField
    integration: IntegrationReport
    clipped_share: float

    @property
    def masked_share(self) -> float:
        """Share of pixels without a height."""
        return float(np.isnan(self.height.z_um).mean())


def reconstruct(
    frame: LinearFrame, calibration: Calibration, name: str, method: Method | None = None
) -> Reconstruction:
    """The surface that a frame shows, by `method` or the one that the calibration's held-out balls prefer.

    Raises
    ------
    FrameError
        The frame is black or saturated.
    CalibrationMismatch
        Its size or channel order is not the calibration's.
    """
    return reconstruct_intensity(divide(frame, calibration.divisor), calibration, name, method)


def reconstruct_raw(
    frame: RawFrame, calibration: Calibration, name: str, method: Method | None = None
) -> Reconstruction:
    """The same from a raw frame, which becomes intensity in one pass; errors as for `reconstruct`."""
    return reconstruct_intensity(raw_intensity(frame, calibration.divisor), calibration, name, method)


def reconstruct_intensity(
    intensity: IntensityImage, calibration: Calibration, name: str, method: Method | None = None
) -> Reconstruction:
    """The same from intensity under the calibration's divisor; errors as for `reconstruct`."""
    chosen = method or calibration.preferred
    check_intensity(intensity, calibration.divisor, name)
    gradients = estimate(intensity, calibration, chosen)
    solve = integrate_as_printed if chosen == "paper" else integrate
    height, integration = solve(gradients, calibration.pitch_um)
    at_rest = untouched_skin(gradients)
    height = levelled(height, at_rest)
    p, q = surface_slopes(height)
    raised = raised_slopes(gradients, intensity, calibration.inverse.map, calibration.slope_error)
    contradiction = contradicted_slope(gradients, p, q)
    sigma_um = height_sigma_um(height, gradients, raised, contradiction, calibration.slope_error, at_rest)
    clipped = float(intensity.clipped.mean())
    return Reconstruction(chosen, height, sigma_um, p, q, gradients, integration, clipped)


def estimate(intensity: IntensityImage, calibration: Calibration, method: Method) -> GradientField:
    """Slopes per pixel by the method."""
    if method == "paper":
        return estimate_gradients(calibration.paper, intensity)
    return evaluate(calibration.inverse.map, softened(intensity))
