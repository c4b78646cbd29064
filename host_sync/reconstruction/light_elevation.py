"""How high skin stands where none of it is untouched: skin that is nearer to the lamps shows another light.

Three channels tell two slopes of every cell. What slopes cannot explain changes with elevation, by a pattern over the
field that is known as the lamps are. So the elevation of the whole field is found, although its zero is nowhere seen.
How bright each lamp is counts for nothing: only the pattern does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float64Array
from host_sync.lights.lamp_slopes import LampSkin

RISE_PX: Final = 1.0
"""Elevation by which the change of light is taken."""

BLOCKS: Final = 4
"""Parts of the field along each side; how much the elevation differs without one of them is its uncertainty."""

OUTLIER: Final = 3.0
"""Cells are left out that differ by more than so many times the median of what is left."""

MIN_CELLS: Final = 200

MAX_ROUNDS: Final = 8
CLOSE_PX: Final = 0.05
"""The search ends where the skin stands no more than this higher than it was taken to."""

FIRST_SHARE: Final = 0.6
"""Of what the light tells at first, the first move: heights that were found too low tell too much."""

RESPONSES: Final = (-3.0, -0.5)
"""By how much what is left of an elevation changes with what is taken for it, at most and at least."""


@dataclass(frozen=True, slots=True)
class Rise:
    """By how much a field of skin stands higher than it was taken to, pixels, and the standard uncertainty of that."""

    z_px: float
    sigma_px: float

    @property
    def unsure_px(self) -> float:
        """Standard uncertainty of the elevation where the search for it ends, pixels."""
        return float(np.hypot(self.z_px, self.sigma_px))


class RiseSearch:
    """The search for the elevation at which the light tells no other, by secants.

    z_px : elevation to take next, pixels
    """

    def __init__(self, highest_px: float) -> None:
        self.z_px = 0.0
        self._highest_px = highest_px
        self._last: tuple[float, float] | None = None
        self._rounds = 0

    def goes_on(self, rise: Rise) -> bool:
        """Take what the light tells at `z_px`; False where that is close enough, or rounds are used up."""
        self._rounds += 1
        if abs(rise.z_px) <= CLOSE_PX or self._rounds >= MAX_ROUNDS:
            return False
        here = self.z_px, rise.z_px
        response = -1.0 / FIRST_SHARE
        if self._last is not None and here[0] != self._last[0]:
            response = float(np.clip((here[1] - self._last[1]) / (here[0] - self._last[0]), *RESPONSES))
        self.z_px = float(np.clip(here[0] - here[1] / response, -self._highest_px, self._highest_px))
        self._last = here
        return True


def rise_told_by_light(skin: LampSkin, intensity: Float64Array, slope: Float64Array, z_px: Float64Array) -> Rise | None:
    """By how much skin stands higher than it was taken to; None where too few cells tell it.

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
        near = left <= OUTLIER * np.median(left) / 0.6745
        design, missing, block = design[near], missing[near], block[near]
    whole = _solved(design, missing, block, None)[0]
    parts = np.array([_solved(design, missing, block, one)[0] for one in np.unique(block)])
    count = len(parts)
    spread = np.sqrt((count - 1) / count * np.square(parts - parts.mean()).sum())
    return Rise(float(whole), float(spread))


def _solved(design: Float64Array, missing: Float64Array, block: np.ndarray, without: int | None) -> Float64Array:
    """Least squares over the cells that are not of a block."""
    rows = slice(None) if without is None else block != without
    some = design[rows]
    return np.asarray(np.linalg.lstsq(some.T @ some, some.T @ missing[rows], rcond=None)[0])


def _blocks(at: Float64Array) -> np.ndarray:
    """Which part along a side each place belongs to."""
    return (BLOCKS * (at - at.min()) / (np.ptp(at) + 1.0)).astype(np.intp)
