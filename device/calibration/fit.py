"""Fits the inverse map to balls, judged by balls that the fit did not see.

The penalty and the degree in position are those with the least error on held-out balls (whole balls, five folds).
Centres are then refined (see `centre_refinement`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np

from device.balls.detector import RejectedBall
from device.balls.sphere import Ball, BallSamples
from device.calibration.candidates import (
    MIN_FOR_MANY_TERMS,
    Lesson,
    RegressorFit,
    RegressorForm,
    fit_regressor,
)
from device.calibration.centre_refinement import Learners, Refined, held_out_slopes, refine, results_of, true_slopes
from device.calibration.cross_validation import FOLDS, HeldOutReadings, SlopeGain, angle_between_deg, slope_gains
from device.errors import CalibrationError
from device.inverse_map.branches import NearLightBranch, RawLightBranch, RootCurve, RootIntensity, light_at_rest
from device.inverse_map.model import InverseMap, rest_nodes
from device.inverse_map.near_light import IlluminationMap, NearLightModel
from device.inverse_map.regressor import FeatureRegressor, field_position
from device.inverse_map.training_domain import TrainingDomain
from device.surface import Float64Array, MaskArray

LONE_BALL_FORM: Final = RegressorForm(4, 0)
LONE_BALL_PENALTY: Final = 1e-3
DISTRUST_POWER: Final = 20.0
"""Power of its held-out error with which a curve loses weight: an error larger by 10 % leaves a seventh."""

MIN_CURVE_WEIGHT: Final = 0.07
"""A curve beside the first with less weight is left out: it would cost as much as one that helps."""

MAX_WEIGHT: Final = 1e6
"""Of another curve beside the first: what is read is divided by the first one's share."""

NEAR_GAIN: Final = 0.975
"""Share of the held-out error of intensity's curve that a curve of near lights' slopes must reach to take its place.

It costs a third more; and a gain of one per cent on oem-bga's balls was lost again beside the curve of light.
"""

FREE_GAIN: Final = 0.97
"""Share of a curve's held-out error that one which is free to misread untouched skin must reach."""

CORE_FRACTION: Final = 0.9
"""Of a contact's radius: hand-drawn contacts often reach to where the skin has lifted off."""

BAND_EDGES_DEG: Final = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 90.0)
MIN_PIXELS: Final = 500

CHOOSING_SAMPLES: Final = 12_000
"""Samples by which forms and penalties are compared: what held-out balls get wrong is alike over many pixels."""

SAME_RADIUS: Final = 0.02
"""Radii this share apart are two sizes of balls."""


@dataclass(frozen=True, slots=True)
class SlopeBand:
    """Held-out error of the pixels whose surface is tilted between two angles."""

    from_deg: float
    to_deg: float
    error_deg: float
    pixels: int


@dataclass(frozen=True, slots=True, eq=False)
class InverseFit:
    """A fitted map, and its errors on held-out balls.

    map : the inverse map, fitted to all kept balls
    balls : every ball in the order of the samples, with refined centres
    kept : bool array of shape (balls,), False where a ball does not follow the sphere
    ball_error_deg : float64 array of shape (balls,), held-out mean angular error of the normal; NaN when unknown
    held_out_deg : the same over all pixels of kept balls, None when there is one ball only
    bands : the same by slope
    core_deg : the same within `CORE_FRACTION` of the contacts, where labels that are too wide do no harm
    readings : of held-out balls, None when there is one ball only
    of_another_radius : readings by maps trained on balls of another radius only, None when all have one radius
    replicas : maps trained on all kept balls but a fold's, one a fold, without noise bias; none where few balls were
        kept or none were requested
    """

    map: InverseMap
    balls: tuple[Ball, ...]
    kept: MaskArray
    ball_error_deg: Float64Array
    held_out_deg: float | None
    bands: tuple[SlopeBand, ...]
    core_deg: float | None = None
    readings: HeldOutReadings | None = None
    of_another_radius: HeldOutReadings | None = None
    replicas: tuple[InverseMap, ...] = ()

    @property
    def gains(self) -> tuple[SlopeGain, ...]:
        """Gain by band of slope of balls of another radius where there are any, else of held-out balls."""
        readings = self.of_another_radius or self.readings
        return slope_gains(readings) if readings else ()


def fit_inverse_map(
    samples: BallSamples,
    balls: Sequence[Ball],
    shape: tuple[int, int],
    *,
    max_samples: int = 40_000,
    light: IlluminationMap | None = None,
) -> InverseFit:
    """Return the inverse map fitted to samples of `balls`, with its held-out errors.

    The full-size field has the `shape` (H, W). Arguments and errors as for `begin_fit`.
    """
    return begin_fit(samples, balls, shape, max_samples=max_samples, light=light).finished()


@dataclass(frozen=True, slots=True, eq=False)
class BegunFit:
    """A fit that may still lose against another.

    fit : without what judges no fit: the map's leverage and the replicas
    finished : gives the fit with both
    learned : the learner of intensity and those of the map; None of a lone ball
    """

    fit: InverseFit
    finished: Callable[[], InverseFit]
    learned: tuple[RegressorFit, Learners] | None


def begin_fit(
    samples: BallSamples,
    balls: Sequence[Ball],
    shape: tuple[int, int],
    *,
    max_samples: int = 40_000,
    light: IlluminationMap | None = None,
    thorough: bool = False,
    like: BegunFit | None = None,
    alone: MaskArray | None = None,
) -> BegunFit:
    """Return the fit of a full-size field of `shape` (H, W) to samples of `balls`.

    light : of untouched skin, for curves that want a reference, where held-out balls gain by them
    thorough : try curves that the quick look would not use too: of the root of intensity, and such as need not read
        untouched skin as flat where pressed skin without slope has another colour
    like : a fit of nearly the same samples, whose forms are taken; penalties and shares are chosen again
    alone : bool array of shape (balls,), True for the only ball of its press; None where that is not known

    Raises
    ------
    CalibrationError
        The balls cover too few valid pixels.
    """
    chosen = _thinned(samples, max_samples)
    if len(chosen.p) < MIN_PIXELS:
        raise CalibrationError(
            f"the balls cover only {len(chosen.p)} usable pixels: press the ball deeper or lower the exposure"
        )
    everyone = np.ones(len(balls), bool)
    slope = true_slopes(chosen, balls)
    if len(balls) == 1:
        learner = fit_regressor(chosen, shape, LONE_BALL_FORM, LONE_BALL_PENALTY)
        solution = learner.ridge.solve(learner.penalty, slope, np.ones(len(slope)), everyone)
        domain = TrainingDomain.observed(samples.intensity)
        fitted = InverseMap(shape, domain, learner.curve(solution), balls[0].steepest)
        lone = InverseFit(fitted, tuple(balls), everyone, np.array([np.nan]), None, ())
        return BegunFit(lone, lambda: lone, None)
    few = _thinned(chosen, CHOOSING_SAMPLES)
    lesson = Lesson(few, true_slopes(few, balls), len(balls), shape)
    known = like.learned if like else None
    learned = _learners_like(lesson, *known) if known else _learners(lesson, light, thorough=thorough)
    plain, learners = learned
    if few is not chosen:
        learners = [(learner.of_samples(chosen, slope, shape), share) for learner, share in learners]
        plain = plain.of_samples(chosen, slope, shape)
    state = refine(chosen, balls, learners, alone)
    if not state.kept.any():
        raise CalibrationError(
            "no ball follows the sphere well enough to be used: press the ball again, deeper and centred"
        )
    rows = state.kept[chosen.ball]
    domain = TrainingDomain.observed(samples.intensity[state.kept[samples.ball]])
    error = angle_between_deg(state.held_out[rows], state.slope[rows])
    steepest = max(ball.steepest for ball, follows in zip(balls, state.kept, strict=True) if follows)
    fit = InverseFit(
        map=_map(plain, learners, state, domain, shape, steepest),
        balls=state.balls,
        kept=state.kept,
        ball_error_deg=state.errors_deg,
        held_out_deg=float(error.mean()),
        bands=_bands(error, state.slope[rows]),
        core_deg=float(error[_in_core(chosen, balls)[rows]].mean()),
        readings=_readings(chosen, state, state.held_out, shape),
        of_another_radius=_of_another_radius(chosen, state, learners, shape),
    )

    def finished() -> InverseFit:
        known = replace(fit.map, leverage=plain.leverage(state.slope, state.weight, state.kept))
        replicas = _replicas(few, state, *learned, domain, shape) if thorough else ()
        return replace(fit, map=known, replicas=replicas)

    return BegunFit(fit, finished, learned)


def _in_core(samples: BallSamples, balls: Sequence[Ball]) -> MaskArray:
    """Return True for samples within `CORE_FRACTION` of their ball's contact: bool array of shape (N,)."""
    centre = np.array([[ball.column, ball.row] for ball in balls])[samples.ball]
    reach = CORE_FRACTION * np.array([ball.contact_radius_px for ball in balls])[samples.ball]
    return np.asarray(np.hypot(samples.column - centre[:, 0], samples.row - centre[:, 1]) <= reach)


def _replicas(
    samples: BallSamples,
    state: Refined,
    plain: RegressorFit,
    learners: Learners,
    domain: TrainingDomain,
    shape: tuple[int, int],
) -> tuple[InverseMap, ...]:
    """Return a map for every fold of kept balls, trained on the other folds; none with fewer than two balls a fold."""
    kept = np.flatnonzero(state.kept)
    if len(kept) < 2 * FOLDS:
        return ()
    slope, everything = true_slopes(samples, state.balls), np.ones(len(samples.p))
    maps = []
    for number in range(FOLDS):
        alive = state.kept.copy()
        alive[kept[number::FOLDS]] = False
        part = replace(state, slope=slope, weight=everything, kept=alive)
        maps.append(_map(plain, learners, part, domain, shape, 1.0))
    return tuple(maps)


def _readings(samples: BallSamples, state: Refined, slope: Float64Array, shape: tuple[int, int]) -> HeldOutReadings:
    """Return the held-out slopes (N, 2) of the kept balls with what they should be."""
    rows = state.kept[samples.ball]
    place = field_position(samples.column[rows].astype(np.float64), samples.row[rows].astype(np.float64), shape)
    radius_px = np.array([ball.radius_px for ball in state.balls])
    return HeldOutReadings(slope[rows], state.slope[rows], place, samples.ball[rows], radius_px)


def _of_another_radius(
    samples: BallSamples, state: Refined, learners: Learners, shape: tuple[int, int]
) -> HeldOutReadings | None:
    """Return readings of every ball by the map trained on balls of the other radii.

    None where the kept balls have one radius, or lack one that others have.
    """
    sizes = np.round(np.log([ball.radius_px for ball in state.balls]) / SAME_RADIUS).astype(np.intp)
    kinds, fold = np.unique(sizes, return_inverse=True)
    if len(np.unique(fold[state.kept])) < len(kinds) or len(kinds) < 2:
        return None
    return _readings(samples, state, held_out_slopes(learners, state, fold), shape)


def _learners(lesson: Lesson, light: IlluminationMap | None, *, thorough: bool) -> tuple[RegressorFit, Learners]:
    """Return the learner of intensity, and those of the map.

    The map's first learner is that of intensity or of near lights; those of root and light join where they are worth
    it.
    """
    many = lesson.count >= MIN_FOR_MANY_TERMS
    choices: dict[str, Callable[[Lesson], tuple[RegressorFit, float]]] = {"plain": Lesson.select_best}
    if light is not None and many:
        lesson = lesson.under(light)
    if thorough and many:
        choices["root"] = Lesson.root_learner
    if light is not None:
        choices["light"] = lambda one: one.select_best(light)
    kinds = {(name, True): choose for name, choose in choices.items()}
    if light is not None and many:
        kinds["near", True] = Lesson.fit_near_light
    if thorough:  # last, when the sums over pixels that both have are known
        kinds |= {(name, False): choose for name, choose in choices.items()}
    calls = [partial(choose, replace(lesson, flat=flat)) for (_, flat), choose in kinds.items()]
    found = dict(zip(kinds, results_of(calls), strict=True))
    plain, error = _flat_or_free(found, "plain")
    own = plain
    if ("near", True) in found:
        near, near_error = found["near", True]
        if near_error < NEAR_GAIN * error:
            own = near
    others = [_flat_or_free(found, name)[0] for name in choices if name != "plain"]
    return plain, _shared(own, others)


def _learners_like(lesson: Lesson, plain: RegressorFit, learners: Learners) -> tuple[RegressorFit, Learners]:
    """Return learners of the same forms that read the same, with the penalties and shares that this lesson prefers."""
    before = [plain, *(learner for learner, _ in learners if learner is not plain)]
    calls = [partial(replace(lesson, flat=learner.flat).relearned, learner) for learner in before]
    found = results_of(calls)
    relearned = [learner for learner, _ in found]
    own, *others = relearned if learners[0][0] is plain else relearned[1:]
    return relearned[0], _shared(own, others)


def _flat_or_free(
    found: Mapping[tuple[str, bool], tuple[RegressorFit, float]], name: str
) -> tuple[RegressorFit, float]:
    """Return the learner that reads untouched skin as flat, unless the free one is enough better."""
    flat, free = found[name, True], found.get((name, False))
    return free if free and free[1] < FREE_GAIN * flat[1] else flat


def _shared(own: RegressorFit, others: Sequence[RegressorFit]) -> Learners:
    """Return the learners with their shares, without those that weigh too little; the first is always there.

    Shares come from held-out errors with noise, which a mean of several curves averages.
    """
    weights = [min((own.error_as_seen / other.error_as_seen) ** DISTRUST_POWER, MAX_WEIGHT) for other in others]
    total = 1.0 + sum(weights)
    kept = [
        (learner, weight) for learner, weight in zip(others, weights, strict=True) if weight > MIN_CURVE_WEIGHT * total
    ]
    total = 1.0 + sum(weight for _, weight in kept)
    return [(own, 1.0 / total), *((learner, weight / total) for learner, weight in kept)]


def _thinned(samples: BallSamples, count: int) -> BallSamples:
    """Return at most `count` samples, drawn without replacement from a fixed seed."""
    if len(samples.p) <= count:
        return samples
    return samples.select(np.sort(np.random.default_rng(0).permutation(len(samples.p))[:count]))


def _map(
    plain: RegressorFit,
    learners: Learners,
    state: Refined,
    domain: TrainingDomain,
    shape: tuple[int, int],
    steepest: float,
) -> InverseMap:
    """Return the map trained on all kept balls, without its leverage."""

    def trained(learner: RegressorFit) -> FeatureRegressor:
        return learner.curve(learner.ridge.solve(learner.penalty, state.slope, state.weight, state.kept))

    light, near, root = None, None, None
    for learner, share in learners:
        if isinstance(learner.reading, IlluminationMap):
            curve = trained(learner)
            at_rest = light_at_rest(curve, learner.reading) if learner.flat else None
            light = RawLightBranch(learner.reading, curve, share, at_rest)
        elif isinstance(learner.reading, NearLightModel):
            near = NearLightBranch(learner.reading, trained(learner))
        elif isinstance(learner.reading, RootIntensity):
            root = RootCurve(trained(learner), share)
    found = InverseMap(shape, domain, trained(plain), steepest, light, near=near, root=root)
    return found if all(learner.flat for learner, _ in learners) else replace(found, rest_bump=rest_nodes(found))


def _bands(error_deg: Float64Array, slope: Float64Array) -> tuple[SlopeBand, ...]:
    tilt = np.degrees(np.arctan(np.linalg.norm(slope, axis=1)))
    bands = []
    for low, high in pairwise(BAND_EDGES_DEG):
        inside = (tilt >= low) & (tilt < high)
        if inside.any():
            bands.append(SlopeBand(low, high, float(error_deg[inside].mean()), int(inside.sum())))
    return tuple(bands)


def dropped_ball(fit: InverseFit, number: int) -> RejectedBall:
    """Return the ball `number` of a fit as a rejected one, with the error by which it stood out."""
    ball = fit.balls[number]
    error_deg = float(fit.ball_error_deg[number])
    reason = f"does not follow the sphere (held-out error {error_deg:.1f} degrees)"
    return RejectedBall(ball.column, ball.row, reason, error_deg)
