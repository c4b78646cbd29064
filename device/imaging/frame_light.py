"""Light of a frame: levels of each colour's own pixels, gains and offsets of its channels, and shares of each light.

Levels are fractions of full scale above black. Lights drift, and light of the surroundings leaks in. Shares are of the
intensity of untouched skin, measured with each light alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from device.errors import FrameError
from device.imaging.flat_field import DARK_FLOOR, SATURATED
from device.surface import Float32Array, Float64Array, MaskArray
from hal.frame import CameraSettings, RawFrame

BRIGHTEST_PERCENTILE: Final = 99.9
"""Percentile taken as the brightest level; the remaining thousandth of the pixels are glints."""

HIGHEST_LEVEL: Final = 0.90
"""Maximum level of a ball press in every channel; above it steep slopes saturate."""

LIVE_STEP: Final = 4
"""Levels of live frames need no more than a sixteenth of the pixels."""

Levels = tuple[float, float, float]
_COLOURS: Final = ("red", "green", "blue")


def channel_levels(frame: RawFrame, percentile: float) -> Levels:
    """Return a percentile of the R, G and B pixels, each as a fraction of full scale above black."""
    scale = 1.0 / (frame.white_level_dn - frame.black_level_dn)
    found = []
    for colour in "RGB":
        counts = _sites(frame, colour)
        found.append((float(np.percentile(counts, percentile)) - frame.black_level_dn) * scale)
    red, green, blue = found
    return red, green, blue


def _sites(frame: RawFrame, colour: str) -> NDArray[np.uint16]:
    """Return the counts of all pixels of a colour: uint16 array of shape (n,)."""
    sites = [i for i, letter in enumerate(frame.bayer_order) if letter == colour]
    return np.concatenate([frame.mosaic[i // 2 :: 2, i % 2 :: 2].ravel() for i in sites])


@dataclass(frozen=True, slots=True)
class SkinLevels:
    """Light of one frame: fractions of full scale above black, R, G, B.

    median : of all pixels of the colour
    clipped : fraction of them that are saturated
    """

    median: Levels
    clipped: Levels

    @classmethod
    def of_frame(cls, frame: RawFrame) -> Self:
        """Return the levels of every `LIVE_STEP`-th cell of the mosaic, row and column: for every live frame."""
        few = replace(frame, mosaic=_every_cell(frame.mosaic, LIVE_STEP))
        limit = frame.black_level_dn + SATURATED * (frame.white_level_dn - frame.black_level_dn)
        full = replace(few, mosaic=(few.mosaic >= limit).astype(np.uint16))
        red, green, blue = (float(np.mean(_sites(full, colour))) for colour in "RGB")
        return cls(channel_levels(few, 50.0), (red, green, blue))


def _every_cell(mosaic: NDArray[np.uint16], step: int) -> NDArray[np.uint16]:
    """Return every `step`-th 2x2 cell of a mosaic in both directions: uint16 array of shape (h, w)."""
    rows, columns = (size // 2 // step * step for size in mosaic.shape)
    cells = mosaic[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2)[::step, :, ::step]
    return np.ascontiguousarray(cells).reshape(2 * (rows // step), 2 * (columns // step))


@dataclass(frozen=True, slots=True)
class Brightness:
    """Part of the sensor's range that a calibration uses: fractions of full scale above black, R, G, B.

    flat : median of untouched skin
    brightest : 99.9th percentile of the brightest ball press
    """

    flat: Levels
    brightest: Levels

    @classmethod
    def of_frames(cls, reference: RawFrame, presses: Sequence[RawFrame]) -> Self:
        """Return the brightness of a reference and its presses."""
        red, green, blue = (
            max(values)
            for values in zip(*(channel_levels(frame, BRIGHTEST_PERCENTILE) for frame in presses), strict=True)
        )
        return cls(channel_levels(reference, 50.0), (red, green, blue))

    @classmethod
    def of_figures(cls, figures: Mapping[str, float | None]) -> Self | None:
        """Return the brightness from a calibration's figures; None when they lack it."""
        values = [figures.get(f"{what}_level_{colour}") for what in ("flat", "brightest") for colour in _COLOURS]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        return cls((known[0], known[1], known[2]), (known[3], known[4], known[5]))

    def figures(self) -> dict[str, float | None]:
        """Return the figures for a calibration's record."""
        return {
            f"{what}_level_{colour}": level
            for what, levels in (("flat", self.flat), ("brightest", self.brightest))
            for colour, level in zip(_COLOURS, levels, strict=True)
        }

    @property
    def sentence(self) -> str:
        """Both levels in a sentence."""
        return f"flat skin at {_percentages(self.flat)}, brightest {_percentages(self.brightest)} of full scale"

    @property
    def warning(self) -> str:
        """Warning when ball presses are too bright, otherwise empty."""
        if max(self.brightest) <= HIGHEST_LEVEL:
            return ""
        return (
            f"the brightest reach {_percentages(self.brightest)} of full scale, over {HIGHEST_LEVEL:.0%}: "
            "run `retroscan calibrate --auto-exposure`"
        )


def _percentages(levels: Levels) -> str:
    return ", ".join(f"{letter} {level:.0%}" for letter, level in zip("RGB", levels, strict=True))


COMMON_SIGMA: Final = 1e-4
"""Standard uncertainty of the levels of a frame all of whose skin is at rest. Where a part is, it is larger by one over
that fraction: light from the object and skin that sinks towards rest change the levels."""

BLOCKS: Final = (6, 8)
BLOCKS_ALIKE: Final = 2.0
MIN_BLOCKS: Final = 6
SHOWN: Final = 0.25
"""Rows and columns of blocks of the field, of which so many err together; levels are found where so many show skin at
rest on at least this fraction of their cells."""

DOUBTED: Final = 3.0
"""Standard uncertainties up to which a level is none."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameLight:
    """Light of a frame against that of the calibration.

    gains : float64 array of shape (3,), brightness of each channel's lights over the calibration's
    offsets : float64 array of shape (3,), light that does not come from them, fraction of full scale
    """

    gains: Float64Array
    offsets: Float64Array

    @classmethod
    def unchanged(cls) -> FrameLight:
        """Return the light of the calibration."""
        return cls(np.ones(3), np.zeros(3))

    @property
    def change(self) -> float:
        """Largest change of a gain, relative."""
        return float(np.abs(self.gains - 1.0).max())

    @property
    def stray(self) -> float:
        """Largest offset, fraction of full scale."""
        return float(np.abs(self.offsets).max())

    def take_out(self, values: Float32Array, flat_field: Float32Array) -> None:
        """Write the intensity under the calibration's light over that of a frame.

        values, flat_field : float32 arrays of shape (H, W, 3)
        """
        if self.change == 0.0 and self.stray == 0.0:
            return
        # One value a column and channel: a loop over three channels alone takes four times the time.
        columns = (values.shape[1], 1)
        dark = np.maximum(flat_field, np.float32(DARK_FLOOR))
        np.divide(np.tile(self.offsets.astype(np.float32), columns), dark, out=dark)
        values -= dark
        values *= np.tile((1.0 / self.gains).astype(np.float32), columns)


def certain_levels(
    levels: Float64Array, left: Float32Array, resting: MaskArray, darkness: Float32Array
) -> tuple[Float64Array, Float64Array]:
    """Return gains (logarithms) and offsets, shape (3,), zero where they do not exceed their uncertainty.

    levels : gains and offsets as fitted, shape (3, 2)
    left : what they leave of the log intensity of cells, shape (h, w, 3); its means over blocks of the field, which err
        together, show the uncertainty
    resting : True for cells at rest, shape (h, w)
    darkness : one over the light of untouched skin, shape (h, w, 3)
    """
    rest = resting.astype(np.float32)[..., None]
    share, mean, dark = (
        cv2.resize(part, BLOCKS[::-1], interpolation=cv2.INTER_AREA) for part in (rest, rest * left, rest * darkness)
    )
    shown = share > SHOWN
    if np.count_nonzero(shown) < MIN_BLOCKS:
        return np.zeros(3), np.zeros(3)
    means, darks = (part[shown].astype(np.float64) / share[shown][:, None] for part in (mean, dark))
    variance, common = BLOCKS_ALIKE * means.var(axis=0), COMMON_SIGMA / float(resting.mean())
    spread = np.maximum(np.square(darks - darks.mean(axis=0)).sum(axis=0), 1e-12)
    gain = _exceeding(levels[:, 0], np.sqrt(variance / len(means) + common**2))
    return gain, _exceeding(levels[:, 1], np.sqrt(variance / spread + common**2))


def _exceeding(values: Float64Array, sigma: Float64Array) -> Float64Array:
    """Return values (3,), shrunk to zero where they are no larger than `DOUBTED` standard uncertainties."""
    square = float(np.square(values / (DOUBTED * sigma)).mean())
    return np.asarray(values * (1.0 - 1.0 / max(square, 1.0) ** 2))


# Light that is not the instrument's own: a frame under no light, taken out of a frame under all.

SAME: Final = 0.01
"""Relative difference of settings that changes ambient light by less than its own noise."""


def without_ambient(frame: RawFrame, dark: RawFrame) -> RawFrame:
    """Return the frame without the light that a frame under no light shows; saturated pixels stay so.

    dark : of equal size and Bayer order, with nearly equal settings; its counts may have another scale

    Raises
    ------
    FrameError
        Size, order or settings differ.
    """
    alike = (dark.shape, dark.bayer_order) == (frame.shape, frame.bayer_order)
    if not alike or not _nearly_equal(dark.granted, frame.granted):
        raise FrameError("the dark frame was not taken as the scan was: scan again")
    span = frame.white_level_dn - frame.black_level_dn
    scale = np.float32(span / (dark.white_level_dn - dark.black_level_dn))
    mosaic = np.empty_like(frame.mosaic)
    limit, top = frame.black_level_dn + SATURATED * span, np.iinfo(np.uint16).max
    for row, (counts, below) in enumerate(zip(frame.mosaic, dark.mosaic, strict=True)):
        ambient = (below.astype(np.float32) - np.float32(dark.black_level_dn)) * scale
        mosaic[row] = np.where(counts >= limit, counts, np.clip(np.rint(counts - ambient), 0.0, top))
    return replace(frame, mosaic=mosaic)


def _nearly_equal(one: CameraSettings, other: CameraSettings) -> bool:
    """Return whether two frames were taken alike: exposures are whole microseconds, or lines of the sensor."""
    exposure = abs(one.exposure_us - other.exposure_us) <= max(SAME * other.exposure_us, 1.0)
    return exposure and abs(one.analogue_gain - other.analogue_gain) <= SAME * other.analogue_gain


def ambient_fraction(dark: RawFrame) -> float:
    """Return the mean light of a frame under no light, fraction of full scale."""
    span = dark.white_level_dn - dark.black_level_dn
    return (float(dark.mosaic.mean()) - dark.black_level_dn) / span


MAX_RESIDUAL: Final = 0.012
"""Largest rms disagreement between the lights alone and the reference, relative; pressed skin disagrees by more."""

NOISE_FLOOR: Final = 0.02
NOISIER: Final = 6.0
"""A block contradicts if a channel is off by more than NOISIER times the median block, or than NOISE_FLOOR."""

MAX_DUSTY: Final = 0.1
DUST_PASSES: Final = 3
EQUALLY: Final = 0.4
"""Dust and scratches darken a block under every light alike: its channels differ by at most EQUALLY of their mean loss.
Such blocks are left out, with neighbours that are nowhere brighter, in at most MAX_DUSTY of the field. Whatever else
contradicts is an object in contact."""

MIN_LEVEL: Final = 0.1
"""A light below this fraction of its calibrated level is out: its shares cannot be measured."""


@dataclass(frozen=True, slots=True, eq=False)
class LightShares:
    """Shares of the lights in the channels of untouched skin.

    shares : float32 array of shape (rows, columns of blocks, 3 channels, 3 lights); over the lights they add up to 1
    """

    shares: Float32Array

    @classmethod
    def measure(cls, alone: Sequence[Float32Array], dark: Float32Array) -> LightShares | None:
        """Return the shares from frames of untouched skin under each light alone, in R, G, B order, and under none.

        alone, dark : the blocks' light relative to the reference, float32 arrays of shape (rows, columns, 3). None if
            no levels of the lights explain the reference, because something touches the skin or a light is out.
        """
        lit = np.stack([light - dark for light in alone], axis=-1)
        design = lit.reshape(-1, lit.shape[-1]).astype(np.float64)
        target = (1.0 - dark).ravel().astype(np.float64)
        kept, fine = np.ones(lit.shape[:2], np.bool_), False
        for _ in range(DUST_PASSES):
            used = kept.ravel().repeat(3)
            inverse_levels, *_ = np.linalg.lstsq(design[used], target[used], rcond=None)
            excess = (design @ inverse_levels - target).reshape(*lit.shape[:2], 3)
            kept, fine = _without_dust(excess)
        residual = float(np.sqrt(np.mean(excess[kept] ** 2)))
        if not fine or (~kept).mean() > MAX_DUSTY:
            return None
        if residual > MAX_RESIDUAL or not (inverse_levels > 0.0).all() or (inverse_levels > 1.0 / MIN_LEVEL).any():
            return None
        calibrated = lit * inverse_levels
        return cls(np.asarray(calibrated / calibrated.sum(axis=-1, keepdims=True), np.float32))

    @classmethod
    def by_channel(cls) -> LightShares:
        """Return the shares when each channel shows its own light alone, everywhere."""
        return cls(np.eye(3, dtype=np.float32)[None, None])

    def levels(self, ratio: Float32Array) -> Float32Array:
        """Return the level of each light in each block, float32 array of shape (rows, columns, 3), 1 as calibrated.

        ratio : the blocks' intensity relative to the reference, of that shape; on untouched skin every block then shows
            the same levels
        """
        return np.asarray(np.linalg.solve(self.shares, ratio[..., None])[..., 0], np.float32)

    def channels(self, levels: Sequence[float]) -> tuple[float, float, float]:
        """Return the mean intensity of untouched skin in R, G and B under these levels of the lights."""
        red, green, blue = (float(value) for value in self.shares.mean(axis=(0, 1)) @ np.asarray(levels))
        return red, green, blue


def _without_dust(excess: Float64Array) -> tuple[MaskArray, bool]:
    """Return blocks without dust, bool array of shape (rows, columns), and whether none of them contradicts.

    excess : the blocks' light over what the levels explain, relative, float64 array of shape (rows, columns, 3)
    """
    limit = max(NOISE_FLOOR, NOISIER * float(np.median(np.abs(excess).max(axis=-1))))
    loss, spread = -excess.mean(axis=-1), np.ptp(excess, axis=-1)
    dust = (excess < -limit / 2.0).all(axis=-1) & (loss > limit) & (spread < EQUALLY * loss + limit / 2.0)
    beside = cv2.dilate(dust.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    off = np.abs(excess).max(axis=-1) > limit
    kept = ~(dust | (beside & off & (excess < limit).all(axis=-1)))
    return np.asarray(kept, np.bool_), not (off & kept).any()
