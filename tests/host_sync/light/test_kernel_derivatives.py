"""Derivatives of the light of sources are those of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from device.surface import Float64Array
from host_sync.light.kernel_derivatives import COAT, COAT_START, EXTENT, Numbers, light_derivatives
from host_sync.light.kernels import write_search
from host_sync.light.model import ELEVATION, MONOMIALS, PLACES, TERMS, LightModel

STEP = 1e-5
COATS = {
    "matt": COAT_START + np.array([0.0, 0.1, -0.1, 0.0, 0.0, 0.05, 0.3, 0.0, 0.2]),
    "glossy": COAT_START + np.array([-0.4, -0.2, 0.5, 0.2, 1.0, -0.1, 0.0, 0.4, 0.0]),
}


def numbers(coat: Float64Array) -> Numbers:
    """Return numbers of three sources."""
    place = np.array([[0.9, 0.1, np.log(0.4)], [-0.5, 0.7, np.log(0.5)], [-0.3, -0.8, np.log(0.3)]])
    extent = np.array([[0.4, 0.3], [0.2, 0.1], [0.6, 0.5]])
    return Numbers(
        place, extent, np.eye(3), np.full(3, 0.01), np.array([0.3]), coat, np.zeros((1, 2)),
        np.zeros((3, TERMS * PLACES)),
    )  # fmt: skip


def model(of: Numbers) -> LightModel:
    """Return the model of numbers, under a camera nearby."""
    fall_off, roughness, gloss, width, tail, tilt_gain, beam, camera, scattering = of.coat.tolist()
    return LightModel(
        (300, 400), of.sources, of.strength, of.haze, 0.3, fall_off, roughness, gloss, float(np.exp(width)),
        float(np.exp(tail)), tilt_gain, beam, camera, scattering, np.zeros((3, TERMS, PLACES)), np.ones(3),
        np.ones(3), 1.0,
    )  # fmt: skip


@pytest.mark.parametrize("coat", COATS.values(), ids=COATS.keys())
def test_derivatives_by_sources_and_coat_are_differences_of_the_light(coat: Float64Array) -> None:
    rng, at = np.random.default_rng(0), numbers(coat)
    p, q = rng.uniform(-0.6, 0.6, (2, 200))
    x, y, z = rng.uniform(-0.5, 0.5, 200), rng.uniform(-0.4, 0.4, 200), rng.uniform(0.0, 0.05, 200)
    by_source, by_coat = light_derivatives(at, model(at), (p, q, x, y, z), model(at).light(p, q, x, y, z))
    for number in range(EXTENT):
        name, axis = ("place", number) if number < 3 else ("extent", number - 3)
        ends = []
        for sign in (1.0, -1.0):
            moved = getattr(at, name).copy()
            moved[:, axis] += sign * STEP
            ends.append(model(replace(at, **{name: moved})).light(p, q, x, y, z))
        np.testing.assert_allclose(by_source[..., number], (ends[0] - ends[1]) / (2 * STEP), rtol=1e-4, atol=1e-4)
    for number in range(len(COAT)):
        ends = []
        for sign in (1.0, -1.0):
            moved = coat.copy()
            moved[number] += sign * STEP
            ends.append(model(replace(at, coat=moved)).light(p, q, x, y, z))
        np.testing.assert_allclose(by_coat[..., number], (ends[0] - ends[1]) / (2 * STEP), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("coat", COATS.values(), ids=COATS.keys())
def test_a_searchs_derivatives_by_slope_are_differences_of_the_intensity(coat: Float64Array) -> None:
    rng = np.random.default_rng(1)
    of = replace(model(numbers(coat)), residual=rng.normal(0.0, 0.02, (3, TERMS, PLACES)))
    count = 200
    slope = rng.uniform(-0.6, 0.6, (count, 2))
    places = rng.uniform(-0.5, 0.5, count), rng.uniform(-0.4, 0.4, count), rng.uniform(0.0, 0.05, count)
    incoming = rng.uniform(0.0, 0.1, (count, 3))
    x, y, _ = places
    skin = (*places, of.rest(x, y), np.ones((count, 3)), of.albedo * incoming, of.residual_at(x, y))
    sources = (*of.geometry, of.coat, of.strengths, of.haze, np.array(MONOMIALS, np.intp))
    change, weight = np.empty((count, 3, 2)), np.empty((count, 3))
    seen = of.intensity(slope, places, incoming), np.ones((count, 3))
    found = slope.copy()
    write_search(
        sources, skin, seen, (slope, np.ones(count)), (0.3, 0.3, 4.0, ELEVATION), 1, np.arange(count), found, change,
        weight, 0, count,
    )  # fmt: skip
    np.testing.assert_allclose(found, slope, atol=1e-9)
    for axis, step in enumerate(STEP * np.eye(2)):
        ends = [of.intensity(slope + sign * step, places, incoming) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(change[..., axis], (ends[0] - ends[1]) / (2 * STEP), rtol=1e-3, atol=1e-4)
