"""Calibration of the light model: a bundle adjustment of sources, coat, albedo, residual field and ball centres.

Damped Gauss-Newton steps minimise robust errors of the intensity of the balls' pixels together with broad priors
(Triggs et al., "Bundle adjustment", 2000). Sources are added and the prior of the residual field is widened as long as
that lowers the error of held-out balls, which follows from the normal equations without those balls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from device.balls.sphere import Ball, BallSamples
from device.surface import Float64Array
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.bundle import OUTLYING, Bundle
from host_sync.light.kernel_derivatives import Numbers
from host_sync.light.kernels import write_light
from host_sync.light.model import LightModel, source_points

STARTS: Final = ((0.35, 0.45), (0.5, 0.2))
"""Height and length of the sources, in widths of the field, from which searches begin."""
MAX_ADDED: Final = 2
"""Sources that are added to the first one of each channel, at most."""
RESIDUAL_SIGMAS: Final = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Prior standard deviations of the residual field's coefficients that are tried."""
MIN_GAIN: Final = 0.98
"""Held-out error, relative to that before, which a model with one source more a channel or a wider residual field must
reach, and which every source must pay for against a model without sources."""


WIDENING: Final = 4.0
"""Standard uncertainty of the inverse map's slopes in a search without sources, relative to that on held-out balls: map
and model are two estimates there, which `FittedLight.confirmed` weighs."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedLight:
    """The light model of a calibration.

    model : fitted to all balls; without sources where these predict held-out balls no better than a polynomial does
    folds : fitted without every K-th ball, from each of the first K on
    shift_px : float64 array of shape (balls, 2), what the fit adds to each centre's column and row
    confirmed : fraction of what the model changes of slopes that held-out balls confirm
    """

    model: LightModel
    folds: tuple[LightModel, ...]
    shift_px: Float64Array
    confirmed: float = 1.0

    @property
    def has_sources(self) -> bool:
        """True where sources explain the balls: else a polynomial of the normal and the place does."""
        return len(self.model.sources) > 0

    def search_sigma(self, prior_sigma: float) -> float:
        """Return the standard uncertainty of the inverse map's slopes in the search, from that on held-out balls."""
        return prior_sigma if self.has_sources else WIDENING * prior_sigma

    def without(self, ball: int) -> LightModel:
        """Return the model without the fold of the ball of this number."""
        return self.folds[ball % len(self.folds)]

    def for_shape(self, shape: tuple[int, int]) -> FittedLight:
        """Return the model of the same field at (H, W) pixels: its lengths are in widths of the field."""
        folds = tuple(replace(fold, shape=shape) for fold in self.folds)
        return replace(self, model=replace(self.model, shape=shape), folds=folds)


def fit_light(
    samples: BallSamples,
    incoming: Callable[[LightModel], Float64Array],
    balls: Sequence[Ball],
    apexes_px: Sequence[float],
    shape: tuple[int, int],
    positions: Float64Array | None = None,
) -> FittedLight:
    """Return the light model that balls of a full-size field of `shape` (H, W) show.

    samples : of the balls
    incoming : light from skin around the samples over that at rest, shape (N, C), for a model of the light at rest
    apexes_px : elevation of each ball's apex over skin at rest, pixels
    positions : stated places of the sources, shape (C, 3), in widths of the field; None where they are not known
    """
    bundle = Bundle.of(samples, balls, apexes_px, shape)
    searches = [bundle.solve(bundle.start(*start, positions)) for start in STARTS]
    found = min(searches, key=lambda one: float(np.square(bundle.errors(one)).mean()))
    model = bundle.model(found)
    bundle = replace(bundle, incoming=incoming(model)[bundle.rows])
    bundle = bundle.with_sigma_of(found)
    found = bundle.solve(found)
    held_out = bundle.held_out(found)
    for _ in range(MAX_ADDED):
        more = bundle.solve(with_source(bundle, found))
        again = bundle.held_out(more)
        if again > MIN_GAIN * held_out:
            break
        found, held_out = more, again
        bundle = bundle.with_sigma_of(found)
        held_out = bundle.held_out(found)
    source_sigma = bundle.held_out_sigma(found)
    plain, polynomial = _with_residual(bundle, bundle.without_sources(found))
    bundle, found = _with_residual(bundle, found)
    is_better = bundle.held_out(found) <= MIN_GAIN ** len(found.place) * plain.held_out(polynomial)
    if not (is_better and bundle.model(found).lights_field):
        # A ball shows each tilt at one elevation: without sources, the two cannot be separated.
        source_sigma = np.sqrt(np.square(bundle.intensity - 1.0).mean(axis=0))
        bundle, found = _with_residual(bundle, bundle.without_sources(found), "normals")
    sigma = bundle.held_out_sigma(found)
    model, *folds = (
        replace(bundle.model(numbers), sigma=sigma, source_sigma=source_sigma)
        for numbers in (found, *(without for _, without in bundle.without(found)))
    )
    return FittedLight(model, tuple(folds), found.shift)


def _with_residual(
    bundle: Bundle, numbers: Numbers, stage: Literal["residual", "normals"] = "residual"
) -> tuple[Bundle, Numbers]:
    """Return the fit with a residual field over fixed sources, of the narrowest prior that no wider one beats."""
    best, least = (bundle, numbers), np.inf
    for sigma in RESIDUAL_SIGMAS:
        wider = replace(bundle, residual_sigma=sigma, stage=stage)
        numbers = wider.solve(numbers)
        held_out = wider.held_out(numbers)
        if held_out < MIN_GAIN * least:
            best, least = (wider, numbers), held_out
    return best


def with_source(bundle: Bundle, numbers: Numbers) -> Numbers:
    """Return the numbers with one source more a channel, where it explains most of what is left."""
    terms, model = bundle.terms(numbers), bundle.model(numbers)
    missing = bundle.intensity - terms.shown
    weight = 1.0 / (bundle.sigma**2 + np.square(missing / OUTLYING))
    angle, near, slant = np.meshgrid(np.arange(16) * (np.pi / 8), (0.4, 0.8), (0.25, 0.6, 1.2), indexing="ij")
    places = np.stack([near * np.cos(angle), near * np.sin(angle), near * slant], axis=-1).reshape(-1, 3)
    tried = np.concatenate([places, np.full((len(places), 2), 0.2)], axis=1)
    lit = terms.lit
    level = np.zeros_like(lit.p)
    light = _one_light(tried, model, (lit.p, lit.q, bundle.x, bundle.y, lit.z))
    rest = _one_light(tried, model, (level, level, bundle.x, bundle.y, level))
    chosen, strengths = [], np.zeros((missing.shape[1], missing.shape[1]))
    for channel in range(missing.shape[1]):
        change = (light - terms.ratio[:, channel, None] * rest) / terms.at_rest[:, channel, None]
        weighted = weight[:, channel, None] * change
        bright = (weighted * missing[:, channel, None]).sum(axis=0) / np.maximum((weighted * change).sum(axis=0), 1e-12)
        gain = np.maximum(bright, 0.0) * (weighted * missing[:, channel, None]).sum(axis=0)
        best = int(np.argmax(gain))
        chosen.append(tried[best])
        strengths[channel, channel] = np.clip(bright[best], 0.0, 0.3)
    added = np.array(chosen)
    place = np.concatenate([added[:, :2], np.log(added[:, 2:3])], axis=1)
    return replace(
        numbers, place=np.concatenate([numbers.place, place]),
        extent=np.concatenate([numbers.extent, added[:, 3:]]),
        strength=np.concatenate([numbers.strength, strengths], axis=1),
    )  # fmt: skip


def _one_light(sources: Float64Array, model: LightModel, skin: tuple[Float64Array, ...]) -> Float64Array:
    """Return the light of sources (S, 4) on a model's coat: shape (N, S)."""
    out = np.empty((len(skin[0]), len(sources)))
    parallel_rows(write_light, (len(out), 64), *source_points(sources, model.fall_off), model.coat, *skin, out)
    return out
