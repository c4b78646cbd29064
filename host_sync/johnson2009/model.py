"""The complete method of the paper, and the integration that it prints.

The method consists of reflectance maps, spherical harmonics, lookup table, refinement and gate (section 5.1).

It assumes that reflectance is the same everywhere in the field; `device.inverse_map.model` does not.

Constants of refinement and gate are derived from the calibration: λ (eq. 5) is the ratio of two variances: of intensity
at one slope, and of the true slope about the coarse estimate. σ² (eq. 8) is a multiple of the ε² caused by pixel noise
alone, so that curvature of the reflectance closes the gate and noise hardly does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.imaging.flat_field import NormalizedImage
from device.surface import GradientField, HeightMap
from host_sync.integration.integrate import IntegrationReport, integrate
from host_sync.johnson2009.gradient_kernel import SOBEL_VARIANCE, GateSettings, estimate_slopes
from host_sync.johnson2009.lookup_table import LookupTable, build_table, colour_cube
from host_sync.johnson2009.spherical_harmonics import (
    LAMBERTIAN_ORDER,
    HarmonicFit,
    ReflectanceMaps,
    ReflectanceSurface,
    fit_harmonics,
    reflectance_surface,
    sample_reflectance,
)

STEP_SPREAD: Final = 0.2
"""Standard deviation of the true slope about the coarse estimate, assumed for λ."""

GATE_RATIO: Final = 10.0
"""σ² of the gate relative to the ε² of pixel noise."""

NOISE_QUANTILE: Final = 2.6
"""95 % quantile of ε² relative to its mean: chi-squared with three degrees of freedom."""

TRUSTED_SCATTER: Final = 4.0
"""At this distance from the model's colours, in scatters, confidence is a quarter."""

LOST_SCATTER: Final = 40.0
"""Beyond this distance from the model's colours, in scatters, a slope is invalid."""

_MIN_NOISE: Final = 1e-3


def pixel_noise(samples: BallSamples) -> float:
    """Return the standard deviation of intensity from pixel to pixel, root mean square of the channels.

    It comes from second differences along rows.
    """
    column, row, ball = samples.column, samples.row, samples.ball
    beside = (column[2:] - column[:-2] == 2) & (row[2:] == row[:-2]) & (ball[2:] == ball[:-2])
    if not beside.any():
        return _MIN_NOISE
    values = samples.intensity
    bend = (values[2:] - 2.0 * values[1:-1] + values[:-2])[beside]
    sigma = 1.4826 * np.median(np.abs(bend), axis=0) / np.sqrt(6.0)
    return max(float(np.sqrt(np.mean(sigma**2))), _MIN_NOISE)


def gate_settings(maps: ReflectanceMaps, surface: ReflectanceSurface, noise: float) -> GateSettings:
    """Return settings of the kernel for a calibration with this pixel `noise`."""
    colour = max(float(np.mean(maps.scatter**2)), noise**2)
    tikhonov = colour / STEP_SPREAD**2
    noise_error = 3.0 * SOBEL_VARIANCE * noise**2
    flat, jacobian = surface.with_jacobian(np.zeros(1), np.zeros(1))
    gram = jacobian[0].T @ jacobian[0] + tikhonov * np.eye(2)
    untouched = float(np.linalg.norm(1.0 - flat[0]))
    scatter = float(np.sqrt(3.0 * colour))
    return GateSettings(
        tikhonov=np.float32(tikhonov),
        gate=np.float32(GATE_RATIO * noise_error),
        noise=np.float32(NOISE_QUANTILE * noise_error),
        flat_variance=np.float32(np.trace(np.linalg.inv(gram))),
        trusted=np.float32(TRUSTED_SCATTER * scatter + untouched),
        lost=np.float32(LOST_SCATTER * scatter + untouched),
    )


CLIPPED_CONFIDENCE: Final = 0.03
"""Confidence in the slope of a pixel with a saturated channel: its neighbours dominate, but it leaves no hole."""

UNTOUCHED_NOISE: Final = 5.0
"""A colour within this many standard deviations of pixel noise from intensity 1 is untouched skin."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperModel:
    """Model that the method fits to balls.

    maps : observed intensity by slope
    lambertian, harmonics : fits of spherical harmonics of orders 2 and 5 to the maps
    table : slope candidates by colour
    settings : constants of refinement and gate
    """

    maps: ReflectanceMaps
    lambertian: HarmonicFit
    harmonics: HarmonicFit
    table: LookupTable
    settings: GateSettings

    @property
    def residual_order_2(self) -> tuple[float, float, float]:
        """Root mean square residual of the Lambertian approximation, intensity, one per channel."""
        return self.lambertian.residual

    @property
    def residual_order_5(self) -> tuple[float, float, float]:
        """Root mean square residual of the harmonics up to order 5, intensity, one per channel."""
        return self.harmonics.residual


def fit_paper_model(samples: BallSamples) -> PaperModel:
    """Fit the model to samples of balls.

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


def estimate_gradients(model: PaperModel, image: NormalizedImage) -> GradientField:
    """Return the slope, validity and relative confidence of every pixel (paper, eqs. 5 to 8)."""
    values, lit = np.ascontiguousarray(image.values, np.float32), np.ascontiguousarray(image.valid)
    p, q, weight = estimate_slopes(values, lit, model.table, model.settings)
    weight[image.clipped] *= np.float32(CLIPPED_CONFIDENCE)
    return GradientField(p, q, weight > 0.0, weight)


def integrate_forward_difference(gradients: GradientField, pitch_um: float) -> tuple[HeightMap, IntegrationReport]:
    """Return the height map that minimizes the paper's E (eqs. 9 and 10), and a report.

    Pixels without a slope are holes.

    E(z) = Σ (∂f/∂x - p)² + (∂f/∂y - q)² with ∂f/∂x = f(x + 1, y) - f(x, y): a pixel's slope is used as the height
    difference to its next neighbour, half a pixel off, and every pixel has the same weight. The default method averages
    slopes onto the edges and weights them (see `integration.edges`).
    """
    unweighted = replace(gradients, weight=gradients.valid.astype(np.float32))
    return integrate(unweighted, pitch_um, edges="printed")
