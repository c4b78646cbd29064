"""Fine patterns of known shape all over the field, and how much of them a height map retains.

Each patch is a sinusoid of twenty periods inside a disc, or a ridge: a Gaussian one pixel wide at half its height.
Phases and angles differ from patch to patch, so that the pixel grid cannot favour the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array

PERIODS: Final = 20
TAPER_PX: Final = 8.0
RIDGE_LENGTH_PX: Final = 110.0
SLOPE: Final = 0.157
"""Largest slope of a pattern: 9 degrees, small enough for intensity to be nearly linear in it."""

_GAUSS_FWHM: Final = 2.0 * np.sqrt(2.0 * np.log(2.0))
_BIN_PX: Final = 0.25
_FLANK_PX: Final = (5.0, 9.0)
_COLUMNS: Final = 8


@dataclass(frozen=True, slots=True)
class Patch:
    """One patch: centre in pixels, the direction across its lines, and their position.

    scale_px : period of a sinusoid, full width at half maximum of a ridge
    phase : of a sinusoid, radians
    """

    kind: Literal["sinusoid", "ridge"]
    column: float
    row: float
    angle_rad: float
    phase: float
    scale_px: float

    @property
    def reach_px(self) -> float:
        """Distance from the centre beyond which the skin is flat."""
        length = PERIODS * self.scale_px if self.kind == "sinusoid" else RIDGE_LENGTH_PX
        return 0.5 * length + TAPER_PX

    @property
    def amplitude_px(self) -> float:
        """Amplitude of a sinusoid, height of a ridge, pixels."""
        if self.kind == "sinusoid":
            return SLOPE * self.scale_px / (2.0 * np.pi)
        return float(SLOPE * self.scale_px / _GAUSS_FWHM * np.exp(0.5))

    def height_px(self, column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height (pixels) at positions in the field, array of their shape."""
        across, distance = self.across_px(column, row), np.hypot(column - self.column, row - self.row)
        inside = np.clip((self.reach_px - distance) / TAPER_PX, 0.0, 1.0)
        window = inside * inside * (3.0 - 2.0 * inside)
        if self.kind == "sinusoid":
            return np.asarray(window * self.amplitude_px * np.cos(2.0 * np.pi / self.scale_px * across + self.phase))
        return np.asarray(window * self.amplitude_px * np.exp(-0.5 * (across * _GAUSS_FWHM / self.scale_px) ** 2))

    def across_px(self, column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from the line through the centre, pixels."""
        return np.asarray((column - self.column) * np.cos(self.angle_rad) + (row - self.row) * np.sin(self.angle_rad))


def spread_patches(shape: tuple[int, int]) -> tuple[Patch, ...]:
    """Sinusoids of periods 4 and 8 px at four angles and three phases, and eight ridges, spread over a field (H, W)."""
    angles, phases = np.radians([0.0, 27.0, 45.0, 90.0]), np.radians([0.0, 30.0, 60.0])
    kinds: list[tuple[Literal["sinusoid", "ridge"], float, float, float]] = [
        ("sinusoid", float(angle), float(phase), period)
        for period in (4.0, 8.0)
        for angle in angles
        for phase in phases
    ]
    kinds += [("ridge", float(np.radians(angle)), 0.0, 1.0) for angle in (4.0, 27.0, 48.0, 94.0) for _ in range(2)]
    rows = len(kinds) // _COLUMNS
    # Five is prime to the number of places: neighbours in the list land far from one another.
    place = [(5 * number) % len(kinds) for number in range(len(kinds))]
    return tuple(
        Patch(
            kind,
            column=round((at % _COLUMNS + 0.5) / _COLUMNS * shape[1]),
            row=round((at // _COLUMNS + 0.5) / rows * shape[0]),
            angle_rad=angle,
            phase=phase,
            scale_px=scale,
        )
        for at, (kind, angle, phase, scale) in zip(place, kinds, strict=True)
    )


def kept_amplitude(z_px: Float32Array, patch: Patch) -> float:
    """Fraction of a sinusoid's amplitude that a height map (H, W) in pixels retains, without slow bends."""
    column, row, z = _inside(z_px, patch, 0.5 * PERIODS * patch.scale_px)
    across = 2.0 * np.pi / patch.scale_px * patch.across_px(column, row)
    x, y = (column - patch.column) / patch.reach_px, (row - patch.row) / patch.reach_px
    bend = [np.ones_like(x), x, y, x * x, x * y, y * y]
    design = np.column_stack([np.cos(across), np.sin(across), *bend])
    cosine, sine = np.linalg.lstsq(design, z, rcond=None)[0][:2]
    # Only what lies at the position of the pattern counts: noise and shifted copies are not amplitude.
    return float((cosine * np.cos(patch.phase) - sine * np.sin(patch.phase)) / patch.amplitude_px)


def ridge_width_px(z_px: Float32Array, patch: Patch) -> float:
    """Full width at half maximum (pixels) of a ridge's mean profile in a height map (H, W), pixels."""
    column, row, z = _inside(z_px, patch, 0.5 * RIDGE_LENGTH_PX)
    across = patch.across_px(column, row)
    near = np.abs(across) < _FLANK_PX[1]
    across, z = across[near], z[near]
    flank = np.abs(across) > _FLANK_PX[0]
    z = z - np.polynomial.Polynomial.fit(across[flank], z[flank], 1)(across)
    index = np.floor(across / _BIN_PX + 0.5).astype(np.intp)
    first = int(index.min())
    profile = np.bincount(index - first, z) / np.maximum(np.bincount(index - first), 1)
    return _width(profile) * _BIN_PX


def _width(profile: NDArray[np.float64]) -> float:
    """Distance, in samples, between the positions beside the peak where its height has halved; inf if none."""
    peak = int(np.argmax(profile))
    half = 0.5 * profile[peak]
    right = np.flatnonzero(profile[peak:] < half)
    left = np.flatnonzero(profile[peak::-1] < half)
    if len(right) == 0 or len(left) == 0:
        return float("inf")
    ends = []
    for step, distance in ((1, int(right[0])), (-1, int(left[0]))):
        outer, inner = profile[peak + step * distance], profile[peak + step * (distance - 1)]
        ends.append(distance - 1 + (inner - half) / (inner - outer))
    return float(sum(ends))


def _inside(z_px: Float32Array, patch: Patch, radius_px: float) -> tuple[NDArray[np.float64], ...]:
    """Columns, rows and heights of the valid pixels within a radius of the patch's centre, float64 arrays (N,)."""
    row, column = np.mgrid[: z_px.shape[0], : z_px.shape[1]].astype(np.float64)
    inside = (np.hypot(column - patch.column, row - patch.row) < radius_px) & np.isfinite(z_px)
    return column[inside], row[inside], z_px[inside].astype(np.float64)
