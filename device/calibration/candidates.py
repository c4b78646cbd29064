"""A curve of the inverse map while it is being learned: its form, its penalty, and what it reads."""

from __future__ import annotations

from collections.abc import Iterable, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.calibration.cross_validation import FoldedRidge, GroupedRidgeCV, balanced_errors, gains_of_balls
from device.calibration.product_features import ProductFeatures
from device.inverse_map.branches import Reading, RootIntensity, flat_at_rest, seen_at_rest
from device.inverse_map.gentle_skin import GentleSkin
from device.inverse_map.near_light import IlluminationMap, NearLightModel
from device.inverse_map.regressor import (
    FeatureRegressor,
    FeatureScaler,
    RandomFourierFeatures,
    colour_exponents,
    field_position,
    position_exponents,
)
from device.inverse_map.training_domain import Leverage
from device.surface import (
    NOISE_KEPT,
    Float32Array,
    Float64Array,
    MaskArray,
    slope_from_stereographic,
    stereographic_from_slope,
)

PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-8.0, 1.0, 0.5))
PENALTY_STRIDE: Final = 3
PENALTY_TIE: Final = 1.0025
"""Errors that near to the least are alike: of their penalties the smallest is taken, which flattens least."""


@dataclass(frozen=True, slots=True)
class RegressorForm:
    """Terms of a curve and their penalties.

    colour_degree, position_degree : its degrees
    place_penalty : how many times as dear a term is for every power of position
    waves : its waves of colour, none of them for a polynomial
    anchored : whether gentle slopes anywhere are learned too: as they are by a curve of near lights' slopes, as
        `GentleSkin` predicts them by a curve of light
    """

    colour_degree: int
    position_degree: int
    place_penalty: float = 1.0
    waves: RandomFourierFeatures = field(default_factory=RandomFourierFeatures.none)
    anchored: bool = False

    def term_scale(self) -> Float64Array:
        """Return what features are multiplied by so that one penalty serves all: float64 array of shape (M K,)."""
        powers = np.array([i + j for i, j in position_exponents(self.position_degree)])
        scale = self.place_penalty ** (-0.5 * powers)
        return np.tile(scale, len(colour_exponents(self.colour_degree)) + self.waves.count)


PLAIN_FORMS: Final = tuple(RegressorForm(4, degree) for degree in (0, 1, 2))
NEAR_FORMS: Final = (RegressorForm(4, 2), RegressorForm(5, 2), RegressorForm(5, 2, 10.0))
"""Forms of a curve that reads the slopes of a matt skin: what is left to do there bends more, and less over place."""

ANCHORED_FORMS: Final = tuple(replace(form, anchored=True) for form in NEAR_FORMS if form.colour_degree > 4)
"""Those that have bends enough to be anchored at gentle slopes and still follow steep ones."""

LIGHT_FORMS: Final = (*PLAIN_FORMS, RegressorForm(5, 2), RegressorForm(5, 2, 10.0))
"""Forms of a curve that reads light, where there are balls enough for many terms."""

ROOT_FORM: Final = RegressorForm(5, 2, 10.0)
"""Form of a curve that reads the root of intensity: more bends over colour, fewer over place."""

ANCHORS: Final = 4000
ANCHOR_SLOPE: Final = 0.1
ANCHOR_WEIGHT: Final = 100.0
"""Gentle slopes up to the second, as many as the first, weigh so many times as much as all samples in a curve that is
anchored: near lights show them exactly, while a polynomial that rounds the corner where a light sets flattens them."""

ANCHOR_COST: Final = 0.93
"""Share of an anchored curve's held-out error below which one without anchors is taken: balls show little that is
gentle, so that most of what anchors cost is seen and little of what they gain."""

ANCHOR_GAIN: Final = 0.8
"""Share of an anchored curve's gain error below which one without anchors is taken too: where the directions of the
lights are off, anchors hold gentle slopes at a wrong gain, and all that lies between balls with them."""

ANCHOR_WORTH: Final = 0.8
"""Share of its held-out error that a curve of light must reach by anchors to have them.

It is 0.74 and 0.77 on rendered sensors with strongly coloured light, whose heights come from 3.5 to 2.8 and from 5.9 to
2.9 µm, 0.84 to 1.3 on the other rendered ones.
"""

GENTLE_SLOPE: Final = 0.27
"""Slopes up to 15 degrees, from which the error of the gain is estimated."""

WAVY_GAIN: Final = 0.95
"""Share of the plain forms' held-out error that the wavy form must reach: it costs several times as much."""

MIN_FOR_MANY_TERMS: Final = 8
"""Balls from which a curve may have waves or read near lights' slopes: so much is chance on few balls."""


def fourier_form() -> RegressorForm:
    """Return the form for a skin with metal flakes, which bends more over colour than over place."""
    return RegressorForm(2, 2, 10.0, RandomFourierFeatures.sample())


@dataclass(frozen=True, slots=True, eq=False)
class RegressorFit:
    """A curve that is to be learned.

    colours : the variables that it is a polynomial in
    form : its terms
    reading : what makes its colours of intensity and place, None where it reads intensity itself
    penalty : of the ridge
    ridge : its features, less those of untouched skin where it is `flat`, at the pixels of balls
    flat : whether it reads untouched skin as flat by construction; else it may miss it
    skin : predicts the gentle slopes that it is anchored at; None of one that is not, or takes them as they are
    error_as_seen : held-out error at its penalty on pixels as they are seen, with their noise, in slope; NaN where it
        was not judged
    """

    colours: FeatureScaler
    form: RegressorForm
    reading: Reading | None
    penalty: float
    ridge: GroupedRidgeCV
    flat: bool = True
    skin: GentleSkin | None = None
    error_as_seen: float = np.nan

    def leverage(self, slope: Float64Array, weight: Float64Array, alive: MaskArray) -> Leverage:
        """Return the leverage of features among those of the living balls, 0 for untouched skin.

        The learner must not read light; arguments are the ridge's.
        """
        root = self.ridge.leverage_root(self.penalty, slope, weight, alive)
        seen = self.ridge.seen or self.ridge.features  # a scan's pixels are noisy, and so are those it is held against
        found = Leverage.of(root, seen.powers(np.flatnonzero(alive[self.ridge.ball]), root))
        scaled = found.root * self.form.term_scale()[:, None]
        if self.flat:
            scaled = flat_at_rest(self._bare, scaled, self.reading)
        return replace(found, root=scaled.astype(np.float32))

    def of_samples(self, samples: BallSamples, slope: Float64Array, shape: tuple[int, int]) -> RegressorFit:
        """Return the learner with its form and penalty fitted to other samples of the same balls."""
        reading, skin = _of_samples(self, samples, slope, shape)
        return fit_regressor(samples, shape, self.form, self.penalty, reading, flat=self.flat, skin=skin)

    def curve(self, solution: Float64Array) -> FeatureRegressor:
        """Return the curve with the coefficients that `ridge` found, array of shape (F, 2)."""
        unscaled = solution * self.form.term_scale()[:, None]
        if self.flat and not isinstance(self.reading, IlluminationMap):
            unscaled = flat_at_rest(self._bare, unscaled, self.reading)
        return replace(self._bare, coefficients=unscaled.reshape(self._bare.coefficients.shape).astype(np.float32))

    @property
    def _bare(self) -> FeatureRegressor:
        """A curve of its form that reads 0 everywhere."""
        form = self.form
        terms = len(colour_exponents(form.colour_degree)) + form.waves.count
        nothing = np.zeros((terms, len(position_exponents(form.position_degree)), 2), np.float32)
        return FeatureRegressor(self.colours, form.colour_degree, form.position_degree, nothing, form.waves)


def fit_regressor(
    samples: BallSamples,
    shape: tuple[int, int],
    form: RegressorForm,
    penalty: float,
    reading: Reading | None = None,
    *,
    flat: bool = True,
    kept: MutableMapping[bytes, Float64Array] | None = None,
    skin: GentleSkin | None = None,
) -> RegressorFit:
    """Return the learner of this form and penalty, for a full-size field of `shape` (H, W).

    kept : as of `ProductFeatures`
    skin : predicts the gentle slopes that it is anchored at, where it does not read near lights' slopes and is flat
    """
    place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
    seen = _seen(samples.intensity, place, reading)
    colours = FeatureScaler.observed(seen, linear=reading is not None)

    def features(colour: Float32Array, where: Float64Array) -> ProductFeatures:
        everywhere = where if isinstance(reading, IlluminationMap) else where[:1]
        rest = colours.variables(seen_at_rest(everywhere, reading))[0].astype(np.float64) if flat else None
        variables = colours.variables(colour)[0].astype(np.float64)
        degrees = form.colour_degree, form.position_degree
        return ProductFeatures(variables, where, *degrees, form.waves, form.term_scale(), rest, kept)

    near = isinstance(reading, NearLightModel)
    anchor, share = None, ANCHOR_WEIGHT * len(place) / ANCHORS
    if flat and form.anchored and near:
        gentle = features(*_gentle_slopes_as_seen())
        known, moment = gentle.normal_equations(np.arange(ANCHORS), np.ones(ANCHORS), np.zeros((ANCHORS, 2)))
        anchor = share * known, moment
    elif skin is not None:
        slope, where, noise = _gentle_skin()
        shown, noisy = skin.shown(slope, where), (noise * skin.noise).astype(np.float32)
        # Noise of both signs: curves bend, so that noisy pixels read otherwise in the mean.
        above, below = (features(_seen(shown + sign * noisy, where, reading), where).table() for sign in (1, -1))
        read = 0.5 * (above + below)
        anchor = share * read.T @ read, share * read.T @ stereographic_from_slope(*slope.T)
    prior = _matt_prior(colours, form) if near else None
    training, *others = (features(_seen(intensity, place, reading), place) for intensity in _noise_levels(samples))
    ridge = GroupedRidgeCV(training, samples.ball, prior, anchor, *others)
    return RegressorFit(colours, form, reading, penalty, ridge, flat, skin)


def _noise_levels(samples: BallSamples) -> list[Float32Array]:
    """Return intensities (N, 3) with no noise, all of it, and what a surface keeps; one without `quiet`."""
    if samples.quiet is None:
        return [samples.intensity]
    kept = samples.quiet + np.float32(NOISE_KEPT) * (samples.intensity - samples.quiet)
    return [samples.quiet, samples.intensity, kept]


def _gentle_skin() -> tuple[Float64Array, Float64Array, Float64Array]:
    """Gentle slopes and position variables (`ANCHORS`, 2) all over the field, and noise (`ANCHORS`, 3), deviation 1."""
    rng = np.random.default_rng(0)
    slope, place = rng.uniform(-ANCHOR_SLOPE, ANCHOR_SLOPE, (ANCHORS, 2)), rng.uniform(-1.0, 1.0, (ANCHORS, 2))
    return slope, place, rng.standard_normal((ANCHORS, 3))


def _gentle_slopes_as_seen() -> tuple[Float32Array, Float64Array]:
    """Return gentle slopes with their brightness (N, 3), as a near field reads them, and places (N, 2)."""
    slope, place, _ = _gentle_skin()
    brightness = 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1, keepdims=True))
    return np.concatenate([slope, brightness], axis=1).astype(np.float32), place


def _matt_prior(colours: FeatureScaler, form: RegressorForm) -> Float64Array:
    """Return coefficients (F, 2) of a curve that takes the slopes of a matt skin as they are, its first two colours.

    A penalty that draws towards them leaves gentle slopes their gain; one that draws to 0 reads them too flat.
    """
    places = len(position_exponents(form.position_degree))
    exponents = colour_exponents(form.colour_degree)
    prior = np.zeros((len(exponents) + form.waves.count, places, 2))
    for axis, linear in enumerate(((1, 0, 0), (0, 1, 0))):
        prior[exponents.index(linear), 0, axis] = colours.scale[axis]
        prior[exponents.index((0, 0, 0)), 0, axis] = colours.centre[axis]
    return prior.reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Samples of balls whose true slopes are known, by which learners are chosen.

    slope : float64 array of shape (N, 2), true slopes of the samples
    count : of balls
    shape : (H, W) of the full-size field
    flat : as `RegressorFit` has it
    kept : as of `ProductFeatures`
    skin : predicts gentle slopes; None where that is not known
    """

    samples: BallSamples
    slope: Float64Array
    count: int
    shape: tuple[int, int]
    flat: bool = True
    kept: MutableMapping[bytes, Float64Array] = field(default_factory=dict)
    skin: GentleSkin | None = None

    def under(self, light: IlluminationMap) -> Lesson:
        """Return the lesson with gentle slopes that are predicted under `light` of untouched skin."""
        return replace(self, skin=GentleSkin.best(self.samples, self.slope, self.shape, light))

    def select_best(self, light: IlluminationMap | None = None) -> tuple[RegressorFit, float]:
        """Return the learner with the form and the penalty of least held-out error, and that error, in slope.

        Balls' centres do not count in the error.

        light : for a curve that reads light
        """
        many = self.count >= MIN_FOR_MANY_TERMS
        forms = LIGHT_FORMS if light is not None and many else PLAIN_FORMS
        best = self._best_trial(forms, light)
        if many:
            wavy = self._trial(fourier_form(), light)
            best = wavy if wavy.error < WAVY_GAIN * best.error else best
        return best.at_best_penalty() if light is None else self._anchored_where_worth(best)

    def fit_near_light(self) -> tuple[RegressorFit, float]:
        """Return the best learner that reads the slopes of a matt skin under near lights, and its held-out error."""
        near = NearLightModel.of(self.samples, self.slope, self.shape)
        anchored, free = (self._best_trial(forms, near).at_best_penalty() for forms in (ANCHORED_FORMS, NEAR_FORMS))
        if free[1] < ANCHOR_COST * anchored[1]:
            return free
        return free if self._gain_error(free[0]) < ANCHOR_GAIN * self._gain_error(anchored[0]) else anchored

    def root_learner(self) -> tuple[RegressorFit, float]:
        """Return the learner that reads the root of intensity, and its held-out error."""
        return self._trial(ROOT_FORM, RootIntensity()).at_best_penalty()

    def relearned(self, learner: RegressorFit) -> tuple[RegressorFit, float]:
        """Return the learner of the same form that reads the same, at its best penalty here, and its held-out error."""
        reading, skin = _of_samples(learner, self.samples, self.slope, self.shape)
        return replace(self, skin=skin)._trial(learner.form, reading).at_best_penalty()

    def _anchored_where_worth(self, trial: _Trial) -> tuple[RegressorFit, float]:
        """Return a trial's best learner and its held-out error; an anchored one must be clearly better."""
        free = trial.at_best_penalty()
        if self.skin is None or not self.flat:
            return free
        anchored = self._trial(replace(free[0].form, anchored=True), free[0].reading)
        return anchored.at_best_penalty() if anchored.error < ANCHOR_WORTH * free[1] else free

    def _gain_error(self, learner: RegressorFit) -> float:
        """Return the root mean square over held-out balls of the error of the gain of their gentle slopes."""
        folds = learner.ridge.folds(self.slope, np.ones(len(self.slope)), np.ones(self.count, bool))
        read = slope_from_stereographic(folds.held_out([learner.penalty], judged=True)[0])
        gentle = np.linalg.norm(self.slope, axis=1) < GENTLE_SLOPE
        gains = gains_of_balls(read[gentle], self.slope[gentle], self.samples.ball[gentle])
        return float(np.sqrt(((gains - 1.0) ** 2).mean())) if gains.size else 0.0

    def _best_trial(self, forms: Iterable[RegressorForm], reading: Reading | None) -> _Trial:
        """Return the form of least held-out error, one at a time: their features take a hundred megabytes."""
        return min((self._trial(form, reading) for form in forms), key=lambda trial: trial.error)

    def _trial(self, form: RegressorForm, reading: Reading | None) -> _Trial:
        """Return a form with every third penalty tried."""
        skin = self.skin if form.anchored and not isinstance(reading, NearLightModel) else None
        learner = fit_regressor(self.samples, self.shape, form, 0.0, reading, flat=self.flat, kept=self.kept, skin=skin)
        folds = learner.ridge.folds(self.slope, np.ones(len(self.slope)), np.ones(self.count, bool))
        trial = _Trial(self, learner, folds, {})
        trial.attempt(range(1, len(PENALTIES), PENALTY_STRIDE))
        return trial


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A learner whose penalty is being chosen: held-out errors fall and rise again with it.

    errors : held-out error by the number of the penalty, of those that were tried
    """

    lesson: Lesson
    learner: RegressorFit
    folds: FoldedRidge
    errors: dict[int, float]

    @property
    def error(self) -> float:
        """The least held-out error so far, in slope."""
        return min(self.errors.values())

    def attempt(self, numbers: Iterable[int]) -> None:
        """Try these penalties, as far as there are any that were not tried."""
        tried = [number for number in numbers if 0 <= number < len(PENALTIES) and number not in self.errors]
        if tried:
            self.errors.update(zip(tried, self._errors(tried, judged=True), strict=True))

    def _errors(self, numbers: Sequence[int], *, judged: bool) -> list[float]:
        held_out = np.stack(self.folds.held_out([PENALTIES[number] for number in numbers], judged=judged))
        return balanced_errors(self.lesson.samples.ball, slope_from_stereographic(held_out), self.lesson.slope)

    def at_best_penalty(self) -> tuple[RegressorFit, float]:
        """Return the learner at the best penalty so far or next to it, and its held-out error.

        Of penalties whose errors are alike, the smallest is taken.
        """
        least = self._least()
        self.attempt(range(least - PENALTY_STRIDE + 1, least + PENALTY_STRIDE))
        alike = PENALTY_TIE * self.errors[self._least()]
        least = min((number for number, error in self.errors.items() if error <= alike), default=self._least())
        (as_seen,) = self._errors([least], judged=False)
        return replace(self.learner, penalty=PENALTIES[least], error_as_seen=as_seen), self.errors[least]

    def _least(self) -> int:
        return min(self.errors, key=lambda number: self.errors[number])


def _of_samples(
    learner: RegressorFit, samples: BallSamples, slope: Float64Array, shape: tuple[int, int]
) -> tuple[Reading | None, GentleSkin | None]:
    """Return what a learner reads and is anchored at, as other samples of the same balls show it."""
    near, skin = isinstance(learner.reading, NearLightModel), learner.skin
    reading = NearLightModel.of(samples, slope, shape) if near else learner.reading
    return reading, None if skin is None else GentleSkin.of(samples, slope, shape, skin.light)


def _seen(intensity: Float32Array, place: Float64Array, reading: Reading | None) -> Float32Array:
    return intensity if reading is None else reading.seen(intensity, place)
