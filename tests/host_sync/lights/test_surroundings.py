"""What skin around a place shows, and what skin that slants receives of it: summed over all pairs of places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from point_lamps import point_lamps

from device.imaging.flat_field import NormalizedImage
from host_sync.lights.surroundings import CLOSE_WIDTHS, Surroundings

WIDE = (60, 480)
STEP_PX = 4
SIDE = 160
TARGETS = 400


def test_untouched_skin_and_what_is_not_known_count_as_untouched() -> None:
    values = np.ones((*WIDE, 3), np.float32)
    values[20:30, 100:200], values[30:40, 100:200], values[20:30, 300:400] = np.nan, 7.0, 9.0
    valid, clipped = np.ones(WIDE, bool), np.zeros(WIDE, bool)
    valid[30:40, 100:200], clipped[20:30, 300:400] = False, True
    np.testing.assert_allclose(Surroundings.of(NormalizedImage(values, valid, clipped)).intensity, 1.0, rtol=1e-6)


def test_a_border_between_two_halves_is_seen_from_close_by() -> None:
    values = np.ones((*WIDE, 3), np.float32)
    values[:, 240:] = 2.0
    column = np.arange(480.0)
    everywhere = np.ones(WIDE, bool)
    around = Surroundings.of(NormalizedImage(values, everywhere, ~everywhere))
    bright = around.at(column, np.full(480, 30.0))[:, 0] - 1.0
    assert abs(np.interp(0.5, bright, column) - 239.5) < 1.0
    within = np.interp([0.1587, 0.8413], bright, column)
    assert abs(np.diff(within)[0] / (2.0 * CLOSE_WIDTHS * 480) - 1.0) < 0.1


def blunt_cone() -> np.ndarray:
    """Rounded at rim and foot; height over a grid of `STEP_PX`, pixels."""
    row, column = (np.mgrid[:SIDE, :SIDE] - 0.5 * (SIDE - 1)) * STEP_PX
    flank = 0.1 * (120.0 - np.hypot(row, column))
    return 6.0 * (np.logaddexp(0.0, flank) - np.logaddexp(0.0, flank - 6.0))


def received(z: np.ndarray, p: np.ndarray, q: np.ndarray, sent: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Light that the targets receive from all other places, as a share of what level skin around sends: (N,).

    What lies beyond the grid is level skin: it fills what a tilted plane sees of a level one.
    """
    row, column = np.mgrid[:SIDE, :SIDE] * STEP_PX
    place = np.stack([column, row, z], axis=-1).reshape(-1, 3)
    up = 1.0 / np.sqrt(1.0 + p * p + q * q)
    normal = np.stack([-p * up, -q * up, up], axis=-1).reshape(-1, 3)
    area = STEP_PX**2 / up.ravel()
    light = []
    for target in targets:
        towards = place - place[target]
        square = (towards**2).sum(axis=1)
        square[target] = np.inf
        leaves = np.maximum(-(towards * normal).sum(axis=1), 0.0)
        arrives = np.maximum(towards @ normal[target], 0.0)
        share = arrives * leaves * area / (np.pi * square**2)
        beyond = max(0.5 * (1.0 - up.ravel()[target]) - share.sum(), 0.0)
        light.append(share @ sent.ravel() + beyond)
    return np.array(light)


def test_a_flank_on_level_skin_receives_what_the_model_says_from_afar() -> None:
    """Not what it shows itself: the lit flank would receive as much more as it is brighter."""
    z = blunt_cone()
    q, p = np.gradient(z, STEP_PX)
    tilted = 1.0 - 1.0 / np.sqrt(1.0 + p * p + q * q)
    own = np.maximum((1.0 - 1.2 * p) * (1.0 - tilted), 0.0)
    targets = np.random.default_rng(0).choice(np.flatnonzero(tilted.ravel() > 0.02), TARGETS, replace=False)
    light = received(z, p, q, own, targets)
    model = replace(point_lamps(WIDE), bounce_afar=0.5)
    there = p.ravel()[targets], q.ravel()[targets]
    shown = own.ravel()[targets]
    wrong = 0.5 * tilted.ravel()[targets] * shown - light
    left = model.bounced(*there, shown[:, None] * np.ones(3))[:, 0] - light
    assert np.sqrt((light**2).mean()) > 0.04
    assert np.sqrt((left**2).mean()) < 0.003
    assert np.sqrt((wrong**2).mean()) > 0.015
