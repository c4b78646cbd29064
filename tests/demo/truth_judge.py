"""Compares a reconstruction with the twin's truth, at the levels of the paper's Fig. 5 (2 % / 4 %, 2° / 4°)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from device.surface import Float32Array
from hal.simulator.bench import TwinTruth
from host_sync.reconstruction.pipeline import Reconstruction

INNER_FRACTION = 0.9
"""Pixels within this fraction of the contact radius are evaluated: at the rim the skin lifts off the object."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """Errors of one surface.

    angle_deg, height_um : float arrays of shape (H, W), error of the normal (degrees) and of the height (µm)
    judged : bool array of shape (H, W), the pixels that count
    within : fraction of those pixels within 2 and 4 degrees, and within 2 and 4 % of the ball radius
    sigma_covers : fraction of those pixels whose height error is within the stated standard uncertainty
    """

    angle_deg: Float32Array
    height_um: Float32Array
    judged: NDArray[np.bool_]
    ball_radius_um: float
    sigma_covers: float

    @property
    def mean_angle_deg(self) -> float:
        """Mean error of the normal, degrees."""
        return float(self.angle_deg[self.judged].mean())

    @property
    def mean_height_um(self) -> float:
        """Mean absolute error of the height, µm."""
        return float(np.abs(self.height_um[self.judged]).mean())

    @property
    def mean_height_percent(self) -> float:
        """The same as a percentage of the ball radius."""
        return 100.0 * self.mean_height_um / self.ball_radius_um

    def within_deg(self, limit_deg: float) -> float:
        """Fraction of evaluated pixels whose normal is within a limit."""
        return float((self.angle_deg[self.judged] <= limit_deg).mean())

    def within_percent(self, limit_percent: float) -> float:
        """Fraction of evaluated pixels whose height is within a percentage of the ball radius."""
        limit_um = limit_percent / 100.0 * self.ball_radius_um
        return float((np.abs(self.height_um[self.judged]) <= limit_um).mean())


def judge(found: Reconstruction, truth: TwinTruth, ball_radius_um: float) -> Judgement:
    """Compare the reconstructed height map and its slopes with the truth; nothing is re-fitted or shifted.

    Height zero is untouched skin on both sides. Invalid pixels count as 90 degrees and as a full radius.
    """
    dot = found.p * truth.p + found.q * truth.q + 1.0
    norms = np.sqrt((1.0 + found.p**2 + found.q**2) * (1.0 + truth.p**2 + truth.q**2))
    angle = np.degrees(np.arccos(np.clip(dot / norms, -1.0, 1.0)))
    height = found.height.z_um - truth.z_um
    judged = _inner(truth.contact)
    sigma = np.abs(height[judged]) <= found.sigma_um[judged]
    return Judgement(
        angle_deg=np.where(np.isfinite(angle), angle, 90.0).astype(np.float32),
        height_um=np.where(np.isfinite(height), height, ball_radius_um).astype(np.float32),
        judged=judged,
        ball_radius_um=ball_radius_um,
        sigma_covers=float(sigma.mean()),
    )


def _inner(contact: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Contact pixels farther from its rim than a tenth of its largest inscribed radius."""
    depth = distance_transform_edt(contact)
    return np.asarray(depth > (1.0 - INNER_FRACTION) * depth.max())
