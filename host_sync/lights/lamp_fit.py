"""Lamps and coat of an instrument, fitted to the balls of its calibration.

A dozen balls show thousands of slopes at a dozen places: enough for the two dozen numbers of a `LampModel` and, beside
them, for the places of the balls' centres. The numbers are found by least squares, first for a coat that does not
shine, then from there for coats that shine broadly and sharply. A model that leaves much more than noise, or no less
than polynomials do that know nothing of lamps, says nothing: light that is guided, mirrored or shaped is no lamp's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.balls.viewpoint import Viewpoint
from device.surface.fields import Float64Array
from host_sync.lights.lamp_model import FittedLamps, LampModel

MAX_RESIDUAL: Final = 0.025
"""Root mean square intensity, at most, that a model may leave of the balls.

Near lamps over a diffuse or glossy coat leave 0.004 to 0.013, the twin's flakes 0.010 and 0.023; models of sensors that
guide their light 0.015 to 0.07, real ones 0.021 and 0.06.
"""

MAX_SHARE: Final = 0.4
"""The same as a share of what polynomials that know nothing of lamps leave (`host_sync.calibration.shading_model`):
0.1 to 0.25 under near lamps, 3 to 13 where light is guided, 0.45 and 0.56 on two real sensors."""

FALL_OFF: Final = (1.0, 3.0)
"""Powers of the distance with which light of lamps falls off."""

SAMPLES: Final = 3000
STARTS: Final = ((0.35, 0.45), (0.5, 0.2))
"""The lamps' height over the skin and their length, in widths of the field, from which searches begin. From the second
alone lamps come out far too long on two of twelve benches, with a residual of 0.020 instead of 0.008 and of 0.0100
instead of 0.0050.
"""

GENTLE: Final = 0.35
"""Slopes up to which samples tell where the lamps stand, to begin with."""

NOISE: Final = 0.03
"""Intensity that the first searches expect to be left of the balls."""

MIN_NOISE: Final = 0.003
"""The last search expects what the first one left, but no less than this: so what is expected of lamps and coat
beforehand counts as little as it should beside quiet balls. It alone is asked where beams point."""

MAX_WORSE: Final = 1.1
"""What the last search may leave, over what the first one did."""

OUTLYING: Final = 4.0
"""Intensities off by so many times the noise expected count no more than these."""

MISSED: Final = 30.0
"""By how much intensity is off that a model cannot predict at all."""

CENTRE_SIGMA: Final = 0.015
"""Standard deviation of a centre's error, as a share of the ball's radius, that is expected beforehand."""

PRIOR_SAMPLES: Final = 300.0
"""What is expected of a coat beforehand counts as one in so many samples."""

GLOSS_WIDTHS: Final = (0.35, 0.15)
GLOSS: Final = 0.15
"""Where the search for coats that shine begins."""

GLOSS_GAIN: Final = 0.97
"""Share of the residual that a coat which shines must reach."""

STEP: Final = 1e-4
CENTRE_STEP_PX: Final = 0.05
"""Steps of the numerical derivatives."""

ROUNDS: Final = 25
TOLERANCE: Final = 1e-4
"""The search ends when a round makes the sum of squares smaller by less than this share, or after so many rounds."""

FOLDS: Final = 6
"""Parts of the balls without which the lamps are found again, from where all balls put them."""

_PLAIN_COAT: Final = (0.3, 0.0, np.log(0.35), 0.0, 0.1, 0.1, 0.2, np.log(2.0), 0.0, 0.0)
_START: Final = np.array([0.2, 2.0, *[0.05] * 6, *[0.01] * 3, *_PLAIN_COAT])
_EXPECTED: Final = np.array([0.2, 2.0, *[0.0] * 6, *[0.0] * 3, *_PLAIN_COAT])
_DOUBT: Final = np.array([0.5, 1.0, *[0.1] * 6, *[0.05] * 3, 0.5, 0.3, 0.5, 0.15, 0.5, 0.5, 0.5, 1.0, np.inf, 0.12])
"""Strip, fall-off, mixing and haze; roughness, gloss, logarithm of its width, gain with tilt, bounce from close by and
from afar, beam, logarithm of tail, camera, logarithm of aim. The camera is not searched for: where it stands is known,
or all else takes it to be far away. A rough coat is brightest along the view, with a crease there: a camera that is a
hundredth off tells all gentle slopes wrong by a thousandth, and takes up what other numbers miss."""

_PLACES: Final = 9
_GLOSS: Final = _PLACES + 12
_TAIL: Final = _PLACES + 18
_CAMERA: Final = _PLACES + 19
_AIM: Final = _PLACES + 20
_OF_GLOSS: Final = (_GLOSS, _GLOSS + 1, _TAIL)
_BOUNCE: Final = (_GLOSS + 3, _GLOSS + 4)
"""Numbers before them: right and down by channel, then logarithms of heights; where those of gloss and its tail are,
those of camera and aim, and those of bounce."""
_EVEN: Final = (_PLACES, _GLOSS - 1)
"""Strip and roughness: the model is the same with either sign, and so is what is expected of them."""


@dataclass(frozen=True, slots=True, eq=False)
class LampFit:
    """Lamps as balls show them.

    lamps : as all balls and all but a fold of them show them; without folds where lamps explain nothing
    shift_px : float64 array of shape (balls, 2), what is to be added to each centre's column and row
    residual : root mean square intensity that is left of the balls, outliers bounded
    """

    lamps: FittedLamps
    shift_px: Float64Array
    residual: float

    def explains(self, residual: float) -> bool:
        """Whether the lamps explain what balls show.

        residual : root mean square intensity that polynomials leave
        """
        return self.residual < min(MAX_RESIDUAL, MAX_SHARE * residual) and _falls_off(self.lamps.model)


def _falls_off(model: LampModel) -> bool:
    """Whether light falls off as that of lamps does."""
    least, most = FALL_OFF
    return least < model.fall_off < most


def fit_lamps(
    samples: BallSamples,
    close: Float64Array,
    balls: Sequence[Ball],
    apexes_px: Sequence[float],
    shape: tuple[int, int],
) -> LampFit:
    """The lamps that balls of a full-size field of `shape` (H, W) show.

    samples : of the balls
    close : what skin close to each sample shows, shape (N, 3)
    apexes_px : elevation of each ball's apex over untouched skin, pixels
    """
    search = _Search.of(samples, close, balls, apexes_px, shape)
    best = first = min((search.matt(*start) for start in STARTS), key=lambda found: found.residual)
    for width in GLOSS_WIDTHS:
        begin = first.numbers.copy()
        begin[_GLOSS : _GLOSS + 2] = GLOSS, np.log(width)
        found = search.solved(begin, first.shift_px, fixed=(_AIM, _CAMERA))
        if found.residual < GLOSS_GAIN * best.residual:
            best = found
    best = search.without_darkening(best)
    folds: list[_Solution] = []
    if best.residual < MAX_RESIDUAL:
        closer = replace(search, noise=max(best.residual, MIN_NOISE))
        fixed = tuple(number for number in best.fixed if number != _AIM)
        again = closer.without_darkening(closer.solved(best.numbers, best.shift_px, fixed=fixed))
        if again.residual < MAX_WORSE * best.residual and _falls_off(closer.model(again.numbers)):
            best, search = again, closer
        folds = [search.without(fold).solved(best.numbers, best.shift_px, fixed=best.fixed) for fold in range(FOLDS)]
    lamps = FittedLamps(search.model(best.numbers), tuple(search.model(one.numbers) for one in folds))
    return LampFit(lamps, best.shift_px, best.residual)


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """Where a search ended.

    numbers, free : of the model, and which of them were free to change
    shift_px : of the balls' centres, shape (balls, 2)
    residual : as of `LampFit`
    """

    numbers: Float64Array
    free: np.ndarray
    shift_px: Float64Array
    residual: float

    @property
    def fixed(self) -> tuple[int, ...]:
        """Which of the numbers were not free."""
        return tuple(sorted(set(range(len(self.numbers))) - set(self.free.tolist())))


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Samples whose intensity a model is to predict.

    intensity : float64 array of shape (N, 3)
    close : what skin close to them shows, float64 array of shape (N, 3)
    column, row : float64 arrays of shape (N,), pixels
    ball : int array of shape (N,)
    centre, radius_px, apex_px : of their balls, float64 arrays of shape (N, 2), (N,) and (N,)
    count : of balls
    shape : (H, W)
    viewpoint : of the camera; None where nobody knows it
    noise : standard deviation of what is expected to be left of intensity
    """

    intensity: Float64Array
    close: Float64Array
    column: Float64Array
    row: Float64Array
    ball: np.ndarray
    centre: Float64Array
    radius_px: Float64Array
    apex_px: Float64Array
    count: int
    shape: tuple[int, int]
    viewpoint: Viewpoint | None
    noise: float = NOISE

    @classmethod
    def of(
        cls,
        samples: BallSamples,
        close: Float64Array,
        balls: Sequence[Ball],
        apexes_px: Sequence[float],
        shape: tuple[int, int],
    ) -> _Search:
        rows = np.random.default_rng(0).permutation(len(samples.p))[:SAMPLES]
        ball = samples.ball[rows]
        centre = np.array([[one.column, one.row] for one in balls])[ball]
        radius_px = np.array([one.radius_px for one in balls])[ball]
        column, row = samples.column[rows].astype(np.float64), samples.row[rows].astype(np.float64)
        seen = samples.taught[rows].astype(np.float64)
        apex_px = np.array(apexes_px)[ball]
        viewpoint = balls[0].viewpoint
        return cls(seen, close[rows], column, row, ball, centre, radius_px, apex_px, len(balls), shape, viewpoint)

    def without(self, fold: int) -> _Search:
        """The search without the samples of every ball of this fold."""
        kept = self.ball % FOLDS != fold
        named = ("intensity", "close", "column", "row", "ball", "centre", "radius_px", "apex_px")
        return replace(self, **{name: getattr(self, name)[kept] for name in named})

    def model(self, numbers: Float64Array) -> LampModel:
        """The model of these numbers."""
        strip, fall_off, *mixed = numbers[_PLACES:].tolist()
        mixing = np.eye(3)
        mixing[~np.eye(3, dtype=np.bool_)] = mixed[:6]
        haze = np.array(mixed[6:9])
        roughness, gloss, width, tilt_gain, close, afar, beam, tail, camera, aim = mixed[9:]
        position = np.concatenate([numbers[:6].reshape(3, 2), np.exp(numbers[6:9, None])], axis=1)
        return LampModel(
            self.shape,
            position,
            strip,
            fall_off,
            mixing,
            haze,
            roughness,
            gloss,
            gloss_width=float(np.exp(width)),
            tilt_gain=tilt_gain,
            bounce_close=close,
            bounce_afar=afar,
            beam=beam,
            tail=float(np.exp(tail)),
            camera=camera,
            aim=float(np.exp(aim)),
        )

    def matt(self, height: float, strip: float) -> _Solution:
        """The best fit of a coat that does not shine near lamps of this height and length."""
        begin = np.concatenate([self.first_places(height), _START])
        begin[_PLACES] = strip
        if self.viewpoint is not None:
            begin[_CAMERA] = self.shape[1] / self.viewpoint.height_px
        return self.solved(begin, np.zeros((self.count, 2)), fixed=(*_OF_GLOSS, _AIM, _CAMERA))

    def first_places(self, height: float) -> Float64Array:
        """Where the lamps stand by the slants of gentle skin if they stand so high: (9,)."""
        p, q, _ = self._sphere(np.zeros((self.count, 2)))
        gentle = np.hypot(p, q) < GENTLE
        p, q = p[gentle], q[gentle]
        x, y = (
            (place[gentle] - 0.5 * (size - 1)) / self.shape[1]
            for place, size in ((self.column, self.shape[1]), (self.row, self.shape[0]))
        )
        terms = np.stack([p, q, x * p, y * p, x * q, y * q], axis=-1)
        lit = self.intensity[gentle] * np.sqrt(1.0 + p * p + q * q)[:, None] - 1.0
        slants = np.linalg.lstsq(terms, lit, rcond=None)[0][:2]
        return np.concatenate([-height * slants.T.ravel(), np.full(3, np.log(height))])

    def without_darkening(self, found: _Solution) -> _Solution:
        """The best fit near another one in which no skin takes light from skin beside it."""
        while any(found.numbers[number] < 0.0 for number in _BOUNCE):
            begin, fixed = found.numbers.copy(), set(found.fixed)
            for number in _BOUNCE:
                if begin[number] < 0.0:
                    begin[number] = 0.0
                    fixed.add(number)
            found = self.solved(begin, found.shift_px, fixed=tuple(fixed))
        return found

    def solved(self, begin: Float64Array, shift_px: Float64Array, *, fixed: tuple[int, ...] = ()) -> _Solution:
        """The best fit near these numbers and shifts of centres (balls, 2); some of the numbers are fixed."""
        from scipy.optimize import least_squares  # here, because it takes as long to load as a reconstruction

        free = np.delete(np.arange(len(begin)), fixed)
        expected, doubt = np.append(np.zeros(_PLACES), _EXPECTED), np.append(np.full(_PLACES, np.inf), _DOUBT)
        even = np.isin(np.arange(len(begin)), _EVEN)
        weight = np.sqrt(len(self.ball) / PRIOR_SAMPLES)
        sigma_px = CENTRE_SIGMA * float(np.median(self.radius_px))

        def parted(variables: Float64Array) -> tuple[Float64Array, Float64Array]:
            numbers = begin.copy()
            numbers[free] = variables[: len(free)]
            return numbers, variables[len(free) :].reshape(-1, 2)

        def off(variables: Float64Array) -> Float64Array:
            numbers, shift = parted(variables)
            left = np.nan_to_num(self._left(numbers, shift), nan=MISSED, posinf=MISSED, neginf=-MISSED) / self.noise
            bounded = left / np.sqrt(1.0 + (left / OUTLYING) ** 2)
            beforehand = weight * ((np.where(even, np.abs(numbers), numbers) - expected) / doubt)[free]
            return np.concatenate([bounded.ravel(), beforehand, (shift / sigma_px).ravel()])

        def derivatives(variables: Float64Array) -> Float64Array:
            here = off(variables)
            found = np.zeros((len(here), len(variables)))
            for number in range(len(free)):
                there = variables.copy()
                there[number] += STEP
                found[:, number] = (off(there) - here) / STEP
            owner = np.concatenate([np.repeat(self.ball, 3), np.full(len(free), -1), np.repeat(range(self.count), 2)])
            for axis in (0, 1):  # of all balls at once: each has samples of its own
                there = variables.copy()
                there[len(free) + axis :: 2] += CENTRE_STEP_PX
                change = (off(there) - here) / CENTRE_STEP_PX
                for ball in range(self.count):
                    at = len(free) + 2 * ball + axis
                    found[owner == ball, at] = change[owner == ball]
            return found

        start = np.concatenate([begin[free], shift_px.ravel()])
        found = least_squares(off, start, derivatives, ftol=TOLERANCE, max_nfev=ROUNDS, x_scale="jac")
        numbers, shift = parted(found.x)
        left = np.nan_to_num(self._left(numbers, shift), nan=MISSED, posinf=MISSED, neginf=-MISSED)
        residual = float(np.sqrt((left**2 / (1.0 + (left / (OUTLYING * NOISE)) ** 2)).mean()))
        return _Solution(numbers, free, shift, residual)

    def _left(self, numbers: Float64Array, shift_px: Float64Array) -> Float64Array:
        """Intensity predicted less that seen, (N, 3)."""
        p, q, z_px = self._sphere(shift_px)
        with np.errstate(all="ignore"):
            shown = self.model(numbers).shown(p, q, self.column, self.row, z_px, self.close)
        return np.asarray(shown - self.intensity)

    def _sphere(self, shift_px: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Slopes and elevations of the samples' balls, shape (N,) each."""
        pixel, centre = np.stack([self.column, self.row]), (self.centre + shift_px[self.ball]).T
        across, down = pixel - centre
        if self.viewpoint is not None:
            across, down = self.viewpoint.offsets_from_axis(pixel, centre, self.radius_px, self.apex_px)
        rise = np.sqrt(np.maximum(self.radius_px**2 - across**2 - down**2, 1.0))
        return -across / rise, -down / rise, self.apex_px - self.radius_px + rise
