"""The reported error of a solution compared with its true error, on weights, holes and bridges of every kind."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dctn, idctn

from device.surface import GradientField, full_rectangle
from host_sync.integration.integrate import integrate

SHAPE = (130, 97)
NOISE = 0.02
SEEDS = range(4)


def weights(kind: str, random: np.random.Generator) -> np.ndarray:
    """Weights of a field, zero at holes."""
    weight = random.uniform(0.1, 1.0, SHAPE)
    if kind == "decades":
        weight = 10.0 ** random.uniform(-2.0, 0.0, SHAPE)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for _ in range({"discs": 12, "bridges": 40}.get(kind, 0)):
        centre = random.uniform(0, SHAPE[0]), random.uniform(0, SHAPE[1])
        weight[np.hypot(row - centre[0], column - centre[1]) < random.uniform(1.5, 9.0)] = 0.0
    if kind == "loose pixels":
        weight[random.random(SHAPE) < 0.05] = 0.0
    return weight.astype(np.float32)


def noisy(kind: str, seed: int) -> GradientField:
    """Slopes of a bowl with noise according to their weights."""
    random = np.random.default_rng(seed)
    weight = weights(kind, random)
    sigma = NOISE / np.sqrt(np.where(weight > 0.0, weight, 1.0))
    row, column = (at.astype(np.float32) for at in np.mgrid[: SHAPE[0], : SHAPE[1]])
    p, q = (0.002 * at + sigma * random.standard_normal(SHAPE, np.float32) for at in (column, row))
    return GradientField(p.astype(np.float32), q.astype(np.float32), weight > 0.0, weight)


def reported_over_true(kind: str, cycles: int) -> list[float]:
    """Reported over true error of solutions of one kind of field, by default or after this many cycles."""
    ratios = []
    for seed in SEEDS:
        gradients = noisy(kind, seed)
        exact, _ = integrate(gradients, 1.0, tolerance_px=1e-6)
        height, report = integrate(gradients, 1.0, tolerance_px=1e-9 if cycles else None, max_cycles=cycles or 200)
        error = (height.z_um - exact.z_um)[gradients.valid].astype(np.float64)
        ratios.append(report.error_px / float(np.sqrt(np.square(error).mean())))
    return ratios


@pytest.mark.parametrize("cycles", [0, 1, 2, 3])
def test_most_stated_errors_are_no_smaller_than_the_true_ones_and_none_is_far_off(cycles: int) -> None:
    kinds = ("weights", "decades", "discs", "bridges", "loose pixels")
    ratios = np.array([reported_over_true(kind, cycles) for kind in kinds])
    assert np.mean(ratios >= 1.0) > 0.6
    assert ratios.min() > 0.3
    assert np.median(ratios) < 4.0


def test_the_default_adds_less_than_a_hundredth_to_what_noise_does() -> None:
    for kind in ("weights", "discs"):
        for seed in SEEDS:
            gradients = noisy(kind, seed)
            row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
            truth = 0.001 * (column**2.0 + row**2.0)
            exact, _ = integrate(gradients, 1.0, tolerance_px=1e-6)
            found, _ = integrate(gradients, 1.0)
            used = gradients.valid
            noise, left = (float((a[used] - b[used]).std()) for a, b in
                           ((exact.z_um, truth), (found.z_um, exact.z_um)))  # fmt: skip
            assert np.hypot(noise, left) / noise < 1.01


def by_cosines(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Two-point least squares of a full rectangle, float64, mean zero."""
    rhs = np.zeros(p.shape)
    weight_x, weight_y = (p[:, 1:] + p[:, :-1]) / 2.0, (q[1:] + q[:-1]) / 2.0
    rhs[:, 1:] += weight_x
    rhs[:, :-1] -= weight_x
    rhs[1:] += weight_y
    rhs[:-1] -= weight_y
    rows, columns = (2.0 - 2.0 * np.cos(np.pi * np.arange(size) / size) for size in p.shape)
    eigenvalue = np.add.outer(rows, columns)
    eigenvalue[0, 0] = np.inf
    return np.asarray(idctn(dctn(rhs, norm="ortho") / eigenvalue, norm="ortho"))


@pytest.mark.parametrize("shape", [(64, 64), (65, 64), (97, 101), (255, 257), (255, 1023), (9, 3001), (3, 1501)])
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_slopes_that_contradict_each_other_in_long_waves_are_no_worse_than_stated(
    shape: tuple[int, int], noise: float
) -> None:
    random = np.random.default_rng(3)
    row, column = (np.arange(size) + 0.5 for size in shape)
    p, q = np.zeros(shape), np.zeros(shape)
    p += np.cos(np.pi * row / shape[0])[:, None]
    q -= np.cos(np.pi * column / shape[1])
    gradients = full_rectangle(*((s + noise * random.standard_normal(shape)).astype(np.float32) for s in (p, q)))
    height, report = integrate(gradients, 1.0, edges="two-point")
    exact = by_cosines(gradients.p.astype(np.float64), gradients.q.astype(np.float64))
    error = float(np.sqrt(np.square(height.z_um - exact).mean()))
    assert 0.8 * error < report.error_px < 10.0 * error
