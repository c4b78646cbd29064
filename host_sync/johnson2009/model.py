"""The complete method of the paper, its held-out error, and the integration that it prints.

The method consists of reflectance maps, spherical harmonics, lookup table, refinement and gate (section 5.1).

It assumes that reflectance is the same everywhere in the field; `device.inverse_map.model` does not.

Constants of refinement and gate are derived from the calibration: λ (eq. 5) is the ratio of two variances: of intensity
at one slope, and of the true slope about the coarse estimate. σ² (eq. 8) is a multiple of the ε² caused by pixel noise
alone, so that curvature of the reflectance closes the gate and noise hardly does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball, BallSamples, gather_samples
from device.calibration.cross_validation import angle_between_deg
from device.imaging.flat_field import NormalizedImage
from device.surface import Float64Array, GradientField, HeightMap
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
    slopes onto the edges and weights them (see `integration.levels`).
    """
    unweighted = replace(gradients, weight=gradients.valid.astype(np.float32))
    return integrate(unweighted, pitch_um, edges="printed")


FOLDS: Final = 3


def held_out_paper_deg(presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]]) -> float:
    """Return the mean angular error of the normal over held-out balls, degrees; NaN with fewer than two balls."""
    numbered = [(press, ball) for press, (_, balls) in enumerate(presses) for ball in balls]
    if len(numbered) < 2:
        return float("nan")
    folds = min(FOLDS, len(numbered))
    errors = []
    for fold in range(folds):
        held = set(numbered[fold::folds])
        training = [
            (image, [ball for ball in balls if (press, ball) not in held])
            for press, (image, balls) in enumerate(presses)
        ]
        model = fit_paper_model(gather_samples(training))
        errors += [_ball_error_deg(model, presses[press][0], ball) for press, ball in sorted(held, key=str)]
    return float(np.concatenate(errors).mean())


def _ball_error_deg(model: PaperModel, image: NormalizedImage, ball: Ball) -> Float64Array:
    """Return the angular error at every usable pixel inside one ball's contact, degrees."""
    reach = int(np.ceil(ball.contact_radius_px)) + 3
    top, left = max(round(ball.row) - reach, 0), max(round(ball.column) - reach, 0)
    window = (slice(top, round(ball.row) + reach), slice(left, round(ball.column) + reach))
    crop = NormalizedImage(image.values[window], image.valid[window], image.clipped[window])
    gradients = estimate_gradients(model, crop)
    truth = gather_samples([(image, [ball])])
    row, column = truth.row.astype(np.intp) - top, truth.column.astype(np.intp) - left
    inside = (row < crop.shape[0]) & (column < crop.shape[1])
    row, column = row[inside], column[inside]
    usable = gradients.valid[row, column]
    slope = np.stack([gradients.p[row, column], gradients.q[row, column]], axis=-1)[usable]
    true = np.stack([truth.p, truth.q], axis=-1)[inside][usable]
    return angle_between_deg(slope.astype(np.float64), true.astype(np.float64))
