"""Radii of the balls by their shading, and the balls at the centres that the inverse map is fitted to.

A map from intensity to slope trained on many balls reads every ball. A ball that is smaller than stated is steeper at
each place than its stated radius makes it: the map reads its slopes by that share too steep. The common size of all
balls cannot be checked so: were all radii wrong by one share, the map would have learned slopes wrong by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from device.balls.detector import find_balls
from device.balls.sphere import BallSamples, gather_samples
from device.calibration.acceptance import MAX_RADIUS_SPREAD
from device.calibration.fit import BegunFit, begin_fit
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.inverse_map.near_light import IlluminationMap
from device.surface import Float64Array, MaskArray
from host_sync.calibration.balls import (
    PressFrame,
    UsedPress,
    add_detections,
    apply_fit,
    cut_to_core,
    relocate_labels,
    without_balls,
)

MAX_SAMPLES = 20_000
CONTRADICTS: Final = 0.16
STANDS_OUT: Final = 3.0
"""A ball whose radius is this far from the median, as a fraction and in deviations, contradicts the others ..."""

MAX_LEFT_OUT: Final = 0.3
"""... unless more than this fraction of the balls do."""

MIN_COMPARED: Final = 7
"""Balls from which contradicting radii are refused. Fewer do not show which one is wrong, nor whether any is: shading
under near lights differs from place to place. Their calibration does not pass."""

NORMAL_MAD: Final = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""

ROUNDS: Final = 2
"""A ball that contradicts may hide another: the map is fitted again without it and read once more."""


def radius_shares(samples: BallSamples, inverse_map: InverseMap) -> Float64Array:
    """Return the radius that shading gives each ball over the one stated, float64 array of shape (number of balls,).

    NaN for a ball without a faithful pixel.
    """
    step = max(1, len(samples.p) // MAX_SAMPLES)
    true = np.stack([samples.p[::step], samples.q[::step]], axis=-1).astype(np.float64)
    read = inverse_map.predict(samples.intensity[::step], samples.column[::step], samples.row[::step])
    ball = samples.ball[::step]
    count = int(samples.ball.max()) + 1
    agreement = np.bincount(ball, (read * true).sum(axis=-1), count)
    square = np.bincount(ball, (true**2).sum(axis=-1), count)
    return np.where(square > 0.0, square / np.maximum(agreement, 1e-9), np.nan)


def radius_spread(shares: Float64Array) -> float:
    """Return the standard deviation of the radii over their median.

    One or two lights show all slopes too flat, which is no disagreement among balls.
    """
    return float(np.nanstd(shares) / np.nanmedian(shares))


def without_disagreement(
    presses: Sequence[UsedPress], begun: BegunFit, light: IlluminationMap | None
) -> tuple[Sequence[UsedPress], BegunFit]:
    """Return the presses without balls whose radius contradicts the others', and the fit to the balls that are left.

    Skin that leaves the ball inside of what was taken for the contact flattens the rim, and by another share in every
    press: where radii contradict, contacts are cut to their core if held-out balls prefer that. Presses stay as they
    are where no ball stands out, or where so many do that nothing shows which are right.

    light : as of `fit_to`
    """
    shares = _shares_of(presses, begun)
    if radius_spread(shares[~contradicts(shares)]) > MAX_RADIUS_SPREAD:
        begun, presses = fit_to_cores([cut_to_core(press) for press in presses], begun, light) or (begun, presses)
    at_most = MAX_LEFT_OUT * len(shares)
    for _ in range(ROUNDS):
        shares = _shares_of(presses, begun)
        out = np.zeros(len(begun.fit.kept), np.bool_)
        out[begun.fit.kept] = left_out(shares, at_most)
        if not out.any():
            break
        at_most -= out.sum()
        read = np.full(len(out), np.nan)
        read[begun.fit.kept] = shares / np.nanmedian(shares)
        ends = np.cumsum([len(press.balls) for press in presses])[:-1]
        presses = [
            without_balls(
                press,
                gone,
                f"is {_mean(own[gone]):.2f} times as large by its shading as is stated, compared with the others",
            )
            for press, gone, own in zip(presses, np.split(out, ends), np.split(read, ends), strict=True)
        ]
        begun = fit_to(presses, light, begun)
    return presses, begun


def _shares_of(presses: Sequence[UsedPress], begun: BegunFit) -> Float64Array:
    """Return the radius shares of the balls that a fit kept."""
    used = apply_fit(presses, begun.fit)
    return radius_shares(gather_samples([(press.intensity, press.balls) for press in used]), begun.fit.map)


def _mean(values: Float64Array) -> float:
    return float(values.mean()) if values.size else 1.0


def contradicts(shares: Float64Array) -> MaskArray:
    """Return True for balls whose radius stands out of the others: bool array of shape (number of balls,)."""
    off = np.abs(shares / np.nanmedian(shares) - 1.0)
    usual = NORMAL_MAD * float(np.nanmedian(off))
    return np.asarray(off > max(CONTRADICTS, STANDS_OUT * usual))


def left_out(shares: Float64Array, at_most: float) -> MaskArray:
    """Return True for balls that are left out, `at_most` so many: bool array of shape (number of balls,).

    The first of these choices that leaves out few enough:

    * balls that contradict the others, then the farthest from the median until the spread of the rest is small enough;
    * the same until the spread is as small as chance may make it;
    * balls that contradict the others;
    * none.
    """
    first = contradicts(shares)
    choices = (
        _leave_out_farthest(shares, first, lambda _: MAX_RADIUS_SPREAD),
        _leave_out_farthest(shares, first, _limit_by_chance),
        first,
    )
    return next((mask for mask in choices if mask.sum() <= at_most), np.zeros_like(first))


def _leave_out_farthest(shares: Float64Array, first: MaskArray, limit: Callable[[int], float]) -> MaskArray:
    """Return `first` and the farthest from the median until the spread of the n that are left is at most `limit(n)`."""
    out = first.copy()
    for ball in np.argsort(-np.nan_to_num(np.abs(shares / np.nanmedian(shares) - 1.0))):
        if radius_spread(shares[~out]) <= limit(int(np.isfinite(shares[~out]).sum())):
            break
        out[ball] = True
    return out


def check_radii(shares: Float64Array, owners: Sequence[str]) -> None:
    """Refuse `MIN_COMPARED` balls or more whose radii contradict one another.

    shares : as `radius_shares` returns them
    owners : the press of each ball

    Raises
    ------
    CalibrationError
        Names the presses at both ends and what they read.
    """
    spread = radius_spread(shares)
    balls = int(np.isfinite(shares).sum())
    limit = _limit_by_chance(balls)
    if spread <= limit or balls < MIN_COMPARED:
        return
    small, large = owners[int(np.nanargmin(shares))], owners[int(np.nanargmax(shares))]
    raise CalibrationError(
        f"the balls' radii contradict each other: by their shading they are {np.nanmin(shares):.2f} ({small}) to "
        f"{np.nanmax(shares):.2f} ({large}) of what is stated (spread {spread:.0%}, at most {limit:.0%}), "
        "and too many stand out to be left out: check ball_radius_mm of each press and the reference, or press more "
        "balls"
    )


def _limit_by_chance(balls: int) -> float:
    """Return the spread that one in a hundred sets of so many balls exceeds where the true one is `MAX_RADIUS_SPREAD`.

    The calibration of a set between `MAX_RADIUS_SPREAD` and this does not pass, but is not refused.
    """
    from scipy.special import chdtri  # here, because only calibrating needs it

    degrees = max(balls - 1, 1)
    return MAX_RADIUS_SPREAD * float(np.sqrt(chdtri(degrees, 0.01) / (degrees + 1)))


# The ball radius that shows in presses, where the stated one does not or none is known.

RADII: Final = tuple(0.07 * 1.4**step for step in range(9))
"""Radii that are tried, fractions of the frame's shorter side."""

LOOKED_AT_PX: Final = 320
"""Frames are reduced to about this length of their shorter side."""


@dataclass(frozen=True, slots=True)
class FittingRadius:
    """The ball radius that fits most of the presses that were looked at, and how many of how many.

    radii_px : radii that fit as many presses, ascending; contacts do not distinguish them
    """

    radii_px: tuple[float, ...]
    presses: int
    looked_at: int

    @property
    def radius_px(self) -> float:
        """The middle one of the radii."""
        return float(np.exp(np.mean(np.log(self.radii_px))))

    def sentence(self, pitch_um: float, stated_px: float) -> str:
        """Return the sentence that compares it with the stated radius."""
        ends_px = sorted({self.radii_px[0], self.radii_px[-1]})
        preposition = "from" if len(ends_px) > 1 else "of"
        in_px = " to ".join(f"{end_px:.0f}" for end_px in ends_px)
        in_mm = " to ".join(f"{end_px * pitch_um / 1e3:.2g}" for end_px in ends_px)
        return (
            f"a radius {preposition} {in_px} px ({in_mm} mm at "
            f"{pitch_um:g} µm a pixel) fits the balls that show in {self.presses} of {self.looked_at} presses, and "
            f"{stated_px:.3g} px ({stated_px * pitch_um / 1e3:.3g} mm) is stated"
        )


def fitting_radius(images: Sequence[NormalizedImage]) -> FittingRadius | None:
    """Return the radius of the balls that show in frames, from their contacts; None where none shows.

    Contacts of one size fit balls of several radii: of those that show as often, the middle one is returned.
    """
    if not images:
        return None
    factor = max(1, min(images[0].shape) // LOOKED_AT_PX)
    small = [_reduced(image, factor) for image in images]
    counts = {}
    for fraction in RADII:
        radius_px = fraction * min(small[0].shape)
        counts[radius_px * factor] = sum(_shows(image, radius_px) for image in small)
    most = max(counts.values())
    best = tuple(radius_px for radius_px, count in counts.items() if count == most)
    return FittingRadius(best, most, len(small)) if most else None


def _shows(image: NormalizedImage, radius_px: float) -> bool:
    """Return whether a ball of this radius is found; no radius is too large or small to be tried."""
    try:
        return bool(find_balls(image, radius_px).found)
    except CalibrationError:
        return False


def _reduced(image: NormalizedImage, factor: int) -> NormalizedImage:
    if factor == 1:
        return image
    size = (image.shape[1] // factor, image.shape[0] // factor)
    values = cv2.resize(image.values, size, interpolation=cv2.INTER_AREA)
    valid, clipped = (
        cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(np.bool_)
        for mask in (image.valid, image.clipped)
    )
    return NormalizedImage(np.asarray(values, np.float32), valid, clipped)


# The inverse map of a calibration's presses, and which balls at which centres it is fitted to.

Centres = Literal["found", "labelled", "found at labels", "found at labels and beyond"]
FITTED_SAMPLES: Final = 40_000
WORTH_MORE_BALLS: Final = 1.1
"""Balls that no label has are tried when there are so many times as many with them."""

MORE_BALLS_GAIN: Final = 0.95
"""Their held-out error counts as so much smaller: more balls cover more of the field than the labelled ones do."""

CORE_KEPT: Final = 0.9
"""So many of the balls that train without a cut must train with it: an error that is small because balls are left out
says nothing."""


def fit_to_best_balls(
    presses: Sequence[PressFrame], located: Sequence[UsedPress], light: IlluminationMap | None
) -> tuple[BegunFit, Sequence[UsedPress], Centres]:
    """Return the inverse map, with the balls and the centres that it is fitted to.

    Where a hand labelled balls, those are taken that held-out labelled ones prefer, by fits of a single curve. Balls
    that no label has count where they make the labelled ones' held-out error smaller. Labelled contacts are cut to
    their core where that makes the core's own held-out error smaller, and not by leaving balls aside.

    light : of untouched skin, None where no reference shows it
    """
    by_hand = [press.labelled_by_hand for press in presses]
    if not any(by_hand):
        return fit_to(located, light), located, "found"
    balls, centres = _choose_centres(located, by_hand)
    best = fit_to(balls, light)
    if centres != "found at labels and beyond":
        cut = [cut_to_core(used) if hand else used for used, hand in zip(balls, by_hand, strict=True)]
        core = fit_to_cores(cut, best, light)
        return (*core, centres) if core else (best, balls, centres)
    return best, balls, centres


def _choose_centres(located: Sequence[UsedPress], by_hand: Sequence[bool]) -> tuple[Sequence[UsedPress], Centres]:
    """Return the balls that held-out labelled ones prefer, and where their centres come from."""
    chosen: tuple[Sequence[UsedPress], Centres] = (located, "labelled")
    smallest_deg = _label_error_deg(located, located)
    choices: tuple[tuple[Centres, Callable[[UsedPress], UsedPress]], ...] = (
        ("found at labels", relocate_labels),
        ("found at labels and beyond", add_detections),
    )
    for name, move in choices:
        moved = [move(used) if hand else used for used, hand in zip(located, by_hand, strict=True)]
        more = name == "found at labels and beyond"
        if more and _count(moved) < WORTH_MORE_BALLS * _count(located):
            continue
        error_deg = _label_error_deg(moved, located)
        if (MORE_BALLS_GAIN if more else 1.0) * error_deg < smallest_deg:
            chosen, smallest_deg = (moved, name), error_deg
    return chosen


def fit_to_cores(
    cut: Sequence[UsedPress], whole: BegunFit, light: IlluminationMap | None
) -> tuple[BegunFit, Sequence[UsedPress]] | None:
    """Return the inverse map of presses whose contacts were cut to their core.

    None where held-out balls prefer the whole. The error of the core alone decides, and not one that is smaller because
    balls were left aside.
    """
    begun = fit_to(cut, light)
    core_deg, kept = begun.fit.held_out_deg, begun.fit.kept.sum()
    if core_deg is None or whole.fit.core_deg is None or kept < CORE_KEPT * whole.fit.kept.sum():
        return None
    return (begun, cut) if core_deg < whole.fit.core_deg else None


def _count(presses: Sequence[UsedPress]) -> int:
    return sum(len(press.balls) for press in presses)


def _label_error_deg(fitted: Sequence[UsedPress], located: Sequence[UsedPress]) -> float:
    """Return the median held-out error of the balls that `located` holds too: the first of each press in `fitted`.

    It is that of a single curve of intensity; infinite where the balls do not suffice for one.
    """
    try:
        fit = fit_to(fitted, None, thorough=False).fit
    except CalibrationError:
        return np.inf
    common = [i < len(own.balls) for press, own in zip(fitted, located, strict=True) for i in range(len(press.balls))]
    return float(np.median(fit.ball_error_deg[np.array(common)]))


def fit_to(
    presses: Sequence[UsedPress], light: IlluminationMap | None, like: BegunFit | None = None, *, thorough: bool = True
) -> BegunFit:
    """Return the inverse map of the presses' balls, begun.

    light : of untouched skin, None where no reference shows it
    like : an earlier fit, whose choices are kept
    thorough : as for `begin_fit`
    """
    samples = gather_samples([(press.intensity, press.balls) for press in presses], for_fit=True)
    balls = [ball for press in presses for ball in press.balls]
    alone = np.array([len(press.balls) == 1 for press in presses for _ in press.balls])
    shape = presses[0].intensity.shape
    return begin_fit(
        samples, balls, shape, max_samples=FITTED_SAMPLES, light=light, thorough=thorough, like=like, alone=alone
    )
