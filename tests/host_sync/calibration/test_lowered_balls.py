"""Balls that are lowered to skin at rest for the inverse map; frames come from a renderer of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from near_lamps import RADIUS_PX, SHAPE, NearLamps, balls, press_px

from device.balls.sphere import Ball, gather_samples, pixels_inside
from device.calibration.fit import InverseFit, fit_inverse_map
from device.imaging.flat_field import NormalizedImage
from host_sync.calibration.balls import UsedPress
from host_sync.calibration.slope_models import LoweredBalls
from host_sync.light.fit import held_out_readers
from host_sync.uncertainty.elevation import ElevationCorrection

NEAR = NearLamps(220.0)
TRUE = balls()
SLOPE_SIGMA = 0.02


def located(lamps: NearLamps, *, seen_at: float = 1.0) -> list[UsedPress]:
    return [
        UsedPress(f"press-{seed}", lamps.intensity(press_px(ball, apex), seen_at=seen_at, noise=0.004, seed=seed),
                  (replace(ball, contact_radius_px=25.0),), ())
        for seed, (ball, apex) in enumerate(TRUE)
    ]  # fmt: skip


def inverse_of(presses: Sequence[UsedPress]) -> InverseFit:
    every = [ball for press in presses for ball in press.balls]
    samples = gather_samples([(press.intensity, press.balls) for press in presses], for_fit=True)
    return fit_inverse_map(samples, every, SHAPE, max_samples=6_000)


@cache
def near() -> tuple[list[UsedPress], InverseFit, LoweredBalls]:
    """Return presses under near lamps, the inverse map that they give, and the lowered balls."""
    presses = located(NEAR)
    fit = inverse_of(presses)
    return presses, fit, LoweredBalls.of(presses, fit, SLOPE_SIGMA, None)


def off_rest(presses: Sequence[UsedPress], lamps: NearLamps) -> float:
    """Return by how much contacts differ from the same slopes at rest, root mean square of the intensity."""
    parts = []
    for press, (ball, apex) in zip(presses, TRUE, strict=True):
        row, column = pixels_inside(replace(ball, contact_radius_px=20.0), SHAPE)
        z = press_px(ball, apex)
        q, p = np.gradient(z)
        rest = lamps.light(z, p, q, seen_at=0.0) / lamps.flat_field()
        parts.append((press.intensity.values - rest)[row, column].ravel())
    return float(np.sqrt(np.square(np.concatenate(parts)).mean()))


def test_contacts_look_as_their_slopes_do_at_rest() -> None:
    presses, _, lowered = near()
    wrong = off_rest(presses, NEAR)
    assert wrong > 0.03
    assert off_rest(lowered.presses, NEAR) < 0.35 * wrong
    assert 0.0 <= lowered.remaining < 0.2


def test_light_around_the_balls_stays() -> None:
    presses, fit, lowered = near()
    for press, (own,), changed in zip(presses, [(ball,) for ball in fit.balls], lowered.presses, strict=True):
        outside = np.ones(SHAPE, bool)
        outside[pixels_inside(replace(own, contact_radius_px=own.contact_radius_px + 3.0), SHAPE)] = False
        np.testing.assert_array_equal(changed.intensity.values[outside], press.intensity.values[outside])


def rms(presses: Sequence[UsedPress], changed: Sequence[UsedPress]) -> float:
    """Return by how much the light of presses was changed inside the contacts, root mean square of the intensity."""
    parts = [
        (other.intensity.values - one.intensity.values)[pixels_inside(one.balls[0], SHAPE)].ravel()
        for one, other in zip(presses, changed, strict=True)
    ]
    return float(np.sqrt(np.square(np.concatenate(parts)).mean()))


def distant(ball: Ball, apex_px: float, seed: int) -> NormalizedImage:
    """Return matt skin under parallel light, which no elevation changes."""
    q, p = np.gradient(press_px(ball, apex_px))
    turn = np.radians([10.0, 130.0, 250.0])
    along = p[..., None] * np.cos(turn) + q[..., None] * np.sin(turn)
    values = np.maximum(1.0 - 1.2 * along, 0.0) / np.sqrt(1.0 + p**2 + q**2)[..., None]
    values += 0.004 * np.random.default_rng(seed).standard_normal(values.shape)
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


@pytest.mark.slow
def test_under_distant_lights_nothing_is_lowered() -> None:
    presses = [
        replace(press, intensity=distant(ball, apex, seed))
        for seed, (press, (ball, apex)) in enumerate(zip(located(NEAR), TRUE, strict=True))
    ]
    lowered = LoweredBalls.of(presses, inverse_of(presses), SLOPE_SIGMA, None)
    assert rms(presses, lowered.presses) < 0.008


@pytest.mark.slow
def test_light_that_does_not_depend_on_elevation_is_not_lowered() -> None:
    """Its direction changes over the field as that of near lamps, and yet it shows no elevation."""
    presses = located(NEAR, seen_at=0.0)
    lowered = LoweredBalls.of(presses, inverse_of(presses), SLOPE_SIGMA, None)
    assert rms(presses, lowered.presses) < 0.022, "0.032 where all of the elevation counts"


def test_lowered_balls_show_slopes_at_what_remains_of_their_elevation() -> None:
    _, _, lowered = near()
    seen = ElevationCorrection(apex_px=16.0, radius_px=RADIUS_PX, nearness_per_px=1.0 / 220.0)
    found = lowered.elevation(seen)
    assert found.apex_px == lowered.remaining * 16.0
    assert found.nearness_per_px == seen.nearness_per_px


@pytest.mark.slow
def test_a_ball_that_the_map_dropped_is_left_as_it_is() -> None:
    presses, fit, _ = near()
    kept = np.arange(len(TRUE)) != 4
    found = LoweredBalls.of(presses, replace(fit, kept=kept), SLOPE_SIGMA, None)
    np.testing.assert_array_equal(found.presses[4].intensity.values, presses[4].intensity.values)
    assert found.presses[4].balls == (fit.balls[4],)
    assert len(found.light.shift_px) == len(TRUE) - 1


def test_every_ball_is_judged_by_a_model_without_it_and_its_slopes_are_right() -> None:
    presses, fit, lowered = near()
    pressed = [(press.intensity, list(press.balls)) for press in presses]
    at = ElevationCorrection(apex_px=16.0, radius_px=RADIUS_PX, nearness_per_px=1.0 / 220.0)
    readers = held_out_readers(lowered.light, fit.map, pressed, at, SLOPE_SIGMA)
    assert len(readers.reads) == len(readers.without) == len(TRUE)
    off: dict[str, list[float]] = {"map": [], "all": [], "without": []}
    for number, (ball, apex) in enumerate(TRUE):
        row, column = pixels_inside(replace(ball, contact_radius_px=20.0), SHAPE)
        image = NEAR.intensity(press_px(Ball(ball.column, ball.row, 28.0, RADIUS_PX), apex))
        q, p = (part[row, column] for part in np.gradient(press_px(ball, apex)))
        seen = image.values[row, column], column.astype(np.float32), row.astype(np.float32)
        for name, one in (("map", fit.map), ("all", readers.reads[number]), ("without", readers.without[number])):
            off[name].append(float(np.hypot(*(one.predict(*seen) - np.stack([p, q], axis=-1)).T).mean()))
    means = {name: float(np.mean(values)) for name, values in off.items()}
    assert off["all"] != off["without"]
    assert means["without"] < 2.0 * means["all"]
    assert means["without"] < 0.03
