"""Centre of one ball, read from rings around it.

Two readings of the centre share no assumption. The *circle*: around its true centre the pressed skin is rotationally
symmetric, so that intensity along a ring has a mean and a first harmonic; an offset shows as a second harmonic where
the shading leaves the straight ramp, chiefly at the rim. Shadows, perspective and lights close by bias it by some
hundredths of the radius. The *apex*: there the skin is flat, so that intensity returns to 1 but for a common
brightening. It has no such bias, but an uneven reference moves it. So the evenness of the frame's flat skin decides
how far the apex is followed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import MAX_DISAGREEMENT, NormalizedImage
from device.surface import Float32Array, Float64Array

RING_INNER: Final = 0.2
RING_OUTER: Final = 1.4
"""Rings that show the circle, shares of the ball's radius."""

APEX_PATCH: Final = 0.45
"""Radius of the patch in which intensity is interpolated to the apex, share of the ball's radius."""

BENT_PATCH: Final = 0.15
"""... where a light sets near the apex, so that its shading has a bend there ..."""

MAX_BEND: Final = 2.3
"""... which is where a cubic leaves this much more of the wide than of the small patch: 1.0 to 1.2 under the lights of
makers' devices, 2 with a coat that shines, 2.5 to 4 where a light hardly reaches the untouched skin."""

COMMON_SIGMA: Final = 0.028
"""Uncertainty of the apex, relative to the radius, at which the balls' common way to it is gone half."""

OWN_SIGMA: Final = 0.01
"""Uncertainty of the apex, relative to the radius, at which each ball's own way to it is gone half."""

NORMAL_QUARTILE: Final = 0.319
"""Lower quartile of a standard normal variable's magnitude."""

STEPS: Final = 16
LONGEST_STEP: Final = 0.15
AT_REST: Final = 5e-4
"""A centre is sought in at most so many steps, each held to a share of the radius, until they are this short."""

ANGLES: Final = 48
MAX_SHIFT: Final = 0.7
"""A centre this many radii from where the ramps are is another thing's centre."""

INVALID_WEIGHT: Final = 0.3
"""Weight of an invalid pixel beside a valid one: where one channel clips, the others still show the slope."""

SEEN_FRACTION: Final = 0.7
"""A ring counts when this share of it is inside the frame."""

_CUBIC: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))


@dataclass(frozen=True, slots=True, eq=False)
class RadialProfiles:
    """Harmonics of intensity along concentric rings.

    distance : float64 array of shape (K,), shares of the ball's radius
    first, second : complex128 arrays of shape (K, 3), amplitudes of exp(1j angle) and exp(2j angle)
    rest : float64 array of shape (K, 3), mean square that harmonics up to the third leave
    seen : float64 array of shape (K,), share of each ring inside the frame
    """

    distance: Float64Array
    first: NDArray[np.complex128]
    second: NDArray[np.complex128]
    rest: Float64Array
    seen: Float64Array


def sample_radial_profiles(
    reduced: ReducedIntensity, centre: Float64Array, radius_px: float, distance: Float64Array
) -> RadialProfiles:
    """Return harmonics along rings around a centre (column, row); position and radius in reduced pixels."""
    angle = np.arange(ANGLES) * (2.0 * np.pi / ANGLES)
    at_column = (centre[0] + radius_px * distance[:, None] * np.cos(angle)).astype(np.float32)
    at_row = (centre[1] + radius_px * distance[:, None] * np.sin(angle)).astype(np.float32)
    values = cv2.remap(reduced.deviation, at_column, at_row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = cv2.remap(reduced.weight, at_column, at_row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rows, columns = reduced.weight.shape
    inside = (at_column > -0.5) & (at_column < columns - 0.5) & (at_row > -0.5) & (at_row < rows - 0.5)
    weight = inside * (INVALID_WEIGHT + (1.0 - INVALID_WEIGHT) * seen.astype(np.float64))
    waves = [np.ones_like(angle)] + [wave(k * angle) for k in (1, 2, 3) for wave in (np.cos, np.sin)]
    design = np.stack(waves, axis=-1)
    gram = np.einsum("ka,am,an->kmn", weight, design, design) + 1e-3 * np.eye(7)
    moments = np.einsum("ka,am,kac->kmc", weight, design, values)
    found = np.linalg.solve(gram, moments)
    left = values - np.einsum("am,kmc->kac", design, found)
    rest = (weight[..., None] * left**2).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-6)[:, None]
    first, second = found[:, 1] - 1j * found[:, 2], found[:, 3] - 1j * found[:, 4]
    return RadialProfiles(distance, 0.5 * first, 0.5 * second, rest, inside.mean(axis=1))


def find_circle(reduced: ReducedIntensity, column: float, row: float, radius_px: float) -> Float64Array:
    """Return the centre of rotational symmetry near (column, row), no further than a radius away; in reduced pixels."""
    start = np.array([column, row])
    found = _follow(lambda at: _circle_step(reduced, at, radius_px), start, radius_px)
    return found if float(np.hypot(*(found - start))) < MAX_SHIFT * radius_px else start


def find_apex(reduced: ReducedIntensity, circle: Float64Array, radius_px: float) -> Float64Array:
    """Return where the skin is flat near the centre of symmetry, no further than a radius away; in reduced pixels."""
    found = _follow(lambda at: _apex_step(reduced, at, radius_px, APEX_PATCH), circle, radius_px)
    if _is_bent(reduced, found, radius_px):
        found = _follow(lambda at: _apex_step(reduced, at, radius_px, BENT_PATCH), found, radius_px)
    return found if float(np.hypot(*(found - circle))) < MAX_SHIFT * radius_px else circle


def join_centres(
    reduced: ReducedIntensity, circles: Float64Array, apexes: Float64Array, radius_px: float
) -> Float64Array:
    """Return centres of a frame's balls from both readings, float64 array (number of balls, 2), in reduced pixels.

    The way from circles to apexes is split into the part common to all balls and each ball's own, because one uneven
    spot under a ball spoils its own apex long before it spoils the common one.
    """
    if not len(circles):
        return np.zeros((0, 2))
    rows, columns = reduced.weight.shape
    margin = np.minimum(circles, np.array([columns, rows]) - 1.0 - circles).min(axis=1)
    whole = margin > radius_px if (margin > radius_px).any() else np.ones(len(circles), np.bool_)
    apex_sigma = _sigma_of_apex(reduced, circles[whole], radius_px)
    way = apexes - circles
    common = np.median(way[whole], axis=0)
    return np.asarray(
        circles + _trust(apex_sigma, COMMON_SIGMA) * common + _trust(apex_sigma, OWN_SIGMA) * (way - common)
    )


def _trust(apex_sigma: float, limit: float) -> float:
    """Return the weight of a reading of this standard uncertainty: near 1 well under the limit, near 0 well above."""
    return 1.0 / (1.0 + (apex_sigma / limit) ** 8)


def _sigma_of_apex(reduced: ReducedIntensity, circles: Float64Array, radius_px: float) -> float:
    """Return how far an apex may be off, share of the radius: unevenness of the frame's flat skin over the balls' ramp.

    Unevenness is a lower quartile of colour, averaged over patches: what is common to the channels is a light's drift.
    """
    colour = reduced.deviation - reduced.deviation.mean(axis=-1, keepdims=True)
    patch = 2 * int(APEX_PATCH * radius_px) + 1
    uneven = float(np.quantile(np.abs(cv2.blur(colour, (patch, patch))), 0.25)) / NORMAL_QUARTILE
    near = np.arange(0.1, APEX_PATCH, 0.1)
    rings = [sample_radial_profiles(reduced, circle, radius_px, near) for circle in circles]
    ramps = [np.median(2.0 * np.sqrt((np.abs(r.first) ** 2).sum(axis=1)) / near) for r in rings]
    return float(np.sqrt(2.0) * uneven / max(np.median(ramps), 1e-9))


def _follow(step: Callable[[Float64Array], Float64Array], start: Float64Array, radius_px: float) -> Float64Array:
    """Return where repeated steps come to rest, each held to a share of the radius."""
    at = start.astype(np.float64)
    for _ in range(STEPS):
        move = step(at)
        length = float(np.hypot(*move))
        at = at + move * min(1.0, LONGEST_STEP * radius_px / max(length, 1e-9))
        if length < AT_REST * radius_px:
            break
    return at


def _circle_step(reduced: ReducedIntensity, at: Float64Array, radius_px: float) -> Float64Array:
    """Return the shift (column, row), reduced px, that cancels the second harmonic over all rings.

    Moving the origin adds (f' - f / distance) / 2 to that harmonic.
    """
    distance = np.arange(RING_INNER, RING_OUTER, 1.0 / 14.0)
    rings = sample_radial_profiles(reduced, at, radius_px, distance)
    bend = np.gradient(rings.first, distance, axis=0) - rings.first / distance[:, None]
    weight = (distance * rings.seen * (rings.seen > SEEN_FRACTION))[:, None]
    power = float((weight * np.abs(bend) ** 2).sum())
    shift = -2.0 * complex((weight * np.conj(bend) * rings.second).sum()) / max(power, 1e-12)
    return np.array([shift.real, -shift.imag]) * radius_px


def _apex_step(reduced: ReducedIntensity, at: Float64Array, radius_px: float, patch: float) -> Float64Array:
    """Return the shift to where the patch's cubic fit reads 1 in every channel, but for a common brightening."""
    fit, _ = _fit_cubic(reduced, at, radius_px, patch)
    system = np.zeros((4, 3))
    system[:3, :2], system[:3, 2], system[3, 2] = fit[1:3].T, -1.0, 1.0
    move = np.linalg.lstsq(system, np.append(-fit[0], 0.0), rcond=None)[0]
    return np.asarray(move[:2] * radius_px)


def _is_bent(reduced: ReducedIntensity, at: Float64Array, radius_px: float) -> bool:
    """Return True if no cubic follows the shading near an apex.

    It then leaves much more of a wide patch than of a small one.
    """
    (_, wide), (_, small) = (_fit_cubic(reduced, at, radius_px, patch) for patch in (APEX_PATCH, BENT_PATCH))
    return wide > MAX_BEND * small


def _fit_cubic(
    reduced: ReducedIntensity, at: Float64Array, radius_px: float, patch: float
) -> tuple[Float64Array, float]:
    """Cubic of the deviation around a place, and what it leaves.

    Returns
    -------
    float64 array of shape (10, 3), coefficients over distances in radii; root mean square of the rest
    """
    reach = int(np.ceil(patch * radius_px + 1.0))
    rows, columns = reduced.weight.shape
    top, bottom = (min(max(round(at[1]) + side, 0), rows) for side in (-reach, reach + 1))
    left, right = (min(max(round(at[0]) + side, 0), columns) for side in (-reach, reach + 1))
    window = np.s_[top:bottom, left:right]
    row, column = (axis.astype(np.float64) for axis in np.mgrid[window])
    across, down = (column - at[0]) / radius_px, (row - at[1]) / radius_px
    soft = np.clip((patch - np.hypot(across, down)) * radius_px + 0.5, 0.0, 1.0)
    weight = soft * reduced.weight[window]
    design = np.stack([across**i * down**j for i, j in _CUBIC], axis=-1)
    weighted = design * weight[..., None]
    gram = np.einsum("yxk,yxl->kl", weighted, design) + 1e-6 * np.eye(len(_CUBIC))
    fit = np.linalg.solve(gram, np.einsum("yxk,yxc->kc", weighted, reduced.deviation[window]))
    rest = (weight[..., None] * (reduced.deviation[window] - design @ fit) ** 2).sum()
    return fit, float(np.sqrt(rest / max(3.0 * weight.sum(), 1e-6)))


# Places in a press where the skin may wrap a ball.
#
# Near the apex of a ball every light draws a ramp, and three lights draw ramps in different directions: a patch is a
# candidate where the weaker of two independent ramps is strong beside what both leave of its deviation from the flat
# skin. This holds for any three lights and any skin, so that no reflectance model is needed yet.

PATCH: Final = 0.45
"""Radius of the patch that is fitted, share of the ball's radius."""

MIN_SCORE: Final = 0.35
"""Deviation that a second ramp must explain, relative to what two ramps leave, for a patch to count."""

NOISE_MARGIN: Final = 8.0
"""Ramps weaker than this many times the frame's median ramp energy lose half of their score."""


@dataclass(frozen=True, slots=True, eq=False)
class ReducedIntensity:
    """An intensity image reduced by area, so that a ball spans few pixels.

    deviation : float32 array of shape (h, w, 3), intensity less 1
    weight : float32 array of shape (h, w), share of valid pixels under each reduced pixel
    columns_per_pixel, rows_per_pixel : full-size pixels that one reduced pixel spans
    """

    deviation: Float32Array
    weight: Float32Array
    columns_per_pixel: float
    rows_per_pixel: float

    def to_full(self, column: float, row: float) -> tuple[float, float]:
        """Return full-size (column, row) of a reduced position."""
        return (column + 0.5) * self.columns_per_pixel - 0.5, (row + 0.5) * self.rows_per_pixel - 0.5

    def from_full(self, column: float, row: float) -> tuple[float, float]:
        """Reduced (column, row) of a full-size position."""
        return (column + 0.5) / self.columns_per_pixel - 0.5, (row + 0.5) / self.rows_per_pixel - 0.5


def reduce_intensity(image: NormalizedImage, factor: float) -> ReducedIntensity:
    """Return the image reduced by about `factor` (no enlargement), invalid pixels weighed zero."""
    rows, columns = image.shape
    factor = max(factor, 1.0)
    size = (max(round(columns / factor), 1), max(round(rows / factor), 1))
    values = cv2.resize(image.values, size, interpolation=cv2.INTER_AREA)
    weight = cv2.resize(image.valid.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    deviation = np.nan_to_num(values - np.float32(1.0), nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    return ReducedIntensity(deviation, np.asarray(weight, np.float32), columns / size[0], rows / size[1])


def find_candidates(reduced: ReducedIntensity, radius_px: float, *, common_factor: bool) -> list[tuple[float, float]]:
    """Return full-size (column, row) of candidates, best first, at least one `radius_px` (in reduced pixels) apart.

    common_factor : the mean of a patch may differ from untouched skin by one factor in all channels, as two frames of
        one calibration may
    """
    score = _ramp_score(reduced.deviation, radius_px, common_factor)
    reach = max(int(radius_px), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    rows, columns = np.nonzero((score >= cv2.dilate(score, disc)) & (score > MIN_SCORE))
    best = np.argsort(-score[rows, columns], kind="stable")
    return [reduced.to_full(float(columns[number]), float(rows[number])) for number in best]


def _ramp_score(deviation: Float32Array, radius_px: float, common_factor: bool) -> Float32Array:
    """Return the fraction of each patch's deviation that ramps in two independent directions explain, shape (h, w)."""
    basis, disc = _patch_basis(PATCH * radius_px)
    area = float(disc.sum())
    gram: Float64Array = np.einsum("kyx,lyx,yx->kl", basis, basis, disc)
    inverse = np.linalg.inv(gram)
    ramps, levels, rest = [], [], np.zeros(deviation.shape[:2])
    for channel in range(3):
        plane = np.ascontiguousarray(deviation[..., channel])
        moments = np.stack([_correlate(plane, kernel * disc) for kernel in basis])
        fit = np.einsum("kl,lyx->kyx", inverse, moments)
        energy = _correlate(plane * plane, disc)
        rest += np.maximum(energy - (moments * fit).sum(axis=0), 0.0) / area
        levels.append(fit[0] + 0.25 * (fit[3] + fit[5]))
        ramps.append(fit[1:3])
    level = np.stack(levels)
    shared = np.clip(level.mean(axis=0), -MAX_DISAGREEMENT, MAX_DISAGREEMENT) if common_factor else 0.0
    rest += ((level - shared) ** 2).sum(axis=0)
    slopes = np.stack(ramps)
    across, down = (slopes[:, 0] ** 2).sum(axis=0), (slopes[:, 1] ** 2).sum(axis=0)
    both = (slopes[:, 0] * slopes[:, 1]).sum(axis=0)
    weaker = 0.5 * (across + down) - np.hypot(0.5 * (across - down), both)
    floor = NOISE_MARGIN * float(np.median(0.25 * (across + down))) + 1e-9
    # The stronger ramp does not count against the weaker: beside a near light it may be many times as strong.
    explained = 0.5 * weaker
    return np.asarray(explained / (explained + rest + floor), np.float32)


def _patch_basis(radius_px: float) -> tuple[Float64Array, Float64Array]:
    """Return polynomials 1, x, y, x², xy, y² (6, k, k) in units of the radius, and the soft disc (k, k)."""
    reach = int(np.ceil(radius_px + 0.5))
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1] / radius_px
    disc = np.clip((1.0 - np.hypot(row, column)) * radius_px + 0.5, 0.0, 1.0)
    basis = np.stack([np.ones_like(row), column, row, column**2, column * row, row**2])
    return basis, disc


def _correlate(plane: Float32Array, kernel: Float64Array) -> Float64Array:
    """Return the correlation with a small kernel, borders repeated, float64 array of the plane's shape."""
    found = cv2.filter2D(plane, cv2.CV_32F, kernel.astype(np.float32), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float64)
