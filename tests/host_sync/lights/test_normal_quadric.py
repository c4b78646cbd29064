"""Skin that shows a quadratic function of its normal, and slopes that it tells."""

from types import SimpleNamespace
from typing import cast

import numpy as np
from makers_skin import SHAPE

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.model import InverseMap
from host_sync.lights.normal_quadric import TERMS, NormalQuadric, QuadricReader, normal_terms

RANDOM = np.random.default_rng(1)
COUNT = 300
COLUMN, ROW = RANDOM.uniform(0, SHAPE[1] - 1, COUNT), RANDOM.uniform(0, SHAPE[0] - 1, COUNT)
TRUE = RANDOM.uniform(-0.4, 0.4, (COUNT, 2))
COEFFICIENTS = 0.03 * RANDOM.standard_normal((TERMS, 3, 3))
COEFFICIENTS[:2, 0] = 0.8 * np.stack([np.cos([1.6, 3.7, 5.8]), np.sin([1.6, 3.7, 5.8])])
MODEL = NormalQuadric(SHAPE, 1, COEFFICIENTS, None)


def test_level_skin_shows_one_everywhere() -> None:
    assert not normal_terms(np.zeros((4, 2))).any()
    np.testing.assert_array_equal(MODEL.at(COLUMN, ROW).shown(np.zeros((COUNT, 2))), 1.0)


def test_terms_and_one_are_all_squares_and_products_of_a_normal() -> None:
    """Nine functions of second order span them: one more would follow from the others."""
    up = 1.0 / np.sqrt(1.0 + (TRUE**2).sum(axis=1))
    normal = np.stack([-TRUE[:, 0] * up, -TRUE[:, 1] * up, up], axis=1)
    terms = np.concatenate([np.ones((COUNT, 1)), normal_terms(TRUE)], axis=1)
    assert np.linalg.matrix_rank(terms) == TERMS + 1
    for wanted in (normal[:, 2] ** 2, normal[:, 0] * normal[:, 2], normal[:, 1]):
        left = wanted - terms @ np.linalg.lstsq(terms, wanted, rcond=None)[0]
        np.testing.assert_allclose(left, 0.0, atol=1e-10)


def test_slopes_are_those_that_explain_what_is_seen() -> None:
    skin = MODEL.at(COLUMN, ROW)
    seen = skin.shown(TRUE)
    np.testing.assert_allclose(skin.slopes(seen, 0.9 * TRUE + 0.01), TRUE, atol=1e-3)


def test_a_light_that_has_set_shows_nothing_and_tells_nothing() -> None:
    """The other two find the slope."""
    skin = MODEL.at(COLUMN, ROW)
    darker = NormalQuadric(SHAPE, 1, np.where(np.arange(3) == 0, 5.0, 1.0) * COEFFICIENTS, None).at(COLUMN, ROW)
    slope = np.tile([0.0, -0.6], (COUNT, 1)) * -np.sign(COEFFICIENTS[1, 0, 0])
    assert (skin.shown(slope) >= 0.0).all()
    seen = darker.shown(slope)
    assert (seen[:, 0] == 0.0).mean() > 0.9
    assert not darker.shown_and_changes(slope)[1][seen[:, 0] == 0.0, 0].any()
    np.testing.assert_allclose(darker.slopes(seen, 0.95 * slope), slope, atol=0.02)


def test_where_untouched_skin_is_bright_a_slope_changes_it_by_a_smaller_share() -> None:
    nodes = np.ones((5, 5, 3), np.float32) * np.linspace(0.5, 1.5, 5, dtype=np.float32)[None, :, None]
    lit = NormalQuadric(SHAPE, 1, COEFFICIENTS, IlluminationMap(nodes)).at(COLUMN, ROW).shown(TRUE)
    plain = MODEL.at(COLUMN, ROW).shown(TRUE)
    light = 0.5 + (COLUMN + 0.5) / SHAPE[1]
    np.testing.assert_allclose((lit - 1.0) * light[:, None], plain - 1.0, atol=1e-5)


def test_a_reader_mends_what_a_map_reads_too_flat() -> None:
    shown = MODEL.at(COLUMN, ROW).shown(TRUE).astype(np.float32)
    flat = cast(InverseMap, SimpleNamespace(predict=lambda *_: 0.9 * TRUE))
    reader = QuadricReader(flat, MODEL)
    read = reader.predict(shown, COLUMN.astype(np.float32), ROW.astype(np.float32))
    np.testing.assert_allclose(read, TRUE, atol=1e-3)
    assert reader.in_frame(cast(NormalizedImage, None)) is reader
