"""Balls are read by lamps that were fitted without them; lamps count only where that is better than the map."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import cast

import numpy as np
from near_lamps import LAMPS_OUT_PX, SHAPE, NearLamps, balls, press_px
from point_lamps import point_lamps

from device.balls.sphere import Ball, gather_samples, sphere_slopes
from device.calibration.fit import InverseFit
from device.imaging.flat_field import NormalizedImage
from host_sync.calibration.elevated_balls import ElevatedBalls
from host_sync.calibration.elevation_response import ElevationResponse
from host_sync.calibration.elevation_steps import lamps_that_read_better
from host_sync.lights.lamp_model import FittedLamps, LampModel
from host_sync.lights.lamp_slopes import LampReader
from host_sync.lights.lit_skin import is_lit_by_all
from host_sync.uncertainty.elevation import ElevationCorrection
from host_sync.uncertainty.slope_error import IsLit, OverCells, SlopeError, measure_slope_error

HEIGHT_PX = 220.0
LAMPS = NearLamps(HEIGHT_PX)
TRUE = balls()
PRESSES: list[tuple[NormalizedImage, list[Ball]]] = [
    (LAMPS.intensity(press_px(ball, apex), seen_at=0.0, noise=0.002, seed=i), [ball])
    for i, (ball, apex) in enumerate(TRUE)
]
ANGLE = np.radians([10.0, 130.0, 250.0])
OUT = LAMPS_OUT_PX / SHAPE[1]
MODEL = point_lamps(
    SHAPE, np.stack([OUT * np.cos(ANGLE), OUT * np.sin(ANGLE), np.full(3, HEIGHT_PX / SHAPE[1])], axis=-1)
)
LOWER = replace(MODEL, position=MODEL.position * [1.0, 1.0, 0.8])
LEVEL = ElevationResponse(
    np.zeros((33, 33, 2, 3), np.float32),
    np.zeros((33, 33, 3), np.float32),
    np.zeros((33, 33, 2, 3), np.float32),
    share=1.0,
    share_sigma=0.1,
)
NO_ELEVATION = ElevationCorrection(apex_px=0.0, radius_px=100.0, nearness_per_px=0.0)


def followed(*folds: object) -> ElevatedBalls:
    apexes_px = tuple((apex,) for _, apex in TRUE)
    lamps = FittedLamps(MODEL, cast("tuple", folds))
    return ElevatedBalls(LEVEL, tuple((ball,) for ball, _ in TRUE), apexes_px, lamps)


def inverse(held_out_deg: float | None, dropped: int | None = None) -> InverseFit:
    """A map that reads all skin as level, with this held-out error."""
    kept = np.arange(len(TRUE)) != (-1 if dropped is None else dropped)
    level = SimpleNamespace(predict=lambda intensity, *_: np.zeros((len(intensity), 2)), shape=SHAPE)
    return cast(InverseFit, SimpleNamespace(map=level, kept=kept, held_out_deg=held_out_deg, replicas=()))


def models_by_ball(found: OverCells | None) -> list[LampModel]:
    assert found is not None
    assert cast(LampReader, found.reads).model is MODEL
    return [cast(LampReader, one).model for one in found.without]


def test_every_ball_is_read_by_the_fold_without_it() -> None:
    found = lamps_that_read_better(PRESSES, inverse(30.0), followed(MODEL, LOWER))
    assert models_by_ball(found) == [(MODEL, LOWER)[number % 2] for number in range(len(TRUE))]


def test_a_ball_that_the_map_dropped_moves_no_other_to_another_fold() -> None:
    kept = [press for number, press in enumerate(PRESSES) if number != 2]
    found = lamps_that_read_better(kept, inverse(30.0, dropped=2), followed(MODEL, LOWER))
    assert models_by_ball(found) == [(MODEL, LOWER)[number % 2] for number in range(len(TRUE)) if number != 2]


def test_lamps_are_believed_only_where_balls_that_they_did_not_see_are_read_better() -> None:
    assert lamps_that_read_better(PRESSES, inverse(1.0), followed(MODEL, MODEL)) is not None
    assert lamps_that_read_better(PRESSES, inverse(1.0), followed(LOWER, LOWER)) is None
    assert lamps_that_read_better(PRESSES, inverse(None), followed(MODEL, MODEL)) is None
    assert lamps_that_read_better(PRESSES, inverse(1.0), replace(followed(), lamps=None)) is None


def test_patches_are_those_of_lamps_without_the_ball_and_gains_those_of_all_balls() -> None:
    """Lamps that stand a fifth lower read balls of every other fold wrong."""
    samples, fit = gather_samples(PRESSES), inverse(None)

    def error_with(model: LampModel, *folds: LampModel) -> SlopeError:
        without = [LampReader(fit.map, folds[number % len(folds)]) for number in range(len(TRUE))]
        return measure_slope_error(
            PRESSES, samples, fit, NO_ELEVATION, OverCells(LampReader(fit.map, model), without, 2)
        )

    def patch_deg(*folds: LampModel) -> float:
        error = error_with(MODEL, *folds)
        return float(np.interp(20.0, error.tilt_deg, error.patch_deg))

    right, half, wrong = patch_deg(MODEL), patch_deg(MODEL, LOWER), patch_deg(LOWER)
    assert right < 0.5 * half < wrong
    own, lower = (np.abs(error_with(model, MODEL).ball_gains).mean() for model in (MODEL, LOWER))
    assert own < 0.3 * lower


def dark_where_hidden() -> list[tuple[NormalizedImage, list[Ball]]]:
    """The presses, half as bright where the skin hides a lamp."""
    found = []
    for image, own in PRESSES:
        row, column = np.indices(SHAPE).astype(np.float32)
        values = image.values.copy()
        values[~is_lit_by_all(MODEL, *sphere_slopes(own[0], column, row), column, row)] *= 0.5
        found.append((replace(image, values=values), own))
    return found


def test_skin_that_a_lamp_does_not_reach_is_held_against_no_lamps() -> None:
    """There a scan counts on two lamps, with an uncertainty of its own."""
    dark, fit = dark_where_hidden(), inverse(None)
    samples = gather_samples(dark)

    def error(is_lit: IsLit | None) -> SlopeError:
        over = OverCells(LampReader(fit.map, MODEL), [LampReader(fit.map, MODEL)] * len(TRUE), 1, is_lit)
        return measure_slope_error(dark, samples, fit, NO_ELEVATION, over)

    everywhere, lit = error(None), error(partial(is_lit_by_all, MODEL))
    assert np.abs(lit.ball_gains).max() < 0.3 * np.abs(everywhere.ball_gains).max()
    assert lit.patch_deg[-1] < 0.5 * everywhere.patch_deg[-1]
    assert lit.patch_px == everywhere.patch_px


def test_where_hardly_a_ball_is_lit_all_skin_counts() -> None:
    fit = inverse(None)
    samples = gather_samples(PRESSES)

    def error(is_lit: IsLit | None) -> SlopeError:
        over = OverCells(LampReader(fit.map, LOWER), [LampReader(fit.map, LOWER)] * len(TRUE), 2, is_lit)
        return measure_slope_error(PRESSES, samples, fit, NO_ELEVATION, over)

    everywhere = error(None)
    assert error(lambda p, *_: np.zeros(p.shape, np.bool_)) == everywhere
    assert error(lambda p, q, column, _: (column < 100.0) & (np.hypot(p, q) > 0.4)) == everywhere
    assert min(everywhere.patch_deg) > 0.0
