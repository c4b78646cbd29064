"""Skin behind a cone, read half as steep again where one of three lamps of known places does not reach it."""

from __future__ import annotations

import numpy as np

from device.surface.fields import GradientField
from host_sync.integration.integrate import integrate
from host_sync.lights.known_lamps import KnownLamps
from host_sync.reconstruction.hidden_skin import HIDDEN_WEIGHT, RELATIVE_SIGMA, find_hidden_skin

SHAPE = (180, 240)
PITCH_UM = 20.0
HEIGHT_PX = 20.0
FLANK = 0.75
LAMPS = KnownLamps.of([(0.0, -5.0, 3.5), (-4.4, 2.5, 3.5), (4.4, 2.5, 3.5)], PITCH_UM)


def cone() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of a blunt cone on flat skin, px, and its slopes."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    distance = np.hypot(column - 119.5, row - 89.5)
    z = np.clip(HEIGHT_PX + FLANK * 15.0 - FLANK * distance, 0.0, HEIGHT_PX)
    q, p = np.gradient(z)
    return z, p, q


def shadowed(z: np.ndarray) -> np.ndarray:
    """True where a ray to a lamp meets the skin or the lamp is below its plane, ray by ray: shape (H, W)."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    dark = np.zeros(SHAPE, bool)
    for right, down, up in LAMPS.position_px:
        to_x, to_y, to_z = right + 119.5 - column, down + 89.5 - row, up - z
        for share in np.linspace(0.004, 0.5, 120):
            at_x = np.clip(np.rint(column + share * to_x).astype(int), 0, SHAPE[1] - 1)
            at_y = np.clip(np.rint(row + share * to_y).astype(int), 0, SHAPE[0] - 1)
            dark |= z[at_y, at_x] > z + share * to_z + 0.5
    return dark


def read() -> tuple[np.ndarray, np.ndarray, GradientField]:
    z, p, q = cone()
    dark = shadowed(z)
    factor = np.where(dark, 1.5, 1.0)
    everywhere = np.ones(SHAPE, bool)
    field = GradientField(
        (p * factor).astype(np.float32), (q * factor).astype(np.float32), everywhere, everywhere * np.float32(1)
    )
    return z, dark, field


def test_shadows_are_found_and_the_lit_sides_decide_the_height() -> None:
    z, dark, field = read()
    assert 0.02 < dark.mean() < 0.3
    found = find_hidden_skin(field, LAMPS)
    assert found is not None
    assert (found.shadow[dark] > 0.5).mean() > 0.8
    assert (found.shadow[~dark] > 0.5).mean() < 0.1

    def top_px(gradients: GradientField) -> float:
        height, _ = integrate(gradients, 1.0)
        flat = (z == 0.0) & ~dark
        return float(np.median(height.z_um[z == HEIGHT_PX]) - np.median(height.z_um[flat]))

    before = top_px(field)
    found.apply(field)
    np.testing.assert_allclose(field.weight.min(), HIDDEN_WEIGHT, rtol=1e-6)
    after = top_px(field)
    assert before > 1.05 * HEIGHT_PX
    assert abs(after - HEIGHT_PX) < 0.4 * (before - HEIGHT_PX)


def test_slopes_are_as_they_were_and_unsure_in_shadow_alone() -> None:
    _, _, field = read()
    found = find_hidden_skin(field, LAMPS)
    assert found is not None
    p, q = field.p.copy(), field.q.copy()
    found.apply(field)
    np.testing.assert_array_equal(field.p, p)
    np.testing.assert_array_equal(field.q, q)
    sigma_p, sigma_q = found.sigma((SHAPE[1], SHAPE[0]))
    lit = found.shadow == 0.0
    assert not sigma_p[lit].any()
    np.testing.assert_allclose(np.abs(sigma_q[~lit]), RELATIVE_SIGMA * np.abs(q[~lit]), atol=1e-6)


def test_flat_skin_and_high_lamps_hide_nothing() -> None:
    _, p, q = cone()
    everywhere = np.ones(SHAPE, bool)
    weight = everywhere * np.float32(1)
    level = GradientField(np.zeros(SHAPE, np.float32), np.zeros(SHAPE, np.float32), everywhere, weight)
    assert find_hidden_skin(level, LAMPS) is None
    high = KnownLamps(LAMPS.position_px * [0.2, 0.2, 20.0])
    assert find_hidden_skin(GradientField(p.astype(np.float32), q.astype(np.float32), everywhere, weight), high) is None
