"""Functional parameters of ISO 25178-2 from the areal material ratio curve.

The curve is the heights in falling order: at material ratio p, the height that a fraction p of the area reaches. Each
valid pixel is one point; above a million, neighbours on the curve are averaged, which keeps all volumes and resolves
ratios to one millionth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.surface.fields import Float32Array, Float64Array

CORE_SHARE: Final = 0.4
"""Fraction of the curve to which the equivalent straight line is fitted."""

PEAK_SHARE: Final = 0.1
CORE_END_SHARE: Final = 0.8
"""Defaults of the standard: peaks up to 10 % material ratio, valleys from 80 %."""

SXP_SHARES: Final = (0.025, 0.5)
MAX_POINTS: Final = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class MaterialRatioCurve:
    """Heights from the mean, sorted.

    falling_um : float64 array of shape (N,), µm, the highest first, each for an equal share of the area
    volume_um : float64 array of shape (N + 1,), µm: sum of the first heights over N
    """

    falling_um: Float64Array
    volume_um: Float64Array

    @classmethod
    def of(cls, z_um: Float32Array) -> MaterialRatioCurve:
        """The curve of the valid pixels of a surface."""
        heights = _thinned(np.sort(z_um[np.isfinite(z_um)]))[::-1]
        if heights.size:
            heights -= heights.mean()
        return cls(heights, np.concatenate([[0.0], np.cumsum(heights)]) / max(heights.size, 1))

    def height_um(self, share: float) -> float:
        """Smc: height at a material ratio (0 to 1), µm from the mean."""
        at = share * self.falling_um.size - 0.5
        return float(np.interp(at, np.arange(self.falling_um.size), self.falling_um))

    def share(self, height_um: float) -> float:
        """Smr: material ratio (0 to 1) at a height, µm from the mean."""
        rising = self.falling_um[::-1]
        return 1.0 - float(np.searchsorted(rising, height_um)) / rising.size

    def material_um(self, share: float) -> float:
        """Vm: material volume above the height at a material ratio, µm³/µm²."""
        return self._sum(share) - share * self.height_um(share)

    def void_um(self, share: float) -> float:
        """Vv: void volume below the height at a material ratio, µm³/µm²."""
        return (1.0 - share) * self.height_um(share) - (float(self.volume_um[-1]) - self._sum(share))

    def _sum(self, share: float) -> float:
        at = share * self.falling_um.size
        return float(np.interp(at, np.arange(self.volume_um.size), self.volume_um))


def _thinned(rising: Float32Array) -> Float64Array:
    """Sorted heights, averaged to at most `MAX_POINTS`: float64 array."""
    if rising.size <= MAX_POINTS:
        return rising.astype(np.float64)
    starts = np.arange(MAX_POINTS) * rising.size // MAX_POINTS
    counts = np.diff(starts, append=rising.size)
    return np.asarray(np.add.reduceat(rising, starts, dtype=np.float64) / counts)


def functional_parameters(z_um: Float32Array) -> dict[str, float]:
    """Sk, Spk, Svk, Sxp (µm), Smr1, Smr2 (%), Vmp, Vmc, Vvc, Vvv (µm³/µm²); NaN with too few valid pixels."""
    curve = MaterialRatioCurve.of(z_um)
    if curve.falling_um.size < 10:
        names = ("Sk", "Spk", "Svk", "Smr1", "Smr2", "Vmp", "Vmc", "Vvc", "Vvv", "Sxp")
        return dict.fromkeys(names, float("nan"))
    return core_parameters(curve) | {
        "Vmp": curve.material_um(PEAK_SHARE),
        "Vmc": curve.material_um(CORE_END_SHARE) - curve.material_um(PEAK_SHARE),
        "Vvc": curve.void_um(PEAK_SHARE) - curve.void_um(CORE_END_SHARE),
        "Vvv": curve.void_um(CORE_END_SHARE),
        "Sxp": curve.height_um(SXP_SHARES[0]) - curve.height_um(SXP_SHARES[1]),
    }


def core_parameters(curve: MaterialRatioCurve) -> dict[str, float]:
    """Sk, Spk, Svk (µm), Smr1, Smr2 (%)."""
    falling = curve.falling_um
    count = falling.size
    top, bottom = core_line(falling)
    first = int(np.searchsorted(-falling, -top))
    last = int(np.searchsorted(-falling, -bottom))
    # Heights of triangles of equal area: twice the mean height over the covered fraction.
    peaks = 2.0 * float((falling[:first] - top).mean()) if first else 0.0
    valleys = 2.0 * float((bottom - falling[last:]).mean()) if last < count else 0.0
    return {
        "Sk": top - bottom,
        "Spk": peaks,
        "Svk": valleys,
        "Smr1": 100.0 * first / count,
        "Smr2": 100.0 * last / count,
    }


def core_line(falling: Float64Array) -> tuple[float, float]:
    """Heights (µm) at 0 and 100 % of the line fitted to the 40 % of the curve with the flattest secant."""
    span = max(round(CORE_SHARE * falling.size), 2)
    drop = falling[: falling.size - span + 1] - falling[span - 1 :]
    start = int(drop.argmin())
    part = falling[start : start + span]
    share = (np.arange(start, start + span) + 0.5) / falling.size
    off = share - share.mean()
    slope = float((off * part).sum() / (off * off).sum())
    top = float(part.mean()) - slope * float(share.mean())
    return top, top + slope
