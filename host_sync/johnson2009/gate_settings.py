"""Constants of refinement and gate, derived from the calibration.

λ (eq. 5) is the ratio of two variances: of intensity at one slope, and of the true slope about the coarse estimate. σ²
(eq. 8) is a multiple of the ε² caused by pixel noise alone, so that curvature of the reflectance closes the gate and
noise hardly does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from host_sync.johnson2009.gradient_kernel import SOBEL_VARIANCE
from host_sync.johnson2009.refinement import GateSettings
from host_sync.johnson2009.reflectance_map import ReflectanceMaps
from host_sync.johnson2009.reflectance_surface import ReflectanceSurface

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
    """Standard deviation of intensity from pixel to pixel, mean of the channels, from second differences along rows."""
    column, row, ball = samples.column, samples.row, samples.ball
    beside = (column[2:] - column[:-2] == 2) & (row[2:] == row[:-2]) & (ball[2:] == ball[:-2])
    if not beside.any():
        return _MIN_NOISE
    values = samples.intensity
    bend = (values[2:] - 2.0 * values[1:-1] + values[:-2])[beside]
    sigma = 1.4826 * np.median(np.abs(bend), axis=0) / np.sqrt(6.0)
    return max(float(np.sqrt(np.mean(sigma**2))), _MIN_NOISE)


def gate_settings(maps: ReflectanceMaps, surface: ReflectanceSurface, noise: float) -> GateSettings:
    """Settings of the kernel for a calibration with this pixel `noise`."""
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
