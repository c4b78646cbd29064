"""Height, hybrid, functional and spatial parameters of ISO 25178-2; the tables of their kinds stand at the end.

Heights count from the mean of the valid pixels. The standard leaves the derivative open: Sdq takes differences of
neighbouring pixels, each direction over the pairs of which both are valid, because a central difference would miss what
is two pixels wide. Sdr takes the area over each square of four valid pixels, as the mean of both triangulations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates

from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.kernels.jit import njit

# Functional parameters of ISO 25178-2 from the areal material ratio curve.
#
# The curve is the heights in falling order: at material ratio p, the height that a fraction p of the area reaches. Each
# valid pixel is one point; above a million, neighbours on the curve are averaged, which keeps all volumes and resolves
# ratios to one millionth.

CORE_FRACTION: Final = 0.4
"""Fraction of the curve to which the equivalent straight line is fitted."""

PEAK_FRACTION: Final = 0.1
CORE_END_FRACTION: Final = 0.8
"""Defaults of the standard: peaks up to 10 % material ratio, valleys from 80 %."""

SXP_FRACTIONS: Final = (0.025, 0.5)
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
        """Return the curve of the valid pixels of a surface."""
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
        "Vmp": curve.material_um(PEAK_FRACTION),
        "Vmc": curve.material_um(CORE_END_FRACTION) - curve.material_um(PEAK_FRACTION),
        "Vvc": curve.void_um(PEAK_FRACTION) - curve.void_um(CORE_END_FRACTION),
        "Vvv": curve.void_um(CORE_END_FRACTION),
        "Sxp": curve.height_um(SXP_FRACTIONS[0]) - curve.height_um(SXP_FRACTIONS[1]),
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
    """Return heights (µm) at 0 and 100 % of the line fitted to the 40 % of the curve with the flattest secant."""
    span = max(round(CORE_FRACTION * falling.size), 2)
    drop = falling[: falling.size - span + 1] - falling[span - 1 :]
    start = int(drop.argmin())
    part = falling[start : start + span]
    share = (np.arange(start, start + span) + 0.5) / falling.size
    off = share - share.mean()
    slope = float((off * part).sum() / (off * off).sum())
    top = float(part.mean()) - slope * float(share.mean())
    return top, top + slope


# Spatial parameters of ISO 25178-2: Sal, Str from the autocorrelation, Std from the angular spectrum.
#
# The autocorrelation at a shift is the mean product of the pairs of valid pixels at that distance, divided by the mean
# square. Each shift has its own number of pairs, so that borders and holes do not bias it. Shifts with few pairs,
# beyond about half of the field, are not evaluated.

FALLEN_TO: Final = 0.2
"""Threshold of the correlation, the default of the standard."""

STEP_DEG: Final = 1.0
STEP_PX: Final = 0.5
STD_STEP_DEG: Final = 0.5
MIN_PAIRS: Final = 0.1
"""Fewest pairs of an evaluated shift, as a fraction of the valid pixels."""


@dataclass(frozen=True, slots=True)
class Decay:
    """Decay of the autocorrelation to the threshold.

    shortest_px, longest_px : smallest and largest decay length over all directions, pixels; NaN when unknown
    reached : whether it decays in every direction within the field; else `longest_px` is a lower limit
    """

    shortest_px: float
    longest_px: float
    reached: bool


class Autocorrelation:
    """The autocorrelation on one mask; its pairs are counted once.

    Parameters
    ----------
    valid : bool array of shape (H, W)
    """

    def __init__(self, valid: MaskArray) -> None:
        self._valid = valid
        self._lags = [max(side // 2, 1) for side in valid.shape]
        pairs = zip(valid.shape, self._lags, strict=True)
        self._size = [scipy.fft.next_fast_len(side + lag, real=True) for side, lag in pairs]
        self._pairs = np.maximum(np.rint(self._products(valid.astype(np.float32))), np.float32(0.0))

    def of(self, z_um: Float32Array) -> Float32Array:
        """Return the autocorrelation: float32 (2 h + 1, w + 1), shift (0, 0) at (h, 0), NaN with too few pairs."""
        count = float(self._valid.sum())
        level = np.float32(z_um[self._valid].mean(dtype=np.float64)) if count else np.float32(0.0)
        products = self._products(np.where(self._valid, z_um - level, np.float32(0.0)))
        enough = self._pairs > MIN_PAIRS * count
        mean = np.where(enough, products / np.maximum(self._pairs, np.float32(1.0)), np.float32(np.nan))
        square = mean[self._lags[0], 0]
        return np.asarray(mean / square if square > 0.0 else np.full_like(mean, np.nan), np.float32)

    def _products(self, values: Float32Array) -> Float32Array:
        """Return sums of products at each shift, negative rows first: float32 array of shape (2 h + 1, w + 1)."""
        spectrum = scipy.fft.rfft2(values, self._size)
        power = spectrum.real**2 + spectrum.imag**2
        sums = np.asarray(scipy.fft.irfft2(power, self._size), np.float32)[:, : self._lags[1] + 1]
        return np.concatenate([sums[-self._lags[0] :], sums[: self._lags[0] + 1]])


def decay(correlation: Float32Array, fallen_to: float = FALLEN_TO) -> Decay:
    """Return the decay of an autocorrelation, as `Autocorrelation.of` returns it, around shift (0, 0)."""
    middle = correlation.shape[0] // 2
    if not np.isfinite(correlation[middle, 0]):
        return Decay(float("nan"), float("nan"), reached=False)
    # The other half of the shifts is its mirror image.
    angle = np.radians(np.arange(-90.0, 90.0, STEP_DEG))
    reach = float(np.hypot(middle, correlation.shape[1] - 1))
    radius = np.arange(0.0, reach + STEP_PX, STEP_PX)
    fallen = np.array([_first_below(correlation, middle, one, radius, fallen_to) for one in angle])
    lengths, seen = fallen[:, 0], fallen[:, 1] > 0.0
    shortest = float(lengths[seen].min()) if seen.any() else float("nan")
    return Decay(shortest, float(lengths.max()), bool(seen.all()))


def _first_below(
    correlation: Float32Array, middle: int, angle: float, radius: Float64Array, fallen_to: float
) -> tuple[float, float]:
    """Return the decay length of a direction (pixels) and 1.0; or the longest evaluated shift and 0.0."""
    row, column = middle + radius * np.sin(angle), radius * np.cos(angle)
    inside = (row >= 0.0) & (row <= correlation.shape[0] - 1) & (column <= correlation.shape[1] - 1)
    row, column = row[inside], column[inside]
    values = map_coordinates(correlation, [row, column], order=1, mode="nearest")
    below = np.flatnonzero(~(values >= fallen_to))
    if not below.size or not np.isfinite(values[below[0]]):
        return float(radius[(below[0] if below.size else values.size) - 1]), 0.0
    last = int(below[0])
    before, after = float(values[last - 1]), float(values[last])
    return STEP_PX * (last - 1 + (before - fallen_to) / (before - after)), 1.0


def texture_direction_deg(correlation: Float32Array) -> float:
    """Std: angle of the maximum of the angular power spectrum, counter-clockwise from the column axis, -90° to 90°.

    It is the direction across the lay. The power spectrum is the Fourier transform of the tapered autocorrelation.
    """
    middle, width = correlation.shape[0] // 2, correlation.shape[1] - 1
    reach = min(middle, width)
    if reach < 4 or not np.isfinite(correlation[middle, 0]):
        return float("nan")
    half = np.nan_to_num(correlation[middle - reach : middle + reach + 1, : reach + 1])
    whole = np.concatenate([half[::-1, :0:-1], half], axis=1)
    lag = np.arange(-reach, reach + 1, dtype=np.float32) / np.float32(reach + 1.0)
    taper = np.maximum(np.float32(1.0) - np.hypot(lag[:, None], lag), np.float32(0.0))
    # Magnitudes only, so the position of shift (0, 0) in the array does not matter.
    power = np.abs(scipy.fft.fftshift(scipy.fft.rfft2(whole * taper), axes=0))
    angle = np.radians(np.arange(-90.0, 90.0, STD_STEP_DEG))
    radius = np.arange(1.5, reach, 0.5)
    row = reach - radius * np.sin(angle)[:, None]
    column = radius * np.cos(angle)[:, None]
    along = map_coordinates(power, [row, column], order=1).sum(axis=1)
    return float(np.degrees(angle[int(along.argmax())]))


def height_parameters(z_um: Float32Array) -> dict[str, float]:
    """Sa, Sq, Sp, Sv, Sz in µm, Ssk, Sku without unit; all NaN without a valid pixel.

    z_um : float32 array of shape (H, W), NaN where invalid
    """
    first = _height_sums(z_um, 0.0)
    count = first[:, 0].sum()
    if not count:
        return dict.fromkeys(("Sa", "Sq", "Sp", "Sv", "Sz", "Ssk", "Sku"), float("nan"))
    mean = float(first[:, 1].sum() / count)
    sums = _height_sums(z_um, mean)
    absolute, square, cube, fourth = (float(sums[:, k].sum() / count) for k in (2, 3, 4, 5))
    sq = float(np.sqrt(square))
    peak, pit = float(sums[:, 6].max()), float(-sums[:, 7].min())
    return {
        "Sa": absolute,
        "Sq": sq,
        "Sp": peak,
        "Sv": pit,
        "Sz": peak + pit,
        "Ssk": cube / sq**3 if sq else float("nan"),
        "Sku": fourth / sq**4 if sq else float("nan"),
    }


@njit(cache=True)
def _height_sums(z_um: Any, mean: Any) -> Float64Array:
    """Count, sums of h, |h|, h², h³, h⁴, and extremes of h = z - mean, row by row: float64 array of shape (H, 8)."""
    rows, columns = z_um.shape
    sums = np.zeros((rows, 8))
    for r in range(rows):
        sums[r, 6], sums[r, 7] = -np.inf, np.inf
        for c in range(columns):
            h = np.float64(z_um[r, c]) - mean
            if np.isfinite(h):
                square = h * h
                sums[r, 0] += 1.0
                sums[r, 1] += h
                sums[r, 2] += abs(h)
                sums[r, 3] += square
                sums[r, 4] += square * h
                sums[r, 5] += square * square
                sums[r, 6] = max(sums[r, 6], h)
                sums[r, 7] = min(sums[r, 7], h)
    return sums


def hybrid_parameters(z_um: Float32Array, pitch_um: float) -> dict[str, float]:
    """Sdq (µm/µm) and Sdr (%); NaN without valid neighbours.

    z_um : float32 array of shape (H, W), NaN where invalid
    """
    sums = _slope_sums(z_um, 1.0 / pitch_um).sum(axis=0)
    if not (sums[1] and sums[3] and sums[5]):
        return {"Sdq": float("nan"), "Sdr": float("nan")}
    return {
        "Sdq": float(np.sqrt(sums[0] / sums[1] + sums[2] / sums[3])),
        "Sdr": 100.0 * float(sums[4] / sums[5] - 1.0),
    }


@njit(cache=True, inline="always")
def _two_triangles(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return the area over a unit square with heights a b / c d, cut along b-c."""
    upper = 0.5 * np.sqrt(1.0 + (b - a) ** 2 + (c - a) ** 2)
    return upper + 0.5 * np.sqrt(1.0 + (d - c) ** 2 + (d - b) ** 2)


@njit(cache=True)
def _slope_sums(z_um: Any, per_um: Any) -> Float64Array:
    """Return the sum and number of squared slopes across, the same down, area and number of squares: array (H, 6)."""
    rows, columns = z_um.shape
    sums = np.zeros((rows, 6))
    for r in range(rows):
        below = min(r + 1, rows - 1)
        for k in range(columns):
            after = min(k + 1, columns - 1)
            a, b = z_um[r, k] * per_um, z_um[r, after] * per_um
            c, d = z_um[below, k] * per_um, z_um[below, after] * per_um
            if after > k and np.isfinite(b - a):
                sums[r, 0] += (b - a) ** 2
                sums[r, 1] += 1.0
            if below > r and np.isfinite(c - a):
                sums[r, 2] += (c - a) ** 2
                sums[r, 3] += 1.0
            if after > k and below > r and np.isfinite(a + b + c + d):
                sums[r, 4] += 0.5 * (_two_triangles(a, b, c, d) + _two_triangles(b, a, d, c))
                sums[r, 5] += 1.0
    return sums


# Areal parameters by name: group, unit, and dependence on lateral lengths.

AREAL_SUBJECT: Final = "surface"
"""Subject of areal parameters; other subjects are names from the recipe."""


NoiseLaw = Literal["squares", "either", "extreme"]


@dataclass(frozen=True, slots=True)
class ParameterKind:
    """Kind of a parameter.

    unit : empty for a pure number
    stretch_power : exponent of its dependence on lateral lengths
    is_amplitude : noise raises it as it raises an amplitude, and is taken off
    noise_law : how noise adds to it: in squares; in squares or, where the surface is flat, in proportion; or mostly in
        proportion (an extreme)
    is_shape : without an L-filter, waviness dominates it; slopes determine that least and the samples do not contain
        its error, so that no uncertainty is stated
    """

    unit: str
    stretch_power: float = 0.0
    is_amplitude: bool = False
    noise_law: NoiseLaw = "squares"
    is_shape: bool = False


AMPLITUDE: Final = ParameterKind("µm", is_amplitude=True)
EXTREME: Final = ParameterKind("µm", is_amplitude=True, noise_law="extreme")
SLOPE: Final = ParameterKind("µm/µm", -1.0, is_amplitude=True)
MOMENT: Final = ParameterKind("", noise_law="either")
_SHAPE: Final = ParameterKind("", is_shape=True)
_PER_AREA: Final = ParameterKind("µm³/µm²", noise_law="either")
_CURVE: Final = ParameterKind("µm", is_amplitude=True, noise_law="either")

HEIGHT: Final = {"Sa": AMPLITUDE, "Sq": AMPLITUDE, "Sp": EXTREME, "Sv": EXTREME, "Sz": EXTREME} | {
    "Ssk": ParameterKind("", noise_law="either", is_shape=True),
    "Sku": MOMENT,
}
HYBRID: Final = {"Sdq": SLOPE, "Sdr": ParameterKind("%", -2.0, is_amplitude=True)}
SPATIAL: Final = {"Sal": ParameterKind("µm", 1.0), "Str": _SHAPE, "Std": ParameterKind("°")}
FUNCTIONAL: Final = {
    "Sk": _CURVE,
    "Spk": ParameterKind("µm", is_amplitude=True, noise_law="either", is_shape=True),
    "Svk": _CURVE,
    "Smr1": ParameterKind("%", is_shape=True),
    "Smr2": ParameterKind("%"),
    "Sxp": _CURVE,
    "Vmp": _PER_AREA,
    "Vmc": _PER_AREA,
    "Vvc": _PER_AREA,
    "Vvv": _PER_AREA,
}
GROUPS: Final = {"height": HEIGHT, "hybrid": HYBRID, "spatial": SPATIAL, "functional": FUNCTIONAL}
AREAL: Final = HEIGHT | HYBRID | SPATIAL | FUNCTIONAL
