"""Slopes of a cone that a map reads wrong, under lamps that are known as a whole; rays are drawn one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from point_lamps import point_lamps
from scipy.ndimage import distance_transform_edt

from device.imaging.flat_field import NormalizedImage
from device.surface.fields import GradientField
from host_sync.integration.integrate import integrate
from host_sync.lights.half_shadow import ArrivingLight
from host_sync.lights.lamp_model import POINTS, FittedLamps, LampModel
from host_sync.lights.lamp_slopes import KnownBefore, LampSkin, move_towards
from host_sync.reconstruction import lamp_cells, lamp_reading
from host_sync.reconstruction.lamp_cells import HiddenLights, LampCells
from host_sync.reconstruction.lamp_reading import SHADOW_WEIGHT, read_under_lamps
from host_sync.reconstruction.light_elevation import Rise

SHAPE = (240, 320)
HEIGHT_PX = 16.0
GRAZED_PX = 16
"""From a shadow's border to where no ray grazes the skin any more."""

MODEL = replace(
    point_lamps(SHAPE, np.array([[0.62, 0.0, 0.34], [-0.31, 0.54, 0.34], [-0.31, -0.54, 0.34]])),
    mixing=np.eye(3) + 0.08 * (1.0 - np.eye(3)),
    haze=np.full(3, 0.01),
    roughness=0.3,
)
LAMPS = FittedLamps(MODEL, ())
EVERYWHERE = np.ones(SHAPE, bool)
ROW, COLUMN = (axis.astype(np.float64) for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])


def cone(flank: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of a blunt cone on flat skin, px, and its slopes."""
    distance = np.hypot(COLUMN - 0.5 * (SHAPE[1] - 1), ROW - 0.5 * (SHAPE[0] - 1))
    z = np.clip(HEIGHT_PX + flank * 30.0 - flank * distance, 0.0, HEIGHT_PX)
    q, p = np.gradient(z)
    return z, p, q


def reaches(z: np.ndarray, places: np.ndarray = MODEL.position) -> np.ndarray:
    """Whether each lamp, or a point of it, reaches the skin, ray by ray: shape (H, W, 3)."""
    lit = np.ones((*SHAPE, 3), bool)
    for lamp, (right, down, up) in enumerate(SHAPE[1] * places):
        to_x, to_y, to_z = right + 0.5 * (SHAPE[1] - 1) - COLUMN, down + 0.5 * (SHAPE[0] - 1) - ROW, up - z
        for share in np.linspace(0.004, 0.4, 120):
            at_x = np.clip(np.rint(COLUMN + share * to_x).astype(int), 0, SHAPE[1] - 1)
            at_y = np.clip(np.rint(ROW + share * to_y).astype(int), 0, SHAPE[0] - 1)
            lit[..., lamp] &= z[at_y, at_x] <= z + share * to_z + 0.3
    return lit


def image_of(
    z: np.ndarray, p: np.ndarray, q: np.ndarray, lit: np.ndarray | None = None, model: LampModel = MODEL
) -> NormalizedImage:
    """lit : how much of lamps (H, W, 3), or of points of them (H, W, 3, points), reaches the skin."""
    flat = [part.ravel() for part in (p, q, COLUMN, ROW, z)]
    visible = None
    if lit is not None:
        points = lit if lit.ndim == 4 else np.repeat(lit[..., None], len(POINTS), axis=-1)
        visible = np.ascontiguousarray(points.reshape(-1, *points.shape[2:]), np.float64)
    own = model.own_light(*flat, visible)
    level = np.zeros(z.size)
    rest = model.mixed(model.own_light(level, level, flat[2], flat[3], level))
    values = (model.mixed(own) / rest).reshape(*SHAPE, 3)
    return NormalizedImage(values.astype(np.float32), EVERYWHERE, ~EVERYWHERE)


def field(p: np.ndarray, q: np.ndarray) -> GradientField:
    return GradientField(p.astype(np.float32), q.astype(np.float32), EVERYWHERE, np.ones(SHAPE, np.float32))


def height_px(gradients: GradientField) -> float:
    height, _ = integrate(gradients, 1.0)
    z, _, _ = cone(0.3)
    border = np.concatenate([height.z_um[:10].ravel(), height.z_um[-10:].ravel()])
    return float(np.median(height.z_um[z > 0.99 * HEIGHT_PX]) - np.median(border))


def test_what_a_map_reads_too_flat_is_mended_where_skin_slopes() -> None:
    z, p, q = cone(0.3)
    misread = 0.004 * np.cos(2.0 * np.pi * COLUMN / 40.0)
    read = field(0.9 * p + misread, 0.9 * q)
    found = read_under_lamps(read, image_of(z, p, q), LAMPS)
    before = height_px(read)
    found.apply(read)
    assert np.abs(read.p[:20, :80]).max() < 0.2 * misread.max()
    assert before < 0.93 * HEIGHT_PX
    assert abs(height_px(read) - HEIGHT_PX) < 0.01 * HEIGHT_PX
    assert found.unsure is None


@pytest.mark.parametrize("flank", [0.6, 0.8])
def test_skin_in_shadow_is_told_by_the_lamps_that_reach_it(flank: float) -> None:
    z, p, q = cone(flank)
    lit = reaches(z)
    dark = ~lit.all(axis=-1)
    assert 0.02 < dark.mean() < 0.3
    read = field(np.where(dark, 1.5 * p + 0.2 * np.sign(p), p), np.where(dark, 1.5 * q + 0.2 * np.sign(q), q))
    wrong, too_high_px = np.hypot(read.p - p, read.q - q)[dark].mean(), height_px(read) - HEIGHT_PX
    found = read_under_lamps(read, image_of(z, p, q, lit), LAMPS)
    found.apply(read)
    assert np.hypot(read.p - p, read.q - q)[dark].mean() < 0.2 * wrong
    assert abs(height_px(read) - HEIGHT_PX) < 0.032 * too_high_px
    assert read.weight.min() < SHADOW_WEIGHT + 0.02
    beyond = distance_transform_edt(~dark) > GRAZED_PX
    assert (read.weight[beyond] > 0.9).mean() > 0.9
    sigma_p, _ = found.sigma((SHAPE[1], SHAPE[0]))
    assert np.abs(sigma_p[dark]).mean() > 10.0 * np.abs(sigma_p[~dark]).mean()


def test_slopes_in_shadow_have_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    z, p, q = cone(1.0)
    lit = reaches(z)
    found_px = []
    for rounds in (lamp_reading.SHADOW_ROUNDS, 3 * lamp_reading.SHADOW_ROUNDS):
        monkeypatch.setattr(lamp_reading, "SHADOW_ROUNDS", rounds)
        read = field(p, q)
        found = read_under_lamps(read, image_of(z, p, q, lit), LAMPS)
        found.apply(read)
        found_px.append(height_px(read))
    assert found_px[0] == pytest.approx(found_px[1], rel=0.015)


def test_frames_of_single_lights_show_where_one_does_not_arrive() -> None:
    z, p, q = cone(0.3)
    dark = (COLUMN > 200) & (COLUMN < 230)
    lit = np.repeat(~dark[..., None], 3, axis=-1) | np.array([False, True, True])
    alone = lit.astype(np.float32)
    image = image_of(z, p, q, lit)
    read = field(np.where(dark, p + 0.4, p), q)
    found = read_under_lamps(read, image, LAMPS, alone)
    assert found.shadow[:, 104:112].min() > 0.5
    assert found.shadow[:, :90].mean() < 0.02


def test_saturated_pixels_and_holes_are_left_as_they_are_read() -> None:
    z, p, q = cone(0.3)
    image = image_of(z, p, q)
    clipped, hole = (COLUMN > 200) & (ROW < 120), (COLUMN < 110) & (ROW < 90)
    values = np.where(hole[..., None], np.float32(np.nan), image.values)
    broken = NormalizedImage(values, ~hole, clipped)
    read = field(0.9 * p, 0.9 * q)
    read = replace(read, valid=~hole, weight=np.where(hole, 0.0, 1.0).astype(np.float32))
    before = read.p.copy()
    found = read_under_lamps(read, broken, LAMPS)
    assert np.isfinite(found.p).all()
    assert found.left_alone is not None
    np.testing.assert_array_equal(found.left_alone[:58, 102:], 1.0)
    assert not found.left_alone[62:].any()
    found.apply(read)
    np.testing.assert_array_equal(read.p[:110, 210:], before[:110, 210:])
    flank = (np.hypot(p, q) > 0.2) & ~hole & ~((COLUMN > 190) & (ROW < 130))
    assert np.abs(read.p - p)[flank].mean() < 0.6 * np.abs(before - p)[flank].mean()


def test_noise_leans_level_skin_to_no_side() -> None:
    rough = replace(MODEL, roughness=0.6)
    noise = 0.02 * np.random.default_rng(3).standard_normal((*SHAPE, 3))
    image = NormalizedImage((1.0 + noise).astype(np.float32), EVERYWHERE, ~EVERYWHERE)
    size = (SHAPE[0] // 2, SHAPE[1] // 2)
    cells = LampCells.of(image, rough, size, 2, None, np.zeros((*size, 2)))
    count = size[0] * size[1]
    start, level = np.zeros((count, 2)), np.zeros(count)
    one_by_one = move_towards(cells.skin, cells.intensity, start, level, KnownBefore(start, 0.15), 6)
    one_by_one = one_by_one.reshape(*size, 2)
    left = slice(None), slice(0, 50)
    found = cells.linearised(one_by_one, np.ones(size, bool), np.zeros(size, np.float32), None)
    assert np.linalg.norm(one_by_one[left].mean(axis=(0, 1))) > 8e-4
    assert np.linalg.norm(found[left].mean(axis=(0, 1))) < 4e-4


def test_a_strip_that_is_half_hidden_is_known_by_the_half_that_is_seen() -> None:
    strip = replace(MODEL, strip=0.5, roughness=0.0)
    skin = LampSkin.at(strip, np.array([160.0]), np.array([120.0]))
    slope, level = np.array([[0.3, -0.1]]), np.zeros(1)
    outer, lamp = np.ones((2, 1, 3, 3))
    outer[0, 1, 2] = lamp[0, 1] = 0.0
    all_of_it, part, none = (
        replace(skin, visible=visible).shown(slope, level)[0, 1] for visible in (None, outer, lamp)
    )
    places = SHAPE[1] * strip.points()[1]
    away = places[:, :3] - np.array([160.0 - 159.5, 120.0 - 119.5, 0.0])
    distance = np.linalg.norm(away, axis=1)
    lit = places[:, 3] * np.maximum(away @ np.array([-0.3, 0.1, 1.0]), 0.0) / distance**3
    gone = (all_of_it - part) / (all_of_it - none)
    assert gone == pytest.approx(lit[2] / lit.sum(), rel=0.01)
    assert gone != pytest.approx(lit[0] / lit.sum(), rel=0.01)


def test_a_channel_counts_as_far_as_what_arrives_of_its_lamp_is_known() -> None:
    def weight(visible: float, arriving: float = 1.0) -> float:
        lights = HiddenLights(
            np.ones((1, 1, 3), bool), np.full((1, 1, 3), arriving), np.full((1, 1, 3, len(POINTS)), visible)
        )
        weights = lights.weight(np.full((1, 3), 0.8), np.array([0]))
        assert (weights == weights[0, 0]).all()
        return float(weights[0, 0])

    assert weight(1.0) == 1.0
    assert weight(0.0) == 0.0
    assert weight(1.0, arriving=0.4) == 0.4
    assert weight(0.5) < 0.01
    assert weight(0.0, arriving=0.4) == 0.0


def test_a_cell_is_dimmed_where_a_light_that_may_be_hidden_does_not_arrive() -> None:
    hidden = np.zeros((1, 4, 3), bool)
    hidden[0, 1:, 0] = True
    arriving, visible = np.ones((1, 4, 3)), np.ones((1, 4, 3, len(POINTS)))
    visible[0, 2, 0, 1] = 0.5
    arriving[0, 3, 0] = visible[0, 0, 0, 0] = visible[0, 1, 2, 0] = 0.0
    np.testing.assert_array_equal(HiddenLights(hidden, arriving, visible).dimmed, [[False, False, True, True]])


def test_skin_in_half_shadow_is_read_from_the_points_that_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read as if all of a lamp arrived, half-shadow is a slope, and what stands in the middle of it stands too high."""
    strip = replace(MODEL, strip=0.5)
    z = cv2.GaussianBlur(cone(0.6)[0], (0, 0), 3.0)
    q, p = np.gradient(z)
    points = np.moveaxis(strip.points()[..., :3], 1, 0)
    along = np.cross(strip.position, [0.0, 0.0, 1.0])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    seen = [[reaches(z, point + step * along) for step in np.linspace(-0.12, 0.12, 5)] for point in points]
    image = image_of(z, p, q, np.moveaxis(np.mean(seen, axis=1), 0, -1), strip)
    skin, level = LampSkin.at(strip, COLUMN.ravel(), ROW.ravel()), np.zeros(z.size)
    slope, values = np.zeros((z.size, 2)), image.values.reshape(-1, 3).astype(np.float64)
    for _ in range(6):
        slope = move_towards(skin, values, slope, level, KnownBefore(slope, 0.15), 1)
    as_if_lit = slope.reshape(*SHAPE, 2)

    def too_high_px() -> float:
        read = field(as_if_lit[..., 0], as_if_lit[..., 1])
        assert height_px(read) > 1.05 * HEIGHT_PX
        read_under_lamps(read, image, FittedLamps(strip, ())).apply(read)
        return abs(height_px(read) - HEIGHT_PX)

    known = too_high_px()
    plain = lamp_cells.arriving_light

    def all_of_it(*surface: Any) -> ArrivingLight:
        light = plain(*surface)
        return replace(light, visible=np.ones_like(light.visible))

    monkeypatch.setattr(lamp_cells, "arriving_light", all_of_it)
    assert known < 0.4 * too_high_px()


def test_level_skin_gains_nothing() -> None:
    zero = np.zeros(SHAPE)
    found = read_under_lamps(field(zero, zero), image_of(zero, zero, zero), LAMPS)
    np.testing.assert_allclose([found.p, found.q], 0.0, atol=1e-6)
    assert not found.shadow.any()


def test_slopes_are_as_unsure_as_lamps_of_fewer_balls_differ() -> None:
    z, p, q = cone(0.3)
    higher, lower = (replace(MODEL, position=MODEL.position * [1.0, 1.0, 1.0 + change]) for change in (0.02, -0.02))
    found = read_under_lamps(field(p, q), image_of(z, p, q), FittedLamps(MODEL, (higher, lower)))
    assert found.unsure is not None
    flank = np.hypot(*(part[::2, ::2][: found.p.shape[0], : found.p.shape[1]] for part in (p, q))) > 0.2
    by_p, by_q = found.unsure()
    sigma = np.sqrt((by_p**2 + by_q**2).sum(axis=0))
    assert 0.002 < sigma[flank].mean() < 0.02
    assert not sigma[:4].any()


def texture() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of waves that fill the field, px, and its slopes, 4 degrees steep on the mean."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(SHAPE[1]), np.fft.fftfreq(SHAPE[0])))
    band = (frequency > 1 / 80) & (frequency < 1 / 16)
    z = np.fft.ifft2(np.fft.fft2(np.random.default_rng(0).standard_normal(SHAPE)) * band).real
    z *= 0.05 / np.hypot(*np.gradient(z)).std()
    q, p = np.gradient(z)
    return z - np.median(z), p, q


def as_if_untouched(image: NormalizedImage) -> GradientField:
    """Slopes that the same lamps read at the elevation of untouched skin."""
    skin = LampSkin.at(MODEL, COLUMN.ravel(), ROW.ravel())
    seen, level = image.values.reshape(-1, 3).astype(np.float64), np.zeros(ROW.size)
    slope = np.zeros((ROW.size, 2))
    for _ in range(4):
        slope = move_towards(skin, seen, slope, level, KnownBefore(slope, 1.0), 1)
    p, q = slope.T.reshape(2, *SHAPE)
    return field(p, q)


@pytest.mark.parametrize("drift", [(1.0, 1.0, 1.0), (0.98, 1.0, 1.01)])
def test_texture_that_fills_the_field_is_read_under_the_light_that_it_tells_itself(drift: tuple[float, ...]) -> None:
    z, p, q = texture()
    risen_px = 5.0
    image = image_of(z + risen_px, p, q)
    noise = 0.005 * np.random.default_rng(1).standard_normal(image.values.shape)
    image = replace(image, values=np.asarray((image.values + noise) * drift, np.float32))
    read = as_if_untouched(image)
    off_px = (integrate(read, 1.0)[0].z_um - z).std()
    found = read_under_lamps(read, image, LAMPS)
    found.apply(read)
    left_px = (integrate(read, 1.0)[0].z_um - z).std()
    assert off_px > 0.3
    assert left_px < 0.3 * off_px


@pytest.mark.parametrize("tilt", [0.0, 0.01])
def test_a_plate_under_the_whole_field_is_no_untouched_skin(tilt: float) -> None:
    p, q = np.full(SHAPE, tilt), np.zeros(SHAPE)
    z = 6.0 + tilt * (COLUMN - 160.0)
    image = image_of(z, p, q)
    noise = 0.003 * np.random.default_rng(1).standard_normal(image.values.shape)
    image = replace(image, values=np.asarray(image.values + noise, np.float32))
    read = as_if_untouched(image)
    off_px = (integrate(read, 1.0)[0].z_um - z).std()
    found = read_under_lamps(read, image, FittedLamps(MODEL, (MODEL, MODEL)))
    assert not found.has_rest
    assert found.unsure is not None
    assert (np.abs(found.unsure()[0]).max(axis=0) > 0.0).mean() > 0.95
    found.apply(read)
    assert (integrate(read, 1.0)[0].z_um - z).std() < 0.3 * off_px


def test_untouched_skin_is_no_plate() -> None:
    zero = np.zeros(SHAPE)
    image = image_of(zero, zero, zero)
    noise = 0.003 * np.random.default_rng(1).standard_normal(image.values.shape)
    image = replace(image, values=np.asarray(image.values + noise, np.float32))
    found = read_under_lamps(as_if_untouched(image), image, LAMPS)
    assert found.has_rest


def test_slopes_are_as_unsure_as_the_elevation_that_the_light_tells() -> None:
    z, p, q = texture()
    image = image_of(z, p, q)
    cells = LampCells.of(image, MODEL, (120, 160), 2, None, np.zeros((120, 160, 2)))
    slope = np.stack([p, q], axis=-1).reshape(120, 2, 160, 2, 2).mean(axis=(1, 3))
    z_px = z.reshape(120, 2, 160, 2).mean(axis=(1, 3)).astype(np.float32)
    parts = np.zeros((4, 4))
    parts[:, 0] = [-1.0, 1.0, -1.0, 1.0]
    rise = Rise(0.0, np.zeros(3), parts)
    by_p, by_q = cells.unsure(slope, z_px, (MODEL, MODEL), rise)
    sigma = np.sqrt((by_p**2).sum(axis=0) + (by_q**2).sum(axis=0))
    there, seen = slope.reshape(-1, 2), cells.skin.shown(slope.reshape(-1, 2), z_px.ravel().astype(float))
    higher = z_px.ravel() + rise.sigma_px
    found = there
    for _ in range(3):
        found = move_towards(cells.skin, seen, found, higher.astype(float), KnownBefore(found, 1.0), 1)
    moved = np.linalg.norm(found - there, axis=1).reshape(sigma.shape)
    assert np.median(sigma / moved) == pytest.approx(1.0, abs=0.1)
