"""Findings on untouched skin: present light levels, their drift since calibration, defects of the gel.

Light levels: the field is cut into blocks. A block of untouched skin differs from the reference by one factor per
channel and by sensor noise; shading spreads more widely. Where enough blocks agree on the three factors, those are the
light levels. Otherwise the frame gives no evidence, because pressed skin changes intensity as a weak light does. With
the lights' shares (`light_shares`) blocks agree on the lights themselves rather than on the channels.

A flat object over the whole field looks much like untouched skin. Two properties reveal it: near lights reach raised
skin unevenly, so that blocks disagree; and a tilt brightens one side as much as it darkens the other, so that the three
changes add up to zero.

Beside a press little skin may be left untouched. The largest group of calm blocks near the field's border that agree
is that skin, if the frame also shows the steep skin at an object's edge: a gentle object over the whole field has none,
and any of its places may look like untouched skin under other lights. A flat face in the middle is raised, which makes
it darker by about as much as a light is to be known to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.imaging.flat_field import LinearFrame, NormalizedImage
from device.imaging.frame_light import Levels, LightShares
from device.inverse_map.regressor import monomials
from device.quality.press_faults import DEFECT_CONTRAST, MAX_DEFECTS
from device.surface import Float32Array, MaskArray

BLOCKS_ACROSS: Final = 24
AGREEING: Final = 0.006
NOISE_SIGMAS: Final = 3.0
AGREEING_PER_CHANGE: Final = 0.12
"""Inlier tolerance of a block: AGREEING + NOISE_SIGMAS · standard error + AGREEING_PER_CHANGE · |change|; the last term
covers filter crosstalk, which varies over the field."""

MIN_FRACTION: Final = 0.33
"""Minimum fraction of blocks that must agree."""

WHOLE_FRACTION: Final = 0.9
"""Fraction of agreeing blocks from which the whole field is untouched."""

NOISIER: Final = 1.5
SPREAD_FLOOR: Final = 0.003
"""A block is shaded if its spread exceeds NOISIER · its spread in the reference + SPREAD_FLOOR."""

TILT_BALANCE: Final = 0.35
MIN_TILT_CHANGE: Final = 0.008
"""Changes above MIN_TILT_CHANGE whose sum is below TILT_BALANCE · the largest come from a tilt, not from lights."""

SHARED_NOISE: Final = 2.0
"""Factor by which taking the lights apart amplifies a block's noise where their shares are least distinct."""

BESIDE_WINDOW: Final = 0.006
BESIDE_FRACTION: Final = 0.03
BESIDE_RIVAL: Final = 0.7
BESIDE_CHANGE: Final = 0.007
"""Beside a press, the largest group of blocks within BESIDE_WINDOW is untouched skin if it has BESIDE_FRACTION of all
blocks and the second largest at most BESIDE_RIVAL of that. The skin near an object is not quite flat, so levels are
accepted only within BESIDE_CHANGE of the calibrated ones."""

BORDER_BLOCKS: Final = 3
"""Width of the border, in blocks, in which that skin is sought."""

STEEP_CHANGE: Final = 0.2
STEEP_FRACTION: Final = 0.02
"""A frame in which intensity differs by STEEP_CHANGE from flat skin's in STEEP_FRACTION of the blocks shows an edge."""

NOISE_BLUR_PX: Final = 1.0
SURROUNDINGS_PX: Final = 8.0
"""Standard deviations of the Gaussians that average a spot and its surroundings, in quick-look pixels."""


@dataclass(frozen=True, slots=True)
class UntouchedRegion:
    """Untouched skin found in a frame.

    levels : of the lights relative to the reference; of the R, G and B channel where the lights' shares are unknown
    fraction : of the field's blocks that agree on them
    pattern : rms deviation of those blocks from the reference's pattern after removal of the levels
    """

    levels: Levels
    fraction: float
    pattern: float

    @property
    def is_whole(self) -> bool:
        """True if the whole field is untouched."""
        return self.fraction >= WHOLE_FRACTION

    @property
    def is_tilt(self) -> bool:
        """True if the changes look like a tilt of the whole field rather than a change of the lights."""
        changes = [level - 1.0 for level in self.levels]
        largest = max(abs(change) for change in changes)
        return largest > MIN_TILT_CHANGE and abs(sum(changes)) < TILT_BALANCE * largest


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceModel:
    """Block statistics of the reference's own intensity.

    mean, spread : float32 arrays of shape (rows, columns of blocks, 3)
    """

    mean: Float32Array
    spread: Float32Array

    @classmethod
    def of(cls, reference: NormalizedImage) -> ReferenceModel:
        """Return statistics of the reference's intensity image: the frame divided by its own flat field."""
        return cls(*_blocks(reference.values))

    def ratio(self, intensity: NormalizedImage) -> Float32Array:
        """Return the intensity of each block relative to the reference: float32 array (rows, columns of blocks, 3)."""
        return _blocks(intensity.values)[0] / self.mean

    def detect(self, intensity: NormalizedImage, shares: LightShares | None = None) -> UntouchedRegion | None:
        """Return untouched skin in an intensity image of the reference's size; None if too few blocks agree."""
        mean, spread = _blocks(intensity.values)
        ratio, window = mean / self.mean, self._window(intensity)
        per_change = AGREEING_PER_CHANGE
        if shares:
            ratio, window, per_change = shares.levels(ratio), SHARED_NOISE * window, 0.0
        agreeing = _agreeing(ratio, self._quiet(spread), window, per_change)
        if agreeing.mean() < MIN_FRACTION:
            return None
        return _region(ratio, agreeing)

    def lights_beside_press(self, intensity: NormalizedImage, shares: LightShares) -> Levels | None:
        """Return the light levels of untouched skin next to an object; None if unknown or not as calibrated."""
        mean, spread = _blocks(intensity.values)
        levels = shares.levels(mean / self.mean)
        if (np.abs(levels - 1.0).max(axis=-1) > STEEP_CHANGE).mean() < STEEP_FRACTION:
            return None
        calm = levels[self._quiet(spread) & (_unevenness(levels) < BESIDE_WINDOW) & _at_border(levels.shape[:2])]
        group = _largest_group(calm)
        if group.sum() < BESIDE_FRACTION * mean[..., 0].size:
            return None
        found = calm[group].mean(axis=0)
        rival = _largest_group(calm[np.abs(calm - found).max(axis=-1) > 2.5 * BESIDE_WINDOW])
        if rival.sum() > BESIDE_RIVAL * group.sum() or np.abs(found - 1.0).max() > BESIDE_CHANGE:
            return None
        return _as_levels(found)

    def assume_untouched(self, intensity: NormalizedImage, shares: LightShares | None = None) -> UntouchedRegion:
        """Return what `detect` does for a frame that is known to be untouched: every block counts."""
        ratio = self.ratio(intensity)
        return _region(shares.levels(ratio) if shares else ratio, np.ones(ratio.shape[:2], np.bool_))

    def _quiet(self, spread: Float32Array) -> MaskArray:
        return np.asarray((spread < NOISIER * self.spread + SPREAD_FLOOR).all(axis=-1))

    def _window(self, intensity: NormalizedImage) -> Float32Array:
        return np.asarray(AGREEING + NOISE_SIGMAS / _side(intensity.values) * self.spread, np.float32)


class LightDriftMonitor:
    """The last accepted levels of the lights."""

    def __init__(self) -> None:
        self._levels: Levels | None = None
        self._pattern: float | None = None
        self._measured_ns: int | None = None
        self._unseen_scans = 0

    @property
    def changes(self) -> Levels | None:
        """Relative change of each light since calibration, R, G, B; None before the first measurement."""
        if self._levels is None:
            return None
        red, green, blue = self._levels
        return (red - 1.0, green - 1.0, blue - 1.0)

    @property
    def pattern(self) -> float | None:
        """Rms change of the untouched skin's pattern in the last fully untouched frame; None before the first."""
        return self._pattern

    @property
    def unseen_scans(self) -> int:
        """Scans since the last accepted measurement."""
        return self._unseen_scans

    def changes_since(self, at_ns: int) -> Levels | None:
        """Return the changes measured in a fully untouched frame after that time (ns); None without one."""
        return self.changes if self._measured_ns is not None and self._measured_ns > at_ns else None

    def update(self, region: UntouchedRegion | None, at_ns: int) -> bool:
        """Use a frame that began at that time (ns); returns whether it was accepted, fully untouched."""
        if region is None or not region.is_whole or region.is_tilt:
            return False
        self._levels, self._pattern = region.levels, region.pattern
        self._measured_ns, self._unseen_scans = at_ns, 0
        return True

    def update_from_scan(self, levels: Levels | None) -> None:
        """Use the levels that a scan's frame showed beside the press, and count the scan if it showed none."""
        if levels is None:
            self._unseen_scans += 1
        else:
            self._levels, self._unseen_scans = levels, 0


def gel_defects(untouched: LinearFrame) -> MaskArray:
    """Scratches, dust and stains in a frame of untouched skin: bool array of shape (H, W)."""
    return np.asarray(np.abs(_contrast(untouched.rgb)).max(axis=-1) > DEFECT_CONTRAST, np.bool_)


def dark_spots(intensity: NormalizedImage) -> MaskArray:
    """Dust, scratches and stains since the calibration, in a frame with or without a press: bool array of shape (H, W).

    They are darker than their surroundings under every light alike; a slope turns away from one light and towards
    another, and what the reference shows too cancels.
    """
    return np.asarray(_contrast(intensity.values).max(axis=-1) < -DEFECT_CONTRAST, np.bool_)


def block_means(values: Float32Array) -> Float32Array:
    """Return the mean of each block of an image (H, W, 3): float32 array of shape (rows, columns of blocks, 3)."""
    return _blocks(values)[0]


def _contrast(values: Float32Array) -> Float32Array:
    """Return each spot's contrast to its surroundings by channel: float32 (H, W, 3), 0 where there is none."""
    margin = round(3.0 * SURROUNDINGS_PX)
    # Odd reflection continues a gradient of the light beyond the border, where plain reflection would bend it.
    padded = np.pad(values, ((margin, margin), (margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    spot = cv2.GaussianBlur(padded, (0, 0), NOISE_BLUR_PX)
    around = cv2.GaussianBlur(padded, (0, 0), SURROUNDINGS_PX)
    contrast = spot / np.maximum(around, np.float32(1e-3)) - np.float32(1.0)
    return np.asarray(contrast[margin:-margin, margin:-margin], np.float32)


def _side(values: Float32Array) -> int:
    """Return the side of a block, px."""
    return max(int(values.shape[1]) // BLOCKS_ACROSS, 2)


def _blocks(values: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return the mean and standard deviation of each block: float32 arrays of shape (rows, columns of blocks, 3)."""
    side = _side(values)
    rows, columns = values.shape[0] // side, values.shape[1] // side
    cut = np.ascontiguousarray(values[: rows * side, : columns * side]) - np.float32(1.0)
    mean, square = (cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA) for part in (cut, cut * cut))
    spread = np.sqrt(np.maximum(square - mean * mean, np.float32(0.0)))
    return np.asarray(mean + np.float32(1.0), np.float32), np.asarray(spread, np.float32)


def _agreeing(ratio: Float32Array, quiet: MaskArray, window: Float32Array, per_change: float) -> MaskArray:
    """Return the quiet blocks near the median, found by repeated outlier rejection."""
    kept = quiet
    for wider in (4.0, 2.0, 1.0, 1.0):
        if not kept.any():
            break
        level = np.median(ratio[kept], axis=0)
        allowed = wider * (window + per_change * np.abs(level - 1.0).max())
        kept = quiet & np.asarray((np.abs(ratio / level - 1.0) < allowed).all(axis=-1))
    return kept


def _unevenness(levels: Float32Array) -> Float32Array:
    """Return the standard deviation over 3x3 blocks, the largest of the three lights: float32 array (rows, columns)."""
    mean, square = (
        cv2.blur(part, (3, 3), borderType=cv2.BORDER_REPLICATE) for part in (levels - 1.0, (levels - 1.0) ** 2)
    )
    return np.asarray(np.sqrt(np.maximum(square - mean * mean, np.float32(0.0))).max(axis=-1), np.float32)


def _at_border(shape: tuple[int, ...]) -> MaskArray:
    """Return True in the blocks of the border; bool array of `shape` (rows, columns)."""
    border = np.ones(shape, np.bool_)
    border[BORDER_BLOCKS:-BORDER_BLOCKS, BORDER_BLOCKS:-BORDER_BLOCKS] = False
    return border


def _largest_group(levels: Float32Array) -> MaskArray:
    """Return the largest group of levels (N, 3) within `BESIDE_WINDOW` of one of them: bool array of shape (N,)."""
    if not len(levels):
        return np.zeros(0, np.bool_)
    near = np.abs(levels[:, None] - levels[None]).max(axis=-1) < BESIDE_WINDOW
    return np.asarray(near[near.sum(axis=1).argmax()], np.bool_)


def _region(ratio: Float32Array, kept: MaskArray) -> UntouchedRegion:
    level = ratio[kept].mean(axis=0)
    pattern = float(np.sqrt(np.mean((ratio[kept] / level - 1.0) ** 2)))
    return UntouchedRegion(_as_levels(level), float(kept.mean()), pattern)


def _as_levels(level: Float32Array) -> Levels:
    red, green, blue = (float(value) for value in level)
    return red, green, blue


# Check of a reference: untouched skin's light is smooth, without spots, and shaped as the last reference's.

SMOOTH_DEGREE: Final = 4
"""Degree in position of a polynomial that follows the logarithm of near lights over a field, to about one percent."""

MAX_UNEVEN: Final = 0.06
"""Largest relative deviation of a block's light from that polynomial on untouched skin."""

MAX_CHANGED: Final = 0.025
"""95th percentile of the relative change of a channel's shape since the last reference, levels removed."""

_DARK: Final = 1e-3


def reference_fault(reference: LinearFrame) -> str:
    """Return why a frame cannot be of clean, untouched skin; empty if it can.

    A frame of a smooth object over the whole field can.
    """
    defects = float(gel_defects(reference).mean())
    uneven = _deviation_from_smooth(block_means(reference.rgb))
    if uneven > MAX_UNEVEN:
        return f"something touches the gel: its light is uneven by {uneven:.0%}"
    if defects > MAX_DEFECTS:
        return f"{defects:.0%} of the skin is touched, scratched or dirty: lift off, wipe the gel"
    return ""


def changed_shape(reference: LinearFrame, last: LinearFrame) -> float:
    """Return the relative change of the light's shape over the field since the last reference.

    The lights' levels are taken out.
    """
    ratio = block_means(reference.rgb) / np.maximum(block_means(last.rgb), np.float32(_DARK))
    ratio /= np.median(ratio, axis=(0, 1))
    return float(np.percentile(np.abs(ratio - 1.0), 95))


def _deviation_from_smooth(light: Float32Array) -> float:
    """Return the largest deviation of the logarithm of blocks' light, (rows, columns, 3), from a smooth polynomial."""
    rows, columns, _ = light.shape
    across, down = np.meshgrid(np.linspace(-1.0, 1.0, columns), np.linspace(-1.0, 1.0, rows))
    design = monomials(np.stack([across.ravel(), down.ravel()], axis=-1), SMOOTH_DEGREE)
    target = np.log(np.maximum(light.reshape(-1, 3).astype(np.float64), _DARK))
    coefficients, *_ = np.linalg.lstsq(design, target, rcond=None)
    return float(np.abs(target - design @ coefficients).max())
