"""Where beams point, told by balls under the light of a renderer of its own."""

import numpy as np
import pytest

from device.balls.sphere import Ball, BallSamples, sphere_slopes
from host_sync.lights.lamp_fit import FOLDS, LampFit, fit_lamps

SHAPE = (480, 640)
RADIUS, CONTACT, APEX = 70.0, 40.0, 30.0
OUT, UP = 400.0, 340.0
"""Of the lamps, pixels from the middle and over the skin."""


def balls() -> list[Ball]:
    return [
        Ball(column, row, CONTACT, RADIUS) for row in (90.0, 240.0, 390.0) for column in (80.0, 240.0, 400.0, 560.0)
    ]


def lit(p: np.ndarray, q: np.ndarray, column: np.ndarray, row: np.ndarray, z: np.ndarray, axis_up: float) -> np.ndarray:
    """Light of a matt skin under three lamps whose beams fall with the cosine from an axis that rises so steeply."""
    place = np.stack([column - 0.5 * (SHAPE[1] - 1), row - 0.5 * (SHAPE[0] - 1), z], axis=-1)
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1.0 + p**2 + q**2)[..., None]
    channels = []
    for angle in np.radians([20.0, 140.0, 260.0]):
        away = np.array([np.cos(angle), np.sin(angle)])
        to_lamp = np.append(OUT * away, UP) - place
        distance = np.linalg.norm(to_lamp, axis=-1)
        axis = np.append(away, axis_up) / np.hypot(1.0, axis_up)
        falling = (to_lamp @ axis) / distance**3
        channels.append(np.maximum((normal * to_lamp).sum(axis=-1) / distance, 0.0) * falling)
    return np.stack(channels, axis=-1)


def fitted(aim: float) -> LampFit:
    """From balls whose lamps' axes are `aim` times as steep as the way from the middle to the lamps."""
    rng = np.random.default_rng(0)
    parts = []
    for number, ball in enumerate(balls()):
        radius, angle = CONTACT * np.sqrt(rng.uniform(0.0, 1.0, 600)), rng.uniform(0.0, 2.0 * np.pi, 600)
        column, row = ball.column + radius * np.cos(angle), ball.row + radius * np.sin(angle)
        p, q = (part.astype(np.float64) for part in sphere_slopes(ball, column, row))
        z = APEX - RADIUS + np.sqrt(RADIUS**2 - radius**2)
        level = np.zeros_like(p)
        seen = lit(p, q, column, row, z, aim * UP / OUT) / lit(level, level, column, row, level, aim * UP / OUT)
        parts.append((seen + 0.003 * rng.standard_normal(seen.shape), p, q, column, row, np.full(600, number)))
    seen, p, q, column, row, number = (np.concatenate(part) for part in zip(*parts, strict=True))
    single = (part.astype(np.float32) for part in (seen, p, q, column, row))
    samples = BallSamples(*single, number)
    return fit_lamps(samples, np.ones((len(p), 3)), balls(), [APEX] * len(balls()), SHAPE)


@pytest.mark.parametrize("aim", [0.7, 1.3])
def test_balls_show_where_beams_point(aim: float) -> None:
    fit = fitted(aim)
    assert fit.lamps.model.beam == pytest.approx(1.0, abs=0.25)
    # What is expected beforehand holds it back.
    assert abs(np.log(fit.lamps.model.aim / aim)) < 0.5 * abs(np.log(aim))
    assert len(fit.lamps.folds) == FOLDS
    assert len({model.aim for model in fit.lamps.folds}) == FOLDS
    # Nobody says where the camera stands: it is far away, whatever noise would have it take up.
    assert {model.camera for model in (fit.lamps.model, *fit.lamps.folds)} == {0.0}
