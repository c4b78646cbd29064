"""Light models that are fitted to balls: frames come from a renderer of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from matt_light import lamp_places
from near_lamps import SHAPE, NearLamps, balls, press_px

from device.balls.sphere import Ball, Viewpoint, gather_samples, pixels_inside, sphere_slopes
from device.imaging.flat_field import NormalizedImage
from host_sync.light.bundle import Bundle
from host_sync.light.fit import FittedLight, fit_light
from host_sync.light.kernel_derivatives import Jacobian
from host_sync.light.model import LightModel

HEIGHT_PX = 220.0
NOISE = 0.005
LAMPS = NearLamps(HEIGHT_PX)
TRUE = balls()
APEXES = [apex for _, apex in TRUE]
OFF_PX = np.random.default_rng(3).uniform(-1.0, 1.0, (len(TRUE), 2))
MOVED = [
    replace(ball, column=ball.column + off[0], row=ball.row + off[1], contact_radius_px=24.0)
    for (ball, _), off in zip(TRUE, OFF_PX.tolist(), strict=True)
]
"""Balls whose centres are off by up to a pixel."""

NEW = Ball(140.0, 150.0, 28.0, TRUE[0][0].radius_px)
"""A ball that no fit sees."""


def rendered(ball: Ball, apex_px: float, seed: int) -> NormalizedImage:
    return LAMPS.intensity(press_px(ball, apex_px), noise=NOISE, seed=seed)


def unlike_lamps(ball: Ball, seed: int) -> NormalizedImage:
    """Return light that no lamp gives: its direction turns over the field, and both sides of a slope are bright."""
    row, column = (axis.astype(np.float32) for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    p, q = sphere_slopes(ball, column, row)
    turn = 2.0 * column / SHAPE[1] + np.radians([0.0, 120.0, 240.0])[:, None, None]
    tilt = 1.0 - 1.0 / np.sqrt(1.0 + p**2 + q**2)
    along = p * np.cos(turn) + q * np.sin(turn)
    values = 1.0 + np.tanh(0.8 * along) - 0.3 * tilt + 0.8 * along**2 / (1.0 + p**2 + q**2)
    inside = np.hypot(column - ball.column, row - ball.row) < ball.contact_radius_px
    values = np.moveaxis(np.where(inside, values, 1.0), 0, -1)
    values = values + NOISE * np.random.default_rng(seed).standard_normal(values.shape)
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def fitted(images: Sequence[NormalizedImage], positions: np.ndarray | None = None) -> FittedLight:
    """Return the fit to the moved balls; as the renderers have it no light comes from skin around."""
    samples = gather_samples(((image, [ball]) for image, ball in zip(images, MOVED, strict=True)), for_fit=True)
    return fit_light(samples, lambda _: np.zeros((len(samples.p), 3)), MOVED, APEXES, SHAPE, positions)


@cache
def near_lamps() -> FittedLight:
    return fitted([rendered(ball, apex, seed) for seed, (ball, apex) in enumerate(TRUE)])


@cache
def other_light() -> FittedLight:
    return fitted([unlike_lamps(ball, seed) for seed, (ball, _) in enumerate(TRUE)])


@dataclass(frozen=True)
class ShinyLamps(NearLamps):
    """Lamps over skin with a lobe about the half vector (Blinn, 1977), under a camera one width of the field away."""

    def light(self, z_px: np.ndarray, p: np.ndarray, q: np.ndarray, *, seen_at: float = 1.0) -> np.ndarray:
        matt = super().light(z_px, p, q, seen_at=seen_at)
        row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
        here = np.stack([column - 0.5 * (SHAPE[1] - 1), row - 0.5 * (SHAPE[0] - 1), z_px], axis=-1)
        normal = unit(np.stack([-p, -q, np.ones_like(p)], axis=-1))
        to_camera = unit(np.array([0.0, 0.0, SHAPE[1]]) - here)
        lobes = [
            np.maximum((unit(unit(SHAPE[1] * lamp - here) + to_camera) * normal).sum(axis=-1), 0.0) ** 12
            for lamp in lamp_places(self.height_px)
        ]
        return np.asarray(matt * (1.0 + 1.5 * np.stack(lobes, axis=-1)))


def unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def test_shiny_balls_show_how_near_the_camera_is() -> None:
    lamps = ShinyLamps(HEIGHT_PX)
    images = [lamps.intensity(press_px(*one), noise=NOISE, seed=seed) for seed, one in enumerate(TRUE)]
    light = fitted(images)
    assert light.has_sources
    assert 0.7 < light.model.camera < 1.4
    error = error_on(light.model, lamps.intensity(press_px(NEW, 16.0)), NEW, 16.0)
    assert (error < 2.0 * light.model.sigma).all()


def test_a_known_height_of_the_camera_is_kept() -> None:
    viewpoint = Viewpoint(0.5 * SHAPE[1], 0.5 * SHAPE[0], 2.0 * SHAPE[1])
    known = [replace(ball, viewpoint=viewpoint) for ball in MOVED]
    images = [rendered(ball, apex, seed) for seed, (ball, apex) in enumerate(TRUE)]
    samples = gather_samples(((image, [ball]) for image, ball in zip(images, known, strict=True)), for_fit=True)
    bundle = Bundle.of(samples, known, APEXES, SHAPE)
    found = bundle.solve(bundle.start(0.35, 0.45, None))
    assert bundle.model(found).camera == pytest.approx(0.5, abs=1e-6)


def error_on(model: LightModel, image: NormalizedImage, ball: Ball, apex_px: float) -> np.ndarray:
    """Return the root mean square error of the predicted intensity of a ball's pixels, by channel."""
    row, column = pixels_inside(replace(ball, contact_radius_px=22.0), SHAPE)
    slope = np.stack(sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32)), -1).astype(np.float64)
    z_px = apex_px - ball.radius_px * (1.0 - 1.0 / np.sqrt(1.0 + (slope**2).sum(axis=1)))
    places = model.places(column.astype(np.float64), row.astype(np.float64), z_px)
    shown = model.intensity(slope, places, np.zeros((len(row), 3)))
    return np.asarray(np.sqrt(np.square(shown - image.values[row, column]).mean(axis=0)))


def brightest_sources(model: LightModel) -> np.ndarray:
    """Return the place of the source that each channel shows most of, in pixels of the field."""
    return SHAPE[1] * model.sources[model.strengths.argmax(axis=1), :3]


def test_balls_show_where_the_lamps_stand() -> None:
    place, truth = brightest_sources(near_lamps().model), SHAPE[1] * lamp_places(HEIGHT_PX)
    np.testing.assert_allclose(place[:, 2], HEIGHT_PX, rtol=0.05)
    np.testing.assert_allclose(np.hypot(*place[:, :2].T), np.hypot(*truth[:, :2].T), rtol=0.05)
    angle, true_angle = (np.degrees(np.arctan2(at[:, 1], at[:, 0])) % 360.0 for at in (place, truth))
    np.testing.assert_allclose(angle, true_angle, atol=2.0)
    assert near_lamps().model.believed_fraction(0.02) > 0.9


def test_balls_show_where_their_centres_are() -> None:
    left = OFF_PX + near_lamps().shift_px
    assert float(np.sqrt((left**2).mean())) < 0.35 * float(np.sqrt((OFF_PX**2).mean()))


def test_stated_lamps_are_kept_where_balls_confirm_them() -> None:
    images = [rendered(ball, apex, seed) for seed, (ball, apex) in enumerate(TRUE)]
    truth = lamp_places(HEIGHT_PX)
    place = brightest_sources(fitted(images, truth).model) / SHAPE[1]
    assert np.linalg.norm(place - truth, axis=1).max() < 0.05 * np.linalg.norm(truth, axis=1).min()


def test_a_ball_that_was_not_seen_is_predicted_to_the_error_that_is_stated() -> None:
    light, image = near_lamps(), LAMPS.intensity(press_px(NEW, 16.0))
    error = error_on(light.model, image, NEW, 16.0)
    assert (error < 2.0 * light.model.sigma).all()
    assert (light.model.sigma < 0.05).all()


@pytest.mark.slow
def test_light_that_a_polynomial_describes_better_has_no_sources() -> None:
    light = other_light()
    assert not light.has_sources
    assert light.model.believed_fraction(0.02) == pytest.approx(0.0)
    assert len(light.folds) > 1


def test_without_a_fold_of_balls_lamps_stand_a_little_elsewhere() -> None:
    light = near_lamps()
    assert len(light.folds) > 1
    assert light.without(0) is light.without(len(light.folds))
    for number, fold in enumerate(light.folds):
        image, (ball, apex) = LAMPS.intensity(press_px(*TRUE[number])), TRUE[number]
        own, seen = (error_on(one, image, ball, apex) for one in (fold, light.model))
        assert (own != seen).all()
        assert (own < 3.0 * fold.sigma).all()


def test_a_fit_for_frames_of_another_size_describes_the_same_light() -> None:
    light = near_lamps()
    half = light.for_shape((SHAPE[0] // 2, SHAPE[1] // 2))
    zero, slope = np.zeros(1), np.array([[0.2, -0.1]])
    for own, other in zip((light.model, *light.folds), (half.model, *half.folds), strict=True):
        dark, at = np.zeros((1, 3)), own.places(np.array([40.5]), np.array([60.5]), zero)
        of_half = other.places(np.array([20.0]), np.array([30.0]), zero)
        np.testing.assert_allclose(own.intensity(slope, at, dark), other.intensity(slope, of_half, dark), rtol=1e-9)


def test_normal_equations_are_those_of_the_whole_jacobian() -> None:
    rng = np.random.default_rng(3)
    count, channels, balls, own = 60, 3, 4, 5
    ball = rng.integers(balls, size=count)
    shared, by_shift = rng.normal(size=(count, channels, 6)), rng.normal(size=(count, channels, 2))
    features, error = rng.normal(size=(count, own)), rng.normal(size=(count, channels))
    weight, rows = rng.uniform(0.5, 2.0, (count, channels)), ball % 2 == 1
    system, gradient = Jacobian(shared, by_shift, ball, balls, features, error, weight).normal_equations(rows)
    of_balls = (ball[:, None, None, None] == np.arange(balls)[:, None]) * by_shift[:, :, None]
    of_channels = np.eye(channels)[None, :, :, None] * features[:, None, None]
    parts = (shared, of_balls.reshape(count, channels, -1), of_channels.reshape(count, channels, -1))
    whole = np.concatenate(parts, axis=-1)[rows].reshape(-1, 6 + 2 * balls + channels * own)
    weighted = whole.T * weight[rows].ravel()
    np.testing.assert_allclose(system, weighted @ whole, atol=1e-12)
    np.testing.assert_allclose(gradient, weighted @ error[rows].ravel(), atol=1e-12)


def test_derivatives_are_those_of_the_errors() -> None:
    images = [rendered(ball, apex, seed) for seed, (ball, apex) in enumerate(TRUE)]
    samples = gather_samples((image, [ball]) for image, ball in zip(images, MOVED, strict=True))
    bundle = Bundle.of(samples, MOVED, APEXES, SHAPE)
    begun = bundle.start(0.5, 0.3, None)
    numbers = replace(begun, haze=np.full(3, 0.05), coat=begun.coat + 0.05, extent=np.full((3, 2), 0.3))
    _, _, found = bundle._system(numbers)
    values = numbers.packed()
    # Sources and coat come first, then the centres.
    of_centres = (found.ball[:, None, None] == np.arange(found.balls))[..., None] * found.by_shift[:, :, None]
    derivatives = np.concatenate([found.shared, of_centres.reshape(*found.error.shape, -1)], axis=-1)
    for number in range(derivatives.shape[-1]):
        step = np.zeros_like(values)
        step[number] = 1e-4 * max(1.0, abs(values[number]))
        ahead, behind = (bundle.errors(numbers.unpacked(values + sign * step)) for sign in (1.0, -1.0))
        wanted = (ahead - behind) / (2.0 * step[number])
        assert np.linalg.norm(derivatives[..., number] - wanted) < 0.05 * np.linalg.norm(wanted) + 1e-6, number
