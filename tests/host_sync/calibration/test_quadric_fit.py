"""A quadratic function of the normal is taken where it explains balls that it did not see, and reads them better."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
from makers_skin import SHAPE, light_of, presses, shown
from near_lamps import SHAPE as LAMPS_SHAPE
from near_lamps import NearLamps, balls, press_px

from device.balls.sphere import gather_samples
from device.calibration.cross_validation import FOLDS
from device.calibration.fit import InverseFit
from device.inverse_map.illumination import IlluminationMap
from device.surface.fields import Float64Array
from host_sync.calibration.quadric_fit import quadric_that_reads_better
from host_sync.lights.normal_quadric import QuadricReader

PRESSES = list(presses())


def inverse(too_flat: float, colours: float = 0.0, replicas: int = FOLDS) -> InverseFit:
    """A map, and its replicas, that read balls' slopes by this share too flat."""
    truth = gather_samples(list(presses(colours=colours)))
    slopes = {(c, r): (p, q) for c, r, p, q in zip(truth.column, truth.row, truth.p, truth.q, strict=True)}

    def predict(_: object, column: np.ndarray, row: np.ndarray) -> Float64Array:
        read = np.array([slopes[place] for place in zip(column, row, strict=True)], np.float64)
        return (1.0 - too_flat) * read

    one = SimpleNamespace(predict=predict, shape=SHAPE)
    return cast(InverseFit, SimpleNamespace(map=one, replicas=(one,) * replicas))


def test_what_explains_the_balls_reads_the_skin_between_them() -> None:
    found = quadric_that_reads_better(PRESSES, inverse(0.05), None)
    assert found is not None
    fitted, over_cells = found
    random = np.random.default_rng(0)
    column, row = random.uniform(20, 300, 200), random.uniform(20, 220, 200)
    slope = random.uniform(-0.35, 0.35, (200, 2))
    wanted = shown(slope[:, 0], slope[:, 1], column, row)
    np.testing.assert_allclose(fitted.model.at(column, row).shown(slope), wanted, atol=0.004)
    assert cast(QuadricReader, over_cells.reads).model is fitted.model
    assert len(over_cells.without) == len(PRESSES)
    for ball, reader in enumerate(over_cells.without):
        assert cast(QuadricReader, reader).model is fitted.folds[ball % FOLDS]


def test_folds_are_taught_without_their_balls() -> None:
    """The fold of a ball that does not belong to the field is the only one that reads the others right."""
    image, ball = PRESSES[2]
    strange = [*PRESSES[:2], (replace(image, values=1.0 + 1.1 * (image.values - 1.0)), ball)]
    found = quadric_that_reads_better([*strange, *PRESSES[3:]], inverse(0.3), None)
    assert found is not None
    middle, slope = (np.array([float(ball[0].column)]), np.array([float(ball[0].row)])), np.array([[0.3, 0.1]])
    wanted = shown(slope[:, 0], slope[:, 1], *middle)
    errors = [np.abs(one.at(*middle).shown(slope) - wanted).max() for one in found[0].folds]
    assert int(np.argmin(errors)) == 2
    assert min(errors) < 0.5 * np.median(errors)


def test_a_map_that_reads_as_well_is_left_alone() -> None:
    assert quadric_that_reads_better(PRESSES, inverse(0.0), None) is None


def test_what_cannot_be_judged_is_not_taken() -> None:
    image, ball = PRESSES[0]
    values = image.values.copy()
    values[int(ball[0].row), int(ball[0].column)] = np.nan
    broken = [(replace(image, values=values), ball), *PRESSES[1:]]
    assert quadric_that_reads_better(broken, inverse(0.05), None) is None


def test_without_replicas_nothing_judges_it() -> None:
    assert quadric_that_reads_better(PRESSES, inverse(0.05, replicas=0), None) is None


def test_near_lamps_are_no_quadric_of_the_normal() -> None:
    lamps = NearLamps(120.0)
    pressed = [
        (lamps.intensity(press_px(ball, apex), seen_at=1.0, noise=0.002, seed=i), [ball])
        for i, (ball, apex) in enumerate(balls())
    ]
    blind = SimpleNamespace(predict=lambda intensity, *_: np.zeros((len(intensity), 2)), shape=LAMPS_SHAPE)
    fit = cast(InverseFit, SimpleNamespace(map=blind, replicas=(blind,) * FOLDS))
    assert quadric_that_reads_better(pressed, fit, None) is None


def test_where_the_field_is_strongly_coloured_polynomials_are_divided_by_its_light() -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    level = np.zeros(SHAPE)
    reference = light_of(level, level, column, row, 0.8).astype(np.float32)
    found = quadric_that_reads_better(list(presses(colours=0.8)), inverse(0.05, 0.8), IlluminationMap.of(reference))
    assert found is not None
    assert found[0].model.light is not None
