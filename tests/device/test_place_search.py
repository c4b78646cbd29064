"""The coarse search: right places first, and none that stands out where two maps have nothing in common."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from device.align import APART_PX, PlaceSearch, Pose, is_apart, relief_slopes, seen_at
from device.surface import Float32Array

SHAPE = (90, 120)
TURNS_DEG = tuple(range(-15, 16, 3))
FINE_PX = 2.0


def texture(size_px: float, seed: int) -> Float32Array:
    """A surface three times as large as the maps that are cut out of it."""
    random = np.random.default_rng(seed)
    shape = (3 * SHAPE[0], 3 * SHAPE[1])
    z_um = cv2.GaussianBlur(random.standard_normal(shape).astype(np.float32), (0, 0), size_px)
    return np.asarray(10.0 * z_um / z_um.std(), np.float32)


def bumps(seed: int) -> Float32Array:
    """Some twenty bumps on each map."""
    random = np.random.default_rng(seed)
    z_um = np.zeros((3 * SHAPE[0], 3 * SHAPE[1]), np.float32)
    for row, column in random.integers(0, z_um.shape, (180, 2)):
        z_um[row, column] = 2000.0
    return cv2.GaussianBlur(z_um, (0, 0), 3.0)


def cut(surface: Float32Array, pose: Pose, shape: tuple[int, int] = SHAPE) -> Float32Array:
    """The map of a surface whose middle lies at a pose, with tilt and noise."""
    random = np.random.default_rng(5)
    row, column = np.meshgrid(*(np.arange(size) - 0.5 * (size - 1) for size in shape), indexing="ij")
    at = pose.of(np.stack([row, column], axis=-1)) + 0.5 * (np.array(surface.shape) - 1)
    seen = cv2.remap(surface, at[..., 1].astype(np.float32), at[..., 0].astype(np.float32), cv2.INTER_LINEAR)
    return np.asarray(seen + 0.3 * row + random.normal(0.0, 0.3, shape), np.float32)


@pytest.mark.parametrize("kind", ["fine", "sparse"])
@pytest.mark.parametrize("seed", range(4))
def test_the_best_place_is_the_true_one(kind: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    surface = texture(FINE_PX, seed) if kind == "fine" else bumps(seed)
    search = PlaceSearch(SHAPE, TURNS_DEG, 0.1)
    true = Pose(
        random.uniform(-40.0, 40.0), random.uniform(-50.0, 50.0), float(np.radians(random.uniform(-13.0, 13.0)))
    )
    first, second = (relief_slopes(cut(surface, pose))[0] for pose in (Pose(), true.back()))
    found = search.places(search.first(first), search.second(second), 3)
    assert found[0].rank == max(place.rank for place in found)
    assert found[0].pose.distance(true, 0.0) < 3.0
    assert abs(found[0].pose.turn - true.turn) < np.radians(3.1)
    assert all(is_apart(one.pose, found[0].pose) for one in found[1:])
    strange, _ = relief_slopes(cut(texture(FINE_PX, 100 + seed), Pose()))
    assert search.places(search.first(first), search.second(strange), 1)[0].rank < 0.7 * found[0].rank


def test_a_map_of_another_shape_is_placed_by_its_middle() -> None:
    surface = texture(FINE_PX, 7)
    search = PlaceSearch(SHAPE, (0.0,), 0.1)
    first, _ = relief_slopes(cut(surface, Pose()))
    for shape in ((70, 100), (110, 140)):
        second, _ = relief_slopes(cut(surface, Pose(-5.0, 9.0), shape))
        assert search.places(search.first(first), search.second(second), 1)[0].pose == Pose(5.0, -9.0)


def test_only_places_near_the_stated_one_are_given() -> None:
    surface = texture(FINE_PX, 8)
    search = PlaceSearch(SHAPE, (-6.0, 0.0, 6.0), 0.1)
    first, second = (relief_slopes(cut(surface, pose))[0] for pose in (Pose(), Pose(20.0, 30.0)))
    spectra = search.first(first), search.second(second)
    near = np.array([5.0, 5.0]), 8.0
    found = search.places(*spectra, 4, near)
    assert found
    assert all(place.pose.distance(Pose(5.0, 5.0), 0.0) <= 8.0 for place in found)
    assert search.places(*spectra, 4, (np.array([500.0, 0.0]), 8.0)) == []
    assert search.places(*spectra, 1, (np.array([-22.0, -28.0]), 2.0 * APART_PX))[0].pose == Pose(-20.0, -30.0)


def test_slopes_are_zero_where_nothing_is_known_and_state_their_size() -> None:
    z_um = texture(4.0, 9)[: SHAPE[0], : SHAPE[1]].copy()
    slopes, size = relief_slopes(z_um)
    steeper, larger = relief_slopes(np.asarray(3.0 * z_um, np.float32))
    assert larger == pytest.approx(3.0 * size, rel=1e-3)
    assert np.allclose(slopes, steeper, atol=1e-3)
    assert np.abs(slopes).max() < 1.001
    z_um[:30] = np.nan
    assert not relief_slopes(z_um)[0][:28].any()
    assert relief_slopes(np.full(SHAPE, np.nan, np.float32))[1] == 0.0


def test_a_relief_seen_turned_has_turned_slopes() -> None:
    surface, turned = texture(6.0, 10), Pose(3.0, -4.0, float(np.radians(12.0)))
    first, second = (relief_slopes(cut(surface, pose))[0] for pose in (Pose(), turned.back()))
    seen, known = seen_at(second, turned, SHAPE)
    assert 0.7 < known.mean() < 1.0
    assert not seen[~known].any()
    alike = np.vdot(first[known], seen[known]) / np.sqrt(np.vdot(first[known], first[known]) * np.vdot(seen, seen))
    assert alike.real > 0.9
