"""Skin beside a ball, lit by three distant lights of which the ball hides one on each side; rays drawn one by one."""

from __future__ import annotations

import numpy as np
import pytest

from device.balls.sphere import Ball, gather_samples
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import GradientField
from host_sync.calibration.shading_model import ShadingModel, fit_shading_model, measure_leaks
from host_sync.reconstruction.cast_shadow import RELATIVE_SIGMA, clearance, find_cast_shadow

SHAPE = (180, 240)
RADIUS_PX = 60.0
CONTACT_PX = 36.0
SLANT = 1.5
ANGLES = np.radians([-90.0, 30.0, 150.0])
SLANTS = -SLANT * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=-1)
"""Of the lights in R, G and B: away from each, as long as the tangent of its zenith angle."""


def ball_skin(column: float = 120.0, row: float = 90.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of skin over a ball, px, and its slopes: a sphere, then a cone that runs out into flat skin."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    distance = np.hypot(x - column, y - row)
    rim_slope = CONTACT_PX / np.sqrt(RADIUS_PX**2 - CONTACT_PX**2)
    inside = distance < CONTACT_PX
    sphere = np.sqrt(np.maximum(RADIUS_PX**2 - distance**2, 1.0))
    reach = 12.0
    skirt = rim_slope * reach * np.exp(-np.maximum(distance - CONTACT_PX, 0.0) / reach)
    rim = np.sqrt(RADIUS_PX**2 - CONTACT_PX**2)
    z = np.where(inside, rim_slope * reach + sphere - rim, skirt)
    fall = np.where(inside, distance / sphere, skirt / reach)
    unit = np.stack([x - column, y - row]) / np.maximum(distance, 1e-9)
    return z, -fall * unit[0], -fall * unit[1]


def visible(z: np.ndarray, slant: np.ndarray) -> np.ndarray:
    """True where a ray to the light meets no skin, pixel by pixel on the nearest points."""
    rows, columns = z.shape
    seen = np.ones(z.shape, bool)
    towards = -slant / np.linalg.norm(slant)
    y, x = np.mgrid[:rows, :columns]
    for step in range(1, 120):
        at_x = np.clip(np.rint(x + step * towards[0]).astype(int), 0, columns - 1)
        at_y = np.clip(np.rint(y + step * towards[1]).astype(int), 0, rows - 1)
        seen &= z[at_y, at_x] - z < step / np.linalg.norm(slant)
    return seen


def frame(z: np.ndarray, p: np.ndarray, q: np.ndarray, leak: float = 0.0) -> tuple[NormalizedImage, np.ndarray]:
    """Intensity of matt skin, and which lights reach it, bool array of shape (H, W, 3)."""
    lit = np.stack([visible(z, slant) for slant in SLANTS], axis=-1)
    light = np.maximum(1.0 + p[..., None] * SLANTS[:, 0] + q[..., None] * SLANTS[:, 1], 0.0) * lit
    pure = light / np.sqrt(1.0 + p**2 + q**2)[..., None]
    mixed = pure @ ((1.0 - leak) * np.eye(3) + leak * np.ones((3, 3)) - leak * np.eye(3))
    mixed = mixed / (1.0 + leak)
    everywhere = np.ones(SHAPE, bool)
    return NormalizedImage(mixed.astype(np.float32), everywhere, ~everywhere), lit


def lambert_slopes(image: NormalizedImage) -> GradientField:
    """Slopes that three lights would tell if all reached the skin."""
    system = np.concatenate([np.ones((3, 1)), SLANTS], axis=1)
    solved = np.linalg.solve(system, image.values.reshape(-1, 3).T.astype(np.float64))
    p, q = ((solved[k] / np.maximum(solved[0], 0.2)).reshape(SHAPE).astype(np.float32) for k in (1, 2))
    return GradientField(p, q, np.ones(SHAPE, bool), np.ones(SHAPE, np.float32))


@pytest.fixture(scope="module")
def presses() -> list[tuple[NormalizedImage, list[Ball]]]:
    """Twelve balls over the field."""
    places = [(x, y) for y in (50.0, 90.0, 130.0) for x in (50.0, 95.0, 145.0, 190.0)]
    return [(frame(*ball_skin(x, y))[0], [Ball(x, y, CONTACT_PX, RADIUS_PX)]) for x, y in places]


@pytest.fixture(scope="module")
def model(presses: list[tuple[NormalizedImage, list[Ball]]]) -> ShadingModel:
    found = fit_shading_model(gather_samples(presses), presses)
    assert found is not None
    return found


def test_the_model_finds_the_lights(model: ShadingModel) -> None:
    slants = model.at(np.array([[0.0, 0.0], [0.5, -0.5]]))[:, :, :2]
    assert np.abs(slants - SLANTS).max() < 0.03
    assert model.residual < 0.01


def test_few_samples_tell_no_model(presses: list[tuple[NormalizedImage, list[Ball]]]) -> None:
    every = gather_samples(presses)
    few = every.select(np.arange(50))
    assert fit_shading_model(few, presses) is None


def test_a_ray_clears_flat_skin_by_the_light_and_meets_a_wall() -> None:
    z = np.zeros((40, 60), np.float32)
    towards_columns = np.broadcast_to(np.array([-SLANT, 0.0]), (40, 60, 2))
    assert clearance(z, 1.0, towards_columns) == pytest.approx(1.0 / SLANT)
    z[:, 30:34] = 8.0
    clear = clearance(z, 1.0, towards_columns)
    assert (clear[:, 20:29] < 0.0).all()
    assert (clear[:, :15] > 0.0).all()
    assert (clear[:, 36:] > 0.5).all()


def test_slopes_beside_a_ball_are_those_of_the_lights_that_arrive(model: ShadingModel) -> None:
    z, p, q = ball_skin()
    image, lit = frame(z, p, q)
    gradients = lambert_slopes(image)
    dark = ~lit.all(axis=-1)
    assert dark.sum() > 500

    def error() -> tuple[float, float]:
        wrong = np.hypot(gradients.p - p, gradients.q - q)
        return float(wrong[dark].mean()), float(wrong[~dark].mean())

    before = error()
    found = find_cast_shadow(gradients, image, model, None)
    assert found is not None
    found.apply(gradients)
    after = error()
    assert after[0] < 0.5 * before[0]
    assert after[1] < before[1] + 0.01
    assert gradients.weight[dark].mean() < 0.6 < 0.95 < gradients.weight[~dark].mean()


def test_what_a_shadow_changes_is_known_to_a_third(model: ShadingModel) -> None:
    image, _ = frame(*ball_skin())
    found = find_cast_shadow(lambert_slopes(image), image, model, None)
    assert found is not None
    p, q = found.sigma(found.p.shape[::-1])
    np.testing.assert_allclose((p, q), (RELATIVE_SIGMA * found.p, RELATIVE_SIGMA * found.q), rtol=1e-5)
    assert p[0, 0] == q[0, 0] == 0.0


def test_gentle_skin_hides_no_light(model: ShadingModel) -> None:
    z, p, q = (0.1 * part for part in ball_skin())
    image, lit = frame(z, p, q)
    assert lit.all()
    assert find_cast_shadow(lambert_slopes(image), image, model, None) is None


def test_a_channel_in_shadow_shows_what_leaks_of_the_others() -> None:
    image, _ = frame(*ball_skin(), leak=0.1)
    leaks = measure_leaks([(image, [Ball(120.0, 90.0, CONTACT_PX, RADIUS_PX)])])
    assert leaks == pytest.approx(0.1, abs=0.04)
