"""Light that agrees with untouched skin within the noise of presses is skin at rest; slopes and texture are not."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.skin_at_rest import RestEvidence, SkinAtRest

SHAPE = 192, 256
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
SHINING = np.stack([0.1 + 0.4 * COLUMN / SHAPE[1], 0.3 + 0.0 * COLUMN, 0.4 - 0.2 * ROW / SHAPE[0]], axis=-1)
DIRECTIONS = np.array([[1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9]])
NOISE = 0.02


def seen(p: Any = 0.0, q: Any = 0.0, *, seed: int, gain: float = 1.0, offset: float = 0.0) -> NormalizedImage:
    """Intensity of skin with slopes p and q, under other lights and with noise."""
    rng = np.random.default_rng(seed)
    slopes = np.stack(np.broadcast_arrays(p + 0.0 * ROW, q + 0.0 * ROW), axis=-1)
    light = gain * np.exp(slopes @ DIRECTIONS.T) + offset / SHINING
    values = light * (1.0 + NOISE * rng.standard_normal((*SHAPE, 3)))
    everywhere = np.ones(SHAPE, np.bool_)
    return NormalizedImage(values.astype(np.float32), everywhere, ~everywhere)


def ball_slopes(column: float, row: float, contact_px: float = 15.0, radius_px: float = 30.0) -> tuple[Any, Any]:
    across, down = COLUMN - column, ROW - row
    inside = np.hypot(across, down) < contact_px
    depth = np.sqrt(np.maximum(radius_px**2 - across**2 - down**2, 1.0))
    return np.where(inside, -across / depth, 0.0), np.where(inside, -down / depth, 0.0)


def kept_of(evidence: RestEvidence) -> np.ndarray:
    """Fraction that a slope keeps at every pixel."""
    return cv2.resize(evidence.kept, SHAPE[::-1], interpolation=cv2.INTER_LINEAR)


@pytest.fixture(scope="module")
def model() -> SkinAtRest:
    presses = []
    for number, (column, row) in enumerate([(60, 60), (190, 60), (60, 130), (190, 130), (128, 96)]):
        image = seen(*ball_slopes(column, row), seed=number, gain=1.0 + 0.004 * (number - 2))
        presses.append((image, [Ball(column, row, 15.0, 30.0)]))
    found = SkinAtRest.of(presses, SHINING.astype(np.float32))
    assert found is not None
    return found


def test_noise_is_skin_at_rest(model: SkinAtRest) -> None:
    assert model.evidence(seen(seed=20)).fraction > 0.95


def test_gain_and_offset_of_a_frame_are_fitted(model: SkinAtRest) -> None:
    found = model.evidence(seen(seed=21, gain=0.99, offset=0.002))
    brightness = model.darkness.mean(axis=(0, 1))
    assert found.fraction > 0.9
    assert found.light.offsets == pytest.approx(np.array([0.002, 0.0, 0.002]), abs=0.0015)
    assert found.light.gains + found.light.offsets * brightness == pytest.approx(0.99 + 0.002 * brightness, abs=0.002)


def test_a_ball_is_not_at_rest_nor_is_its_top(model: SkinAtRest) -> None:
    kept = kept_of(model.evidence(seen(*ball_slopes(128.0, 96.0), seed=22)))
    distance = np.hypot(COLUMN - 128.0, ROW - 96.0)
    assert kept[distance < 12.0].min() > 0.9
    assert kept[distance > 40.0].mean() < 0.05


def test_gentle_slopes_that_neighbours_share_are_kept(model: SkinAtRest) -> None:
    # A slope of 0.004 changes light by 0.4 %: less than the noise of a cell of 16 pixels, more than that of many cells.
    within = (np.abs(COLUMN - 128.0) < 40.0) & (np.abs(ROW - 96.0) < 40.0)
    kept = kept_of(model.evidence(seen(np.where(within, 0.006, 0.0), 0.0, seed=23)))
    assert np.median(kept[within]) > 0.4
    assert np.median(kept[~within]) < 0.05


def test_fine_texture_without_mean_slope_is_not_at_rest(model: SkinAtRest) -> None:
    within = np.abs(COLUMN - 128.0) < 40.0
    texture = np.where(within, 0.1 * np.sin(2.0 * np.pi * COLUMN / 4.0), 0.0)
    kept = kept_of(model.evidence(seen(texture, seed=24)))
    assert np.median(kept[within]) > 0.5
    assert np.median(kept[~within]) < 0.05


def test_presses_that_differ_make_shrinkage_wide(model: SkinAtRest) -> None:
    presses = []
    for number, (column, row) in enumerate([(60, 60), (190, 60), (60, 130), (190, 130)]):
        wave = 0.05 * np.sin(ROW / 20.0 + number)
        presses.append((seen(wave, 0.0, seed=number), [Ball(column, row, 15.0, 30.0)]))
    restless = SkinAtRest.of(presses, SHINING.astype(np.float32))
    assert restless is not None
    frame = seen(0.03 * np.sin(ROW / 20.0 + 0.5), 0.0, seed=30)
    assert restless.evidence(frame).fraction > 0.8
    assert model.evidence(frame).fraction < 0.4


def test_without_free_skin_noise_is_assumed() -> None:
    found = SkinAtRest.of([], SHINING.astype(np.float32))
    assert found is not None
    assert found.evidence(seen(seed=31)).fraction > 0.9
    assert SkinAtRest.of([], np.full((8, 8, 3), 0.3, np.float32)) is None
