"""Check of the balls' stated radii: shading shows their sizes relative to one another.

A map from intensity to slope trained on many balls reads every ball. A ball that is smaller than stated is steeper at
each place than its stated radius makes it: the map reads its slopes by that share too steep. The common size of all
balls cannot be checked so: were all radii wrong by one share, the map would have learned slopes wrong by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples, gather_samples
from device.calibration.fit import BegunFit
from device.calibration.limits import MAX_RADIUS_SPREAD
from device.errors import CalibrationError
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.model import InverseMap
from device.surface.fields import Float64Array, MaskArray
from host_sync.calibration.ball_choice import fit_to, fit_to_cores
from host_sync.calibration.balls import UsedPress, apply_fit, cut_to_core, without_balls

MAX_SAMPLES = 20_000
CONTRADICTS: Final = 0.16
STANDS_OUT: Final = 3.0
"""A ball whose radius is this far from the median, as a fraction and in deviations, contradicts the others ..."""

MAX_LEFT_OUT: Final = 0.3
"""... unless more than this fraction of the balls do."""

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
    """Return relative spread of radii: one or two lights show all slopes too flat, which is no disagreement among
    balls."""
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
    """True for balls whose radius stands out of the others: bool array of shape (number of balls,)."""
    off = np.abs(shares / np.nanmedian(shares) - 1.0)
    usual = NORMAL_MAD * float(np.nanmedian(off))
    return np.asarray(off > max(CONTRADICTS, STANDS_OUT * usual))


def left_out(shares: Float64Array, at_most: float) -> MaskArray:
    """True for balls that are left out, `at_most` so many: bool array of shape (number of balls,).

    These are the ones that contradict the others, and after them the farthest from the median until the spread of the
    rest is small enough. Where that takes too many, the first ones alone; where they are too many, none.
    """
    first = contradicts(shares)
    out = first.copy()
    for ball in np.argsort(-np.nan_to_num(np.abs(shares / np.nanmedian(shares) - 1.0))):
        if radius_spread(shares[~out]) <= MAX_RADIUS_SPREAD:
            break
        out[ball] = True
    return next((mask for mask in (out, first) if mask.sum() <= at_most), np.zeros_like(out))


def check_radii(shares: Float64Array, owners: Sequence[str]) -> None:
    """Refuse balls whose radii contradict one another.

    shares : as `radius_shares` returns them
    owners : the press of each ball

    Raises
    ------
    CalibrationError
        Names the presses at both ends and what they read.
    """
    spread = radius_spread(shares)
    if spread <= MAX_RADIUS_SPREAD:
        return
    small, large = owners[int(np.nanargmin(shares))], owners[int(np.nanargmax(shares))]
    raise CalibrationError(
        f"the balls' radii contradict each other: by their shading they are {np.nanmin(shares):.2f} ({small}) to "
        f"{np.nanmax(shares):.2f} ({large}) of what is stated (spread {spread:.0%}, at most {MAX_RADIUS_SPREAD:.0%}), "
        "and too many stand out to be left out: check ball_radius_mm of each press"
    )
