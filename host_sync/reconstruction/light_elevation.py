"""How high skin stands where none of it is untouched: skin that is nearer to the lamps shows another light.

Three channels tell two slopes of every cell. What slopes cannot explain changes with elevation, and with the brightness
of each lamp, by patterns over the field that are known as the lamps are. So both are found, although untouched skin is
nowhere seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array
from host_sync.calibration.lamp_drift import MIN_SIGMA, believed_share
from host_sync.lights.lamp_slopes import LampSkin

RISE_PX: Final = 1.0
"""Elevation by which the change of light is taken."""

BLOCKS: Final = 4
"""Parts of the field along each side; how much the elevation differs without one of them is its uncertainty."""

OUTLIER: Final = 3.0
"""Cells are left out that differ by more than so many standard deviations, as the median tells them."""

MIN_CELLS: Final = 200
MIN_BLOCKS: Final = 8

MAX_ROUNDS: Final = 8
CLOSE_PX: Final = 0.05
"""The search ends where the skin stands no more than this higher than it was taken to."""

FIRST_SHARE: Final = 0.6
"""Of what the light tells at first, the first move: heights that were found too low tell too much."""

DRIFT_ROUNDS: Final = 12
DRIFT_SHARE: Final = 0.35
"""Rounds in which the lamps' levels are followed, too, and share of what the light tells that each moves."""

RESPONSES: Final = (-3.0, -0.5)
"""By how much what is left of an elevation changes with what is taken for it, at most and at least."""


@dataclass(frozen=True, slots=True, eq=False)
class Rise:
    """By how much a field of skin stands higher than it was taken to, and its lamps shine brighter.

    z_px : pixels
    levels : logarithms, float64 array of shape (3,)
    parts : both without one part of the field each, float64 array of shape (B, 4)
    """

    z_px: float
    levels: Float64Array
    parts: Float64Array

    @property
    def sigma_px(self) -> float:
        """Standard uncertainty of the elevation, pixels."""
        return float(np.sqrt(self._covariance[0, 0]))

    @property
    def drift(self) -> Float64Array:
        """The lamps' levels, as far as they are more than their uncertainty."""
        return self.levels * believed_share(self.levels, self._covariance[1:, 1:] + MIN_SIGMA**2 * np.eye(3))

    def deviations(self) -> Float64Array:
        """Deviations of elevation and levels whose squares add to their variance at the search's end: shape (5, 4)."""
        size, along = np.linalg.eigh(self._covariance)
        left = np.array([self.z_px, *self.drift])
        return np.vstack([left, (along * np.sqrt(np.maximum(size, 0.0))).T])

    @property
    def _covariance(self) -> Float64Array:
        """Of both, as the parts of the field tell."""
        apart = self.parts - self.parts.mean(axis=0)
        count = len(self.parts)
        return np.asarray((count - 1) / count * apart.T @ apart)


class RiseSearch:
    """The search for the elevation at which the light tells no other, by secants.

    z_px : elevation to take next, pixels
    """

    def __init__(self, highest_px: float) -> None:
        self.z_px = 0.0
        self._highest_px = highest_px
        self._last: tuple[float, float] | None = None
        self._rounds = 0

    def goes_on(self, left_px: float) -> bool:
        """Take how much higher the light tells the skin to be than `z_px`; False where that is close enough, or rounds
        are used up.
        """
        self._rounds += 1
        if abs(left_px) <= CLOSE_PX or self._rounds >= MAX_ROUNDS:
            return False
        here = self.z_px, left_px
        response = -1.0 / FIRST_SHARE
        if self._last is not None and here[0] != self._last[0]:
            response = float(np.clip((here[1] - self._last[1]) / (here[0] - self._last[0]), *RESPONSES))
        self.z_px = float(np.clip(here[0] - here[1] / response, -self._highest_px, self._highest_px))
        self._last = here
        return True


def rise_told_by_light(skin: LampSkin, intensity: Float64Array, slope: Float64Array, z_px: Float64Array) -> Rise | None:
    """By how much skin stands higher than it was taken to, and lamps shine brighter; None where too few cells tell it.

    skin : N places all over the field that all lamps reach
    intensity : seen there, shape (N, 3)
    slope, z_px : that explain it best, shape (N, 2), and the elevation that they were found with, shape (N,)
    """
    if len(z_px) < MIN_CELLS:
        return None
    shown, change = skin.shown_and_changes(slope, z_px)
    beside = np.cross(change[..., 0], change[..., 1])
    beside /= np.maximum(np.linalg.norm(beside, axis=1, keepdims=True), 1e-9)
    by_rise = (skin.shown(slope, z_px + RISE_PX) - shown) / RISE_PX
    missing = (beside * (intensity - shown)).sum(axis=1)
    design = np.column_stack([(beside * by_rise).sum(axis=1), beside * shown])
    block = _blocks(skin.column) * BLOCKS + _blocks(skin.row)
    for _ in range(2):
        left = np.abs(missing - design @ _solved(design, missing, block, None))
        near = left <= OUTLIER * 1.4826 * np.median(left)
        design, missing, block = design[near], missing[near], block[near]
    if len(np.unique(block)) < MIN_BLOCKS:
        return None
    whole = _solved(design, missing, block, None)
    parts = np.array([_solved(design, missing, block, one) for one in np.unique(block)])
    return Rise(float(whole[0]), whole[1:], parts)


def _solved(design: Float64Array, missing: Float64Array, block: np.ndarray, without: int | None) -> Float64Array:
    """Least squares over the cells that are not of a block."""
    rows = slice(None) if without is None else block != without
    some = design[rows]
    return np.asarray(np.linalg.lstsq(some.T @ some, some.T @ missing[rows], rcond=None)[0], np.float64)


def _blocks(at: Float64Array) -> np.ndarray:
    """Which part along a side each place belongs to."""
    return np.asarray((BLOCKS * (at - at.min()) / (np.ptp(at) + 1.0)).astype(np.intp))
