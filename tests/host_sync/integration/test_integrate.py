"""Weighted multigrid: surfaces with closed forms, a direct solver as oracle, hard weights, threads, bad input."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from device.surface import GradientField
from host_sync.errors import IntegrationError
from host_sync.integration.integrate import Integrator, integrate
from host_sync.integration.levels import EdgeRule

SHAPES = [(3, 3), (3, 200), (5, 7), (127, 65), (64, 64)]


def field(p: np.ndarray, q: np.ndarray, weight: np.ndarray | None = None) -> GradientField:
    weight = np.ones(p.shape) if weight is None else weight
    return GradientField(p.astype(np.float32), q.astype(np.float32), weight > 0.0, weight.astype(np.float32))


def surfaces(shape: tuple[int, int]) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Height, p and q of closed-form surfaces, in pixels."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    y, x = row - shape[0] / 2.0, column - shape[1] / 2.0
    radius = 2.0 * max(shape)
    cap = np.sqrt(radius**2 - x**2 - y**2)
    k = 2.0 * np.pi / 40.0
    return {
        "plane": (0.3 * x - 0.2 * y, 0.3 + 0.0 * x, -0.2 + 0.0 * x),
        "saddle": (0.01 * x * y, 0.01 * y, 0.01 * x),
        "cap": (cap, -x / cap, -y / cap),
        "sinusoid": (3.0 * np.sin(k * x) * np.cos(k * y), 3.0 * k * np.cos(k * x) * np.cos(k * y),
                     -3.0 * k * np.sin(k * x) * np.sin(k * y)),
    }  # fmt: skip


def harmonic(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where((a > 0) & (b > 0), 2.0 * a * b / np.maximum(a + b, 1e-30), 0.0)


def direct(gradients: GradientField) -> np.ndarray:
    """Two-point least squares by a sparse direct solver, each component with weighted mean zero, NaN in holes."""
    weight = np.where(gradients.valid, gradients.weight, 0.0).astype(np.float64)
    number = np.arange(weight.size).reshape(weight.shape)
    p, q = gradients.p.astype(np.float64), gradients.q.astype(np.float64)
    tails = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
    heads = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
    edge = np.concatenate([harmonic(weight[:, :-1], weight[:, 1:]).ravel(), harmonic(weight[:-1], weight[1:]).ravel()])
    slope = np.concatenate([0.5 * (p[:, :-1] + p[:, 1:]).ravel(), 0.5 * (q[:-1] + q[1:]).ravel()])
    used = edge > 0.0
    count = int(used.sum())
    lines = np.arange(count)
    difference = sparse.csr_matrix(
        (
            np.r_[-np.ones(count), np.ones(count)],
            (np.r_[lines, lines], np.r_[tails[used], heads[used]]),
        ),
        shape=(count, weight.size),
    )
    scale = sparse.diags(edge[used])
    labels, components = ndimage.label(weight > 0.0)
    system = (difference.T @ scale @ difference).tolil()
    # One pixel of each island, and every hole, is held at zero; the island's level is set afterwards.
    held = [int(np.flatnonzero(labels.ravel() == island)[0]) for island in range(1, components + 1)]
    for pixel in [*held, *np.flatnonzero(weight.ravel() == 0.0)]:
        system[pixel, pixel] += 1.0
    z = spsolve(system.tocsc(), difference.T @ (edge[used] * slope[used])).reshape(weight.shape)
    for island in range(1, components + 1):
        inside = labels == island
        z[inside] -= np.average(z[inside], weights=weight[inside])
    return np.where(weight > 0.0, z, np.nan)


def rough(shape: tuple[int, int], seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    random = np.random.default_rng(seed)
    return random.normal(0.0, 0.3, shape), random.normal(0.0, 0.3, shape), random


def holed(shape: tuple[int, int], random: np.random.Generator) -> np.ndarray:
    weight = 10.0 ** random.uniform(-3.0, 0.0, shape)
    row, column = np.mgrid[: shape[0], : shape[1]]
    for _ in range(6):
        centre = random.uniform(0, shape[0]), random.uniform(0, shape[1])
        weight[np.hypot(row - centre[0], column - centre[1]) < random.uniform(1, shape[0] / 6)] = 0.0
    return weight


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", ["plane", "saddle", "cap", "sinusoid"])
@pytest.mark.parametrize("weighted", [False, True])
def test_a_closed_form_comes_back(shape: tuple[int, int], name: str, weighted: bool) -> None:
    z, p, q = surfaces(shape)[name]
    weight = np.random.default_rng(0).uniform(0.2, 1.0, shape) if weighted else np.ones(shape)
    height, report = integrate(field(p, q, weight), 5.0, tolerance_px=1e-4)
    error = height.z_um / 5.0 - z
    error -= np.average(error, weights=weight)
    assert report.converged
    assert np.abs(error).max() < 0.01


@pytest.mark.parametrize("shape", [(9, 11), (33, 40), (50, 23), (150, 110)])
@pytest.mark.parametrize("kind", ["uniform", "weights", "holes", "checkerboard", "bridge"])
def test_it_agrees_with_a_direct_solver(shape: tuple[int, int], kind: str) -> None:
    p, q, random = rough(shape)
    weight = np.ones(shape)
    if kind == "weights":
        weight = 10.0 ** random.uniform(-4.0, 0.0, shape)
    elif kind == "holes":
        weight = holed(shape, random)
    elif kind == "checkerboard":
        weight[::2, ::2] = 0.0
    elif kind == "bridge":
        weight[:, shape[1] // 2] = 0.0
        weight[shape[0] // 2, shape[1] // 2] = 0.01
    gradients = field(p, q, weight)
    height, report = integrate(gradients, 1.0, edges="two-point", tolerance_px=1e-6)
    expected = direct(gradients)
    assert report.converged
    np.testing.assert_array_equal(np.isnan(height.z_um), np.isnan(expected))
    assert np.nanmax(np.abs(height.z_um - expected)) < 1e-4


def test_each_component_has_its_own_mean() -> None:
    weight = np.ones((40, 60))
    weight[:, 29:31] = 0.0
    z, p, q = surfaces((40, 60))["plane"]
    height, report = integrate(field(p, q, weight), 1.0)
    assert report.components == 2
    for half in (np.s_[:, :29], np.s_[:, 31:]):
        assert abs(float(height.z_um[half].mean())) < 1e-3
        np.testing.assert_allclose(height.z_um[half], z[half] - z[half].mean(), atol=5e-3)


def test_fourth_order_edges_beat_two_point_ones_as_their_order_says() -> None:
    worst: dict[EdgeRule, list[float]] = {"fourth-order": [], "two-point": []}
    for period in (16.0, 8.0):
        row, column = np.mgrid[:8, :128].astype(np.float64)
        k = 2.0 * np.pi / period
        gradients = field(k * np.cos(k * column), 0.0 * row)
        for rule, errors in worst.items():
            height, _ = integrate(gradients, 1.0, edges=rule, tolerance_px=1e-6)
            error = (height.z_um - np.sin(k * column))[:, 32:96]
            errors.append(float(np.abs(error - error.mean()).max()))
    assert worst["two-point"][1] / worst["two-point"][0] == pytest.approx(4.0, rel=0.2)
    assert worst["fourth-order"][1] / worst["fourth-order"][0] > 10.0


def test_the_printed_rule_is_the_papers_one_sided_difference() -> None:
    p, q = np.tile(np.arange(8.0), (5, 1)), np.zeros((5, 8))
    height, _ = integrate(field(p, q), 1.0, edges="printed", tolerance_px=1e-6)
    np.testing.assert_allclose(np.diff(height.z_um, axis=1), p[:, :-1], atol=1e-4)


def test_cycles_do_not_grow_with_the_size() -> None:
    cycles = []
    for size in (64, 128, 256, 512):
        p, q, _ = rough((size, size))
        _, report = integrate(field(p, q), 1.0, tolerance_px=1e-4)
        cycles.append(report.cycles)
    assert max(cycles) <= min(cycles) + 2


def test_the_result_does_not_depend_on_the_number_of_threads() -> None:
    p, q, random = rough((300, 410))
    gradients = field(p, q, holed((300, 410), random))
    threads = numba.get_num_threads()
    try:
        heights = []
        for count in (1, threads):
            numba.set_num_threads(count)
            heights.append(integrate(gradients, 1.0)[0].z_um)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(heights[0], heights[1])


def test_a_lone_pixel_is_a_component_at_zero() -> None:
    weight = np.zeros((9, 9))
    weight[4, 4] = 1.0
    height, report = integrate(field(*rough((9, 9))[:2], weight), 1.0)
    assert report.components == 1
    assert height.z_um[4, 4] == 0.0
    assert np.isnan(height.z_um).sum() == 80


def test_slopes_that_are_not_numbers_are_refused_where_valid_and_ignored_where_not() -> None:
    p, q, _ = rough((12, 12))
    p[3, 3] = np.nan
    with pytest.raises(IntegrationError, match="1 "):
        integrate(field(p, q), 1.0)
    weight = np.ones((12, 12))
    weight[3, 3] = 0.0
    height, _ = integrate(field(p, q, weight), 1.0)
    assert np.isnan(height.z_um).sum() == 1


def test_nothing_valid_and_shapes_that_differ_are_refused() -> None:
    p, q, _ = rough((12, 12))
    with pytest.raises(IntegrationError):
        integrate(field(p, q, np.zeros((12, 12))), 1.0)
    mixed = GradientField(*(array.astype(np.float32) for array in (p, q[:, :-1])), p > -9.0, np.ones_like(p))
    with pytest.raises(IntegrationError):
        integrate(mixed, 1.0)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("row", [0, 5, 19])
def test_slopes_beyond_single_precision_are_refused_and_named(row: int, weighted: bool) -> None:
    p, q, random = rough((20, 20))
    q[row, 7] = -1e30
    weight = random.uniform(0.1, 1.0, (20, 20)) if weighted else np.ones((20, 20))
    with pytest.raises(IntegrationError, match=rf"1e\+30 \(row {row}\)"):
        integrate(field(p, q, weight), 1.0)


@pytest.mark.parametrize("scale", [1e-40, 1e-20, 3e38])
def test_only_ratios_of_weights_count(scale: float) -> None:
    p, q, random = rough((30, 40))
    weight = random.choice([0.0, 0.25, 0.5, 1.0], (30, 40))
    expected, _ = integrate(field(p, q, weight), 1.0)
    scaled, _ = integrate(field(p, q, weight * scale), 1.0)
    np.testing.assert_allclose(scaled.z_um, expected.z_um, atol=2e-3)


@pytest.mark.parametrize("little", [1e-13, 1e-25, 1e-40])
def test_a_weight_far_below_the_largest_is_a_hole(little: float) -> None:
    p, q, random = rough((30, 40))
    missing = random.random((30, 40)) < 0.3
    expected, _ = integrate(field(p, q, np.where(missing, 0.0, 1.0)), 1.0)
    found, report = integrate(field(p, q, np.where(missing, little, 1.0)), 1.0)
    assert report.converged
    np.testing.assert_array_equal(found.z_um, expected.z_um)


@pytest.mark.parametrize("kind", ["uniform", "holes"])
def test_what_single_precision_cannot_reach_ends_where_it_can_and_says_so(kind: str) -> None:
    random = np.random.default_rng(8)
    weight = np.ones((60, 45))
    if kind == "holes":
        weight[20:30, 10:25] = 0.0
    p, q = random.standard_normal((2, 60, 45))
    gradients = field(p, q, weight)
    height, report = integrate(gradients, 1.0, edges="two-point", tolerance_px=0.0)
    error = np.sqrt(np.nanmean((height.z_um - direct(gradients)) ** 2))
    assert error < 5e-6
    assert not report.converged
    assert 0.3 * error < report.error_px < 5e-6


@pytest.mark.parametrize(("rows", "dtype"), [(19, "float32"), (21, "float32"), (20, "float64")])
def test_heights_go_to_no_array_that_cannot_receive_them(rows: int, dtype: str) -> None:
    out = np.empty((rows, 30), dtype)
    with pytest.raises(IntegrationError, match=r"float32 array of shape \(20, 30\)"):
        Integrator((20, 30)).integrate(field(np.zeros((20, 30)), np.zeros((20, 30))), 1.0, out=out)


@pytest.mark.parametrize("pitch_um", [0.0, -5.0, float("nan"), float("inf")])
def test_an_invalid_pitch_is_refused(pitch_um: float) -> None:
    with pytest.raises(IntegrationError, match="pixel pitch"):
        integrate(field(np.zeros((9, 8)), np.zeros((9, 8))), pitch_um)


@pytest.mark.parametrize(
    ("row", "slope"), [(15, np.random.default_rng(0).standard_normal(37)), (14, np.ones(37))], ids=["noise", "step"]
)
def test_one_odd_row_affects_the_reported_error(row: int, slope: np.ndarray) -> None:
    """Sampling one row in four would report a third of the step's error."""
    p, q = np.zeros((31, 37)), np.zeros((31, 37))
    p[row] = slope
    height, report = integrate(field(p, q), 1.0, edges="two-point")
    error = np.sqrt(np.mean((height.z_um - direct(field(p, q))) ** 2))
    assert report.error_px > 0.5 * error
