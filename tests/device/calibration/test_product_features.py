"""Normal equations from sums of monomials are those of the features themselves, whatever is taken off them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from device.calibration.product_features import ProductFeatures
from device.inverse_map.regressor import (
    RandomFourierFeatures,
    colour_exponents,
    monomial_rows,
    monomials,
    position_exponents,
)
from device.surface import Float64Array

PIXELS = 5000


def features(degrees: tuple[int, int], waves: RandomFourierFeatures, rest: int) -> ProductFeatures:
    rng = np.random.default_rng(3)
    count = (len(colour_exponents(degrees[0])) + waves.count) * len(position_exponents(degrees[1]))
    return ProductFeatures(
        rng.standard_normal((PIXELS, 3)),
        rng.uniform(-1.0, 1.0, (PIXELS, 2)),
        *degrees,
        waves,
        rng.uniform(0.5, 2.0, count),
        rng.standard_normal((rest, 3)) if rest else None,
    )


def multiplied_out(of: ProductFeatures) -> Float64Array:
    def terms(colours: Float64Array) -> Float64Array:
        found = monomials(colours, of.colour_degree)
        return np.concatenate([found, of.waves.values(colours)], axis=1)

    by_colour = terms(of.colours) - (0.0 if of.rest is None else terms(of.rest))
    by_place = monomials(of.place, of.position_degree)
    return (by_colour[:, :, None] * by_place[:, None, :]).reshape(PIXELS, -1) * of.scale


@pytest.mark.parametrize("rest", [0, 1, PIXELS], ids=["free", "alike at rest", "rest by place"])
@pytest.mark.parametrize("waves", [RandomFourierFeatures.none(), RandomFourierFeatures.sample()], ids=["plain", "wavy"])
@pytest.mark.parametrize("degrees", [(4, 0), (2, 2)])
def test_normal_equations_and_values(degrees: tuple[int, int], waves: RandomFourierFeatures, rest: int) -> None:
    of = features(degrees, waves, rest)
    rng = np.random.default_rng(5)
    rows = np.flatnonzero(rng.uniform(size=PIXELS) < 0.6)
    weight, wanted = rng.uniform(0.5, 2.0, PIXELS), rng.standard_normal((PIXELS, 2))
    table = multiplied_out(of)[rows]
    gram, moment = of.normal_equations(rows, weight, wanted)
    weighed = weight[rows, None] * table
    assert gram == pytest.approx(table.T @ weighed, abs=1e-12 * np.abs(gram).max())
    assert moment == pytest.approx(weighed.T @ wanted[rows], abs=1e-12 * np.abs(moment).max())
    coefficients = rng.standard_normal((len(of.scale), 3))
    values = of.times(rows, coefficients)
    assert values == pytest.approx(table @ coefficients, abs=1e-12 * np.abs(values).max())
    assert of.powers(rows, coefficients) == pytest.approx(((table @ coefficients) ** 2).sum(axis=1))


@pytest.mark.parametrize("rest", [1, PIXELS], ids=["alike at rest", "rest by place"])
def test_forms_that_differ_in_scale_or_in_an_even_rest_share_their_sums(rest: int) -> None:
    alone = features((3, 2), RandomFourierFeatures.none(), rest)
    other = replace(alone, scale=2.0 * alone.scale, rest=None if rest == 1 else alone.rest)
    rows, rng, kept = np.arange(100, 4000), np.random.default_rng(7), dict[bytes, Float64Array]()
    weight, wanted = rng.uniform(0.5, 2.0, PIXELS), rng.standard_normal((PIXELS, 2))
    for form in (alone, other):
        shared = replace(form, kept=kept).normal_equations(rows, weight, wanted)
        assert all(
            np.array_equal(*pair) for pair in zip(shared, form.normal_equations(rows, weight, wanted), strict=True)
        )
    assert len(kept) == 1
    changes = {"rows": rows[1:], "weight": weight**2, "wanted": -wanted}
    for name, changed in changes.items():
        asked = {"rows": rows, "weight": weight, "wanted": wanted} | {name: changed}
        shared = replace(alone, kept=kept).normal_equations(**asked)
        assert all(np.array_equal(*pair) for pair in zip(shared, alone.normal_equations(**asked), strict=True))
    assert len(kept) == 4


def test_forms_with_other_light_of_untouched_skin_share_nothing() -> None:
    form, kept = features((3, 1), RandomFourierFeatures.none(), PIXELS), dict[bytes, Float64Array]()
    rows, weight, wanted = np.arange(50, 3000), np.ones(PIXELS), np.zeros((PIXELS, 2))
    assert form.rest is not None
    for one in (form, replace(form, rest=form.rest + 0.1)):
        shared = replace(one, kept=kept).normal_equations(rows, weight, wanted)
        alone = one.normal_equations(rows, weight, wanted)
        assert all(np.array_equal(*pair) for pair in zip(shared, alone, strict=True))
    assert len(kept) == 2


def test_monomials_in_rows_are_those_in_columns() -> None:
    rng = np.random.default_rng(0)
    for variables in (2, 3):
        points = rng.standard_normal((7, variables))
        assert np.array_equal(monomial_rows(points.T, 5).T, monomials(points, 5))
