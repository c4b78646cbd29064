"""Significant changes in the difference of two presses of one object.

The difference is looked at for round changes of several widths (`heights`). The spread of each band is taken from the
difference itself, more where it is steep: what is steep differs more, by gain and by shift. Medians are used, so a
change in a small part of the field does not hide itself; skin that neither press touched does not count. Where the
object lies farther from its first place than the widest change, heights of both presses err independently: their
uncertainty is part of the spread. Places far more uncertain than most, as on dark borders, are not judged. `LIMIT` is
what the largest of a field without a change stays below on the twin (`docs/same-spot.md`); it is more than that of
normal noise, because gains differ in patches and skin that bridges valleys drapes differently at another depth.

From the same spreads follows the detection limit: the height of a round change that is found in 95 % of places.

Response of a difference of heights to a round change of one width, as the height that it would have.

A reconstruction integrates slopes. Slopes that err alike at all wavelengths give heights whose error grows with the
wavelength, and errors in patches add to that. The filter is that of a Gaussian for such errors: its spectrum times the
third power of the wave number k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import msgspec
import numpy as np
from scipy.optimize import least_squares

from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.registration.difference import Difference

POWER: Final = 1.5
"""The spectrum of the Gaussian is multiplied by (k²) to this power."""

BAND_BACKGROUND_PX: Final = 30.0
"""Standard deviation of the Gaussian mean that is taken off first, so that the border of the valid field is no edge."""

REACH: Final = 2.0
"""A place is judged by a Gaussian of so many widths around it …"""

BAND_MIN_FILLED: Final = 0.85
"""… of which at least this part is valid."""

PADDING_PX: Final = 64

UNCERTAIN: Final = 2.0
"""Uncertainty of the difference, over its median, from which a place is not judged."""


def blurred(values: Float32Array, scale_px: float) -> tuple[Float32Array, Float32Array]:
    """Return gaussian mean over the valid pixels, and how much of the Gaussian is valid: arrays of shape (h, w)."""
    known = np.isfinite(values)
    share = _filled(known, scale_px)
    total = cv2.GaussianBlur(np.where(known, values, np.float32(0.0)), (0, 0), scale_px, borderType=cv2.BORDER_CONSTANT)
    mean = np.where(known, total / np.maximum(share, np.float32(1e-6)), np.float32(np.nan))
    return np.asarray(mean, np.float32), share


def heights(values: Float32Array, width_px: float) -> Float32Array:
    """Return the height of a round change at each place: float32 array (h, w), NaN where too little is valid around.

    values : float32 array of shape (h, w), difference of heights, NaN where unknown
    width_px : standard deviation of the change's Gaussian
    """
    rest = np.nan_to_num(values - blurred(values, BAND_BACKGROUND_PX)[0])
    rows, columns = rest.shape
    padded = np.pad(rest, PADDING_PX)
    down = 2.0 * np.pi * np.fft.fftfreq(padded.shape[0])
    right = 2.0 * np.pi * np.fft.rfftfreq(padded.shape[1])
    square = down[:, None] ** 2 + right[None, :] ** 2
    profile = np.exp(-0.5 * square * width_px**2)
    answer = profile * square**POWER
    found = np.fft.irfft2(np.fft.rfft2(padded) * answer, s=padded.shape)
    found = found[PADDING_PX : PADDING_PX + rows, PADDING_PX : PADDING_PX + columns] / _of_one(width_px)
    judged = _filled(np.isfinite(values), REACH * width_px) > BAND_MIN_FILLED
    return np.asarray(np.where(judged & np.isfinite(values), found, np.nan), np.float32)


def _of_one(width_px: float) -> float:
    """Return the filter's answer in the middle of a Gaussian of height 1 and that width.

    It is the integral of 2π width² exp(-k² width²) k³ over the plane of k, over (2π)²: Γ(5/2) / (2 width³).
    """
    return 0.375 * float(np.sqrt(np.pi)) / width_px**3


def _filled(known: MaskArray, scale_px: float) -> Float32Array:
    """Return how much of a Gaussian around each place is valid: float32 array of shape (h, w)."""
    share = cv2.GaussianBlur(known.astype(np.float32), (0, 0), scale_px, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, np.float32)


SCALES_PX: Final = (2.6, 3.7, 5.2, 7.4)
"""Standard deviations of the round changes that are looked for, pixels of at most `MAX_PX` along the longer side."""

MAX_PX: Final = 400
BACKGROUND_PX: Final = 15.0
GAIN_PX: Final = (1.8, 4.5)
"""The gain is taken from relief between Gaussian means of these two standard deviations."""

LIMIT: Final = 13.5
"""A change is significant beyond so many spreads."""

MISSED: Final = 1.645
"""So many spreads more than `LIMIT` are exceeded in 95 % of cases."""

WIDTH_TO_DIAMETER: Final = 2.3548
"""Full width of a Gaussian at half its height, over its standard deviation."""

COVERED: Final = 0.95
"""Share of the judged field in which a change as high as the detection limit is found."""

USUAL: Final = 0.5
"""Squared slopes beyond this fraction of the least and the largest together are steep."""

FIT_SIGMAS: Final = 2.5
"""σ of a fitted height over the spread of its band: the width is fitted too, and what surrounds it is not flat."""

MIN_FILLED: Final = 0.7
"""Least valid part of what the gain is taken from."""

MAX_CHANGES: Final = 100
WINDOW_PX: Final = 24.0
WINDOW_SCALES: Final = 4.6
WIDTHS_PX: Final = (1.5, 2.0, 2.7, 3.5, 4.5, 6.0, 8.0)
"""Radius around a change in which a Gaussian is fitted to it, at most, and in units of the band that shows it best; and
the widths that are tried."""

WIDER: Final = 1.35
"""Largest ratio of the fitted width to the one of these that begins the fit; neighbours lie no further apart."""

TO_SIGMA: Final = 1.4826


class Change(msgspec.Struct, frozen=True):
    """One significant change.

    row_um, column_um : its middle on the first press, from the centre of the first pixel
    height_um : how much higher it is in the second press than its surroundings are; a dent is negative
    sigma_um : standard uncertainty of that, from the spread of the difference
    diameter_um : across it at half its height
    volume_um_mm2 : its height over its area, added up
    score : height in its band over the spread
    """

    row_um: float
    column_um: float
    height_um: float
    sigma_um: float
    diameter_um: float
    volume_um_mm2: float
    score: float


class Limit(msgspec.Struct, frozen=True):
    """The height from which round changes of one size are found.

    diameter_um : across them at half their height
    height_um : found in 95 % of cases at 95 % of the judged places
    """

    diameter_um: float
    height_um: float


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two presses.

    found : significant changes, most significant first
    limits : detection limits, smallest diameter first; empty where nothing can be judged
    judged_share : judged field as a fraction of the first map
    highest : largest score in the field, significant or not
    gain : by how much the second press reads heights larger than the first, relative; taken off
    """

    found: tuple[Change, ...]
    limits: tuple[Limit, ...]
    judged_share: float
    highest: float
    gain: float


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """One band: float32 arrays of shape (h, w), of the difference and its score, NaN where it cannot be judged."""

    scale_px: float
    values: Float32Array
    score: Float32Array
    spread: Float32Array


def changes(first: HeightMap, found: Difference, untouched: MaskArray | None = None) -> Changes:
    """Return the significant changes in a difference.

    first : the first press, on whose grid the difference is
    untouched : skin that neither press touched, of the first map's shape, where there is nothing to judge
    """
    step = _step(first)
    size = (first.z_um.shape[1] // step, first.z_um.shape[0] // step)
    off = found.z_um if untouched is None else np.where(untouched, np.float32(np.nan), found.z_um)
    if found.sigma_um is not None and np.isfinite(found.sigma_um).any():
        off = np.where(found.sigma_um > UNCERTAIN * np.nanmedian(found.sigma_um), np.float32(np.nan), off)
    z_um, rest = (_small(values, step, size) for values in (first.z_um, off))
    gain = _gain(z_um, rest)
    background = blurred(z_um, BACKGROUND_PX)[0]
    rest = rest - np.float32(gain) * (z_um - background)
    independent_um = found.sigma_um if is_elsewhere(first, found) else None
    sigma_um = np.zeros_like(rest) if independent_um is None else _small(independent_um, step, size)
    bands = [_band(z_um, rest, sigma_um, scale) for scale in SCALES_PX]
    highest = max(
        (float(np.nanmax(np.abs(band.score))) for band in bands if np.isfinite(band.score).any()), default=0.0
    )
    taken = np.zeros(rest.shape, bool)
    listed: list[Change] = []
    while len(listed) < MAX_CHANGES:
        best = max(bands, key=lambda band: float(np.nanmax(np.where(taken, 0.0, np.abs(np.nan_to_num(band.score))))))
        open_ = np.where(taken, 0.0, np.abs(np.nan_to_num(best.score)))
        place = tuple(int(at) for at in np.unravel_index(int(np.argmax(open_)), open_.shape))
        if open_[place] < LIMIT:
            break
        change, region = _change(bands, best, rest, (place[0], place[1]), first.pitch_um, step)
        listed.append(change)
        taken |= region
    judged = float(np.isfinite(bands[0].score).mean())
    limits = tuple(_limit(band, first.pitch_um * step) for band in bands if np.isfinite(band.spread).any())
    return Changes(tuple(listed), limits, judged, highest, gain)


def _step(first: HeightMap) -> int:
    """Return the side, in pixels of the first map, of the squares whose means are judged."""
    return max(1, -(-int(max(first.z_um.shape)) // MAX_PX))


def is_elsewhere(first: HeightMap, found: Difference) -> bool:
    """Return whether the object lies farther from its first place than the widest change, so that heights err apart."""
    turned_um = abs(float(np.radians(found.turn_deg))) * 0.5 * float(np.hypot(*first.z_um.shape)) * first.pitch_um
    widest_um = WIDTH_TO_DIAMETER * SCALES_PX[-1] * first.pitch_um * _step(first)
    return bool(np.hypot(*found.shift_um) + turned_um > widest_um)


def _limit(band: _Band, pitch_um: float) -> Limit:
    """Return the detection limit of the changes that a band shows best."""
    spread = float(np.nanquantile(band.spread, COVERED))
    diameter_um = WIDTH_TO_DIAMETER * band.scale_px * pitch_um
    return Limit(diameter_um, (LIMIT + MISSED) * spread)


def _small(values: Float32Array, step: int, size: tuple[int, int]) -> Float32Array:
    """Return means over squares of `step` pixels."""
    part = values[: size[1] * step, : size[0] * step]
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32) if step > 1 else part


def _within(values: Float32Array) -> Float32Array:
    """Return the relief that the gain is taken from, NaN where too little is valid around: float32 array (h, w)."""
    fine, _ = blurred(values, GAIN_PX[0])
    wide, share = blurred(values, GAIN_PX[1])
    return np.asarray(np.where(share > MIN_FILLED, fine - wide, np.float32(np.nan)), np.float32)


def _gain(z_um: Float32Array, rest: Float32Array) -> float:
    """Return the relative gain of the second's heights: median of ratios where the surface is high in its band."""
    relief, off = (_within(values) for values in (z_um, rest))
    known = np.isfinite(relief) & np.isfinite(off)
    if not known.any():
        return 0.0
    size = np.abs(relief[known])
    high = size > np.quantile(size, 0.7)
    ratio = off[known][high] / relief[known][high]
    return float(np.median(ratio)) if ratio.size else 0.0


def _band(z_um: Float32Array, rest: Float32Array, sigma_um: Float32Array, scale_px: float) -> _Band:
    """Return the band of the difference with its spread on surfaces as rough as at each place.

    sigma_um : float32 array of shape (h, w), uncertainty of the difference in addition to its spread
    """
    values = heights(rest, scale_px)
    q, p = np.gradient(blurred(z_um, 0.3 * scale_px)[0])
    steep, _ = blurred(np.asarray(p * p + q * q, np.float32), scale_px)
    known = np.isfinite(values) & np.isfinite(steep)
    spread = np.full(values.shape, np.nan, np.float32)
    if known.any():
        # Where it is steeper than usual the spread grows with the slope, as a shift makes it.
        steeper = np.sqrt(np.maximum(steep / max(USUAL * float(steep[known].min() + steep[known].max()), 1e-12), 1.0))
        spread = np.asarray(TO_SIGMA * float(np.median(np.abs(values[known]))) * steeper, np.float32)
    spread = np.hypot(spread, sigma_um / np.float32(FIT_SIGMAS))
    spread = np.where(known, np.maximum(spread, np.float32(1e-6)), np.float32(np.nan))
    return _Band(scale_px, values, np.asarray(values / spread, np.float32), spread)


def _change(
    bands: list[_Band], best: _Band, rest: Float32Array, place: tuple[int, int], pitch_um: float, step: int
) -> tuple[Change, MaskArray]:
    """Return the change at the peak of a band, and the pixels that it takes.

    It is fitted as a round change of Gaussian profile on a plane; the best of `WIDTHS_PX` begins the fit.
    """
    row, column = np.ogrid[: rest.shape[0], : rest.shape[1]]
    down, right = np.broadcast_arrays(row - place[0], column - place[1])
    away = np.hypot(down, right)
    inside = np.isfinite(rest) & (away <= min(WINDOW_PX, WINDOW_SCALES * best.scale_px))
    target = rest[inside].astype(np.float64)
    seen_um = float(best.values[place])
    least, width_px, height_um = np.inf, best.scale_px, seen_um
    for width in WIDTHS_PX:
        profile = np.exp(-0.5 * (away[inside] / width) ** 2)
        design = np.stack([profile, np.ones(profile.size), down[inside], right[inside]], axis=-1)
        solved, *_ = np.linalg.lstsq(design, target, rcond=None)
        left = float(np.sum((target - design @ solved) ** 2))
        # What surrounds a narrow change may be fitted better by a wide one of the other sign.
        if left < least and solved[0] * seen_um > 0.0:
            least, width_px, height_um = left, width, float(solved[0])
    place_px = np.array([down[inside], right[inside]])
    width_px, height_um, off_px = _refined(target, place_px, width_px, height_um)
    # Its uncertainty is that of the band which shows such a width best.
    judged = [band for band in bands if np.isfinite(band.spread[place])]
    fitting = min(judged, key=lambda band: abs(np.log(band.scale_px / width_px)))
    cell_um = pitch_um * step
    row_um, column_um = ((at + off + 0.5) * cell_um - 0.5 * pitch_um for at, off in zip(place, off_px, strict=True))
    change = Change(
        row_um=row_um,
        column_um=column_um,
        height_um=height_um,
        sigma_um=FIT_SIGMAS * float(fitting.spread[place]),
        diameter_um=WIDTH_TO_DIAMETER * width_px * cell_um,
        volume_um_mm2=2.0 * float(np.pi) * width_px**2 * height_um * (cell_um * 1e-3) ** 2,
        score=abs(float(best.score[place])),
    )
    return change, np.asarray(away <= max(4.0 * best.scale_px, 5.0 * width_px))


def _refined(
    target: Float64Array, place_px: Float64Array, width_px: float, height_um: float
) -> tuple[float, float, tuple[float, float]]:
    """Return the width, height and middle (down, right; px) of the round change on a plane that fits heights best.

    target : float64 array of shape (N,), µm
    place_px : float64 array of shape (2, N), places down and right of the first estimate of the middle
    width_px, height_um : first estimates
    """

    def residual(guess: Float64Array) -> Float64Array:
        width, height, down, right, level, steep, tilted = guess
        away = np.hypot(place_px[0] - down, place_px[1] - right)
        plane = level + steep * place_px[0] + tilted * place_px[1]
        return np.asarray(height * np.exp(-0.5 * (away / width) ** 2) + plane - target, np.float64)

    begin = np.array([width_px, height_um, 0.0, 0.0, 0.0, 0.0, 0.0])
    reach = np.array([width_px * (1.0 - 1.0 / WIDER), np.inf, width_px, width_px, np.inf, np.inf, np.inf])
    width, height, down, right, *_ = least_squares(residual, begin, bounds=(begin - reach, begin + reach)).x.tolist()
    return width, height, (down, right)
