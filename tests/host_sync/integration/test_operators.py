"""Parts of the multigrid solver: transfer between levels, coarse edges, components, and thread independence."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy import ndimage

from device.surface import GradientField, full_rectangle, integrate_dct
from host_sync.errors import IntegrationError
from host_sync.integration.coarsening import coarsen, coarsen_pixels
from host_sync.integration.components import label_components
from host_sync.integration.conjugate_gradients import laplacian
from host_sync.integration.full_multigrid import direct_solver, pseudo_inverse, smoothing, write_divergence
from host_sync.integration.integrate import Integrator, integrate
from host_sync.integration.levels import (
    EdgeRule,
    FineLevel,
    GridLevel,
    coarser_levels,
    edge_coefficients,
    new_level,
    unit_weights,
)
from host_sync.integration.sweep import sweep
from host_sync.integration.transfer import (
    add_correction,
    add_weighted_correction,
    prolong_row,
    prolong_weighted_row,
    restrict_row,
)


def noisy(shape: tuple[int, int], seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of a surface that is not periodic, in pixels, and its slopes with noise of 0.02."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    random = np.random.default_rng(seed)
    z, p, q = np.zeros(shape), random.normal(0.0, 0.02, shape), random.normal(0.0, 0.02, shape)
    for amplitude, k, m in ((20.0, 0.004, 0.003), (6.0, 0.02, -0.013), (1.5, 0.11, 0.07)):
        z += amplitude * np.sin(k * column + m * row)
        wave = amplitude * np.cos(k * column + m * row)
        p, q = p + k * wave, q + m * wave
    return z, p, q


def field(p: np.ndarray, q: np.ndarray, weight: np.ndarray) -> GradientField:
    return GradientField(p.astype(np.float32), q.astype(np.float32), weight > 0.0, weight.astype(np.float32))


def weights(shape: tuple[int, int], seed: int = 1) -> np.ndarray:
    """Weights from 0.05 to 1 with holes of all sizes."""
    random = np.random.default_rng(seed)
    weight = random.uniform(0.05, 1.0, shape)
    weight[random.random(shape) < 0.01] = 0.0
    for _ in range(6):
        row, column, size = random.integers(shape[0]), random.integers(shape[1]), random.integers(2, 30)
        weight[row : row + size, column : column + size] = 0.0
    return weight


def written_edges(weight: np.ndarray, p: np.ndarray, q: np.ndarray) -> GridLevel:
    """A level with the edges of a field: slopes of differences p (H, W + 1) and q (H + 1, W)."""
    rows, columns = weight.shape
    level = new_level((rows, columns), weighted=True)
    assert level.weight_x is not None
    assert level.weight_y is not None
    for edges, slopes, source, pair in (
        (level.weight_x, level.slope_x, p, (weight[:, :-1], weight[:, 1:])),
        (level.weight_y, level.slope_y, q, (weight[:-1], weight[1:])),
    ):
        inner = np.s_[:, 1:-1] if edges is level.weight_x else np.s_[1:-1]
        edges[:], slopes[:] = 0.0, 0.0
        edges[inner] = np.minimum(*pair)
        slopes[inner] = np.where(edges[inner] > 0.0, source, 0.0)
    return level


def prolonged(coarse: np.ndarray, shape: tuple[int, int], level: GridLevel | None) -> np.ndarray:
    out = np.zeros((shape[0], shape[1] + 2), np.float32)
    for r in range(shape[0]):
        near, far = coarse[r // 2], coarse[min(max(r // 2 + 2 * (r % 2) - 1, 0), coarse.shape[0] - 1)]
        if level is None or level.weight_x is None or level.weight_y is None:
            prolong_row(near, far, out[r])
        else:
            prolong_weighted_row(near, far, level.weight_x[r], level.weight_y[r + r % 2], out[r])
    return out[:, 1:-1].astype(np.float64)


def restricted(fine: np.ndarray) -> np.ndarray:
    out = np.zeros(((fine.shape[0] + 1) // 2, (fine.shape[1] + 1) // 2), np.float32)
    for r in range(fine.shape[0]):
        restrict_row(fine[r].astype(np.float32), r % 2 == 1, out[r // 2])
    return out.astype(np.float64)


@pytest.mark.parametrize("shape", [(6, 8), (7, 9), (3, 5)])
def test_restriction_is_the_adjoint_of_prolongation_by_cells_to_which_interpolation_adds_only_differences(
    shape: tuple[int, int],
) -> None:
    random = np.random.default_rng(2)
    coarse = random.normal(size=((shape[0] + 1) // 2, (shape[1] + 1) // 2)).astype(np.float32)
    fine = random.normal(size=shape)
    cells = np.repeat(np.repeat(coarse, 2, 0), 2, 1)[: shape[0], : shape[1]]
    assert np.vdot(restricted(fine), coarse) == pytest.approx(np.vdot(fine, cells), rel=1e-5)
    np.testing.assert_allclose(prolonged(np.ones_like(coarse), shape, None), 1.0, atol=1e-6)


@pytest.mark.parametrize("holes", [False, True])
def test_prolongation_keeps_sums_where_no_hole_cuts_it_off(holes: bool) -> None:
    """The adjoint of interpolation takes a constant to four times itself; beside holes it falls back to cells."""
    shape, random = (16, 12), np.random.default_rng(3)
    weight = np.ones(shape)
    if holes:
        weight[6:10, 4:8] = 0.0
    level = written_edges(weight, np.zeros((16, 11)), np.zeros((15, 12)))
    coarse = random.normal(size=(8, 6)).astype(np.float32)
    fine = prolonged(coarse, shape, level)
    if holes:
        np.testing.assert_allclose(fine[6:10, 4:8], np.repeat(np.repeat(coarse[3:5, 2:4], 2, 0), 2, 1), atol=1e-6)
    else:
        np.testing.assert_allclose(fine, prolonged(coarse, shape, None), atol=1e-6)
        assert fine.sum() == pytest.approx(4.0 * float(coarse.sum()), abs=1e-4)


@pytest.mark.parametrize("shape", [(3, 3), (4, 4), (5, 6), (7, 12), (30, 41), (420, 333)])
@pytest.mark.parametrize("holes", [False, True])
def test_the_last_correction_is_what_a_pass_without_sweeps_adds(shape: tuple[int, int], holes: bool) -> None:
    random = np.random.default_rng(0)
    weight = weights(shape).astype(np.float32) if holes else None
    z = random.normal(size=shape).astype(np.float32)
    coarse = random.normal(size=((shape[0] + 1) // 2, (shape[1] + 1) // 2)).astype(np.float32)
    slopes = np.zeros(shape, np.float32)
    pixels = FineLevel(slopes, slopes, weight, np.float32(1.0), edge_coefficients("two-point"), 1e-4)
    expected = np.empty_like(z)
    sweep(pixels, smoothing(0), z, expected, coarse=coarse)
    if weight is None:
        add_correction(z, coarse)
    else:
        components = label_components(weight)
        moments = add_weighted_correction(z, coarse, weight, components)
        np.testing.assert_allclose(moments, components.moments(z, weight), atol=1e-12)
    used = np.ones(shape, np.bool_) if weight is None else weight > 0.0
    np.testing.assert_array_equal(z[used], expected[used])


@pytest.mark.parametrize("shape", [(3, 8), (8, 3), (5, 6), (64, 64), (401, 333), (1000, 401)])
@pytest.mark.parametrize("rule", ["fourth-order", "two-point", "printed"])
def test_without_weights_coarse_slopes_are_those_of_weighted_cells(shape: tuple[int, int], rule: EdgeRule) -> None:
    random = np.random.default_rng(0)
    p, q = (random.normal(size=shape).astype(np.float32) for _ in range(2))
    plain, weighted = (coarser_levels(shape, known)[0] for known in (False, True))
    for level, weight in ((plain, None), (weighted, np.ones(shape, np.float32))):
        coarsen_pixels(FineLevel(p, q, weight, np.float32(1.0), edge_coefficients(rule), 1e-4), level, 0.5)
    np.testing.assert_allclose(plain.slope_x, weighted.slope_x, atol=3e-6)
    np.testing.assert_allclose(plain.slope_y, weighted.slope_y, atol=3e-6)


@pytest.mark.parametrize("shape", [(3, 8), (8, 3), (5, 6), (64, 64), (401, 333), (1000, 402)])
def test_the_same_holds_from_a_level_without_weights_to_the_next(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    edges = [
        random.normal(size=size).astype(np.float32) for size in ((shape[0], shape[1] + 1), (shape[0] + 1, shape[1]))
    ]
    edges[0][:, [0, -1]], edges[1][[0, -1]] = 0.0, 0.0
    found = []
    for weighted in (False, True):
        fine, coarse = new_level(shape, weighted), coarser_levels(shape, weighted)[0]
        fine.slope_x, fine.slope_y = edges
        if weighted:
            fine.weight_x, fine.weight_y = unit_weights(shape)
        coarsen(fine, coarse, 0.5)
        found.append((coarse.slope_x, coarse.slope_y))
    for plain, weighted_slopes in zip(*found, strict=True):
        np.testing.assert_allclose(plain, weighted_slopes, atol=3e-6)


@pytest.mark.parametrize("shape", [(3, 5), (8, 6), (30, 41), (380, 507)])
def test_a_level_without_weights_is_solved_exactly_by_cosines(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(1)
    level = new_level(shape, weighted=False)
    level.slope_x[:], level.slope_y[:] = random.normal(size=level.slope_x.shape), 0.3
    level.slope_x[:, [0, -1]], level.slope_y[[0, -1]] = 0.0, 0.0
    write_divergence(level)
    direct_solver(level)(level)
    left = laplacian(level, level.z.astype(np.float64)) - level.rhs
    assert np.abs(left).max() < 2e-6 * np.abs(level.z).max()
    assert abs(float(level.z.mean(dtype=np.float64))) < 1e-6
    if level.z.size < 100:
        inverted = pseudo_inverse(level) @ level.rhs.ravel().astype(np.float64)
        np.testing.assert_allclose(level.z.ravel(), inverted - inverted.mean(), atol=1e-5)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("times", [1, 2])
def test_the_first_sweep_from_zero_is_that_of_heights_that_are_nought(weighted: bool, times: int) -> None:
    shape, random = (31, 47), np.random.default_rng(2)
    level = new_level(shape, weighted)
    level.rhs[:] = random.normal(size=shape)
    if weighted:
        level.weight_x, level.weight_y = (
            random.uniform(0.1, 1.0, edge.shape).astype(np.float32) for edge in unit_weights(shape)
        )
        level.weight_x[:, [0, -1]], level.weight_y[[0, -1]] = 0.0, 0.0
    found = []
    for start in (None, np.zeros(shape, np.float32)):
        z, coarse_rhs = np.empty(shape, np.float32), np.empty((16, 24), np.float32)
        sweep(level, smoothing(times), start, z, coarse_rhs=coarse_rhs)
        found.append((z, coarse_rhs))
    for from_zero, from_zeros in zip(*found, strict=True):
        np.testing.assert_array_equal(from_zero, from_zeros)


@pytest.mark.parametrize("shape", [(16, 24), (17, 23), (9, 5)])
def test_coarse_slopes_and_offsets_of_a_surface_are_that_surface_whatever_its_weights(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(4)
    z = random.normal(size=shape)
    weight = random.uniform(0.01, 1.0, shape)
    fine = written_edges(weight, np.diff(z, axis=1), np.diff(z, axis=0))
    coarse = new_level(((shape[0] + 1) // 2, (shape[1] + 1) // 2), weighted=True)
    coarsen(fine, coarse, 0.5)
    cells = (z - fine.z)[::2, ::2]
    np.testing.assert_allclose(z - fine.z, np.repeat(np.repeat(cells, 2, 0), 2, 1)[: shape[0], : shape[1]], atol=1e-5)
    np.testing.assert_allclose(coarse.slope_x[:, 1:-1], np.diff(cells, axis=1), atol=2e-5)
    np.testing.assert_allclose(coarse.slope_y[1:-1], np.diff(cells, axis=0), atol=2e-5)


def test_coarse_edges_of_equal_weights_weigh_the_same() -> None:
    fine = written_edges(np.ones((8, 8)), np.zeros((8, 7)), np.zeros((7, 8)))
    coarse = new_level((4, 4), weighted=True)
    coarsen(fine, coarse, 0.5)
    assert coarse.weight_x is not None
    assert coarse.weight_y is not None
    np.testing.assert_allclose(coarse.weight_x[:, 1:-1], 1.0, rtol=1e-6)
    np.testing.assert_allclose(coarse.weight_y[1:-1], 1.0, rtol=1e-6)
    assert not coarse.weight_x[:, [0, -1]].any()
    assert not coarse.weight_y[[0, -1]].any()


def test_components_are_those_of_a_flood_fill() -> None:
    for seed in range(5):
        random = np.random.default_rng(seed)
        weight = (random.random((57, 83)) < 0.6).astype(np.float32)
        components = label_components(weight)
        labels, count = ndimage.label(weight > 0.0)
        assert components.count == count
        z = random.normal(size=weight.shape).astype(np.float32)
        expected = z - ndimage.mean(z, labels, np.arange(count + 1))[labels]
        components.center(z, components.moments(z, weight))
        np.testing.assert_array_equal(np.isnan(z), weight == 0.0)
        np.testing.assert_allclose(z[weight > 0.0], expected[weight > 0.0], atol=1e-5)


@pytest.mark.parametrize("weighted", [False, True])
def test_neither_threads_nor_repetition_change_a_bit(weighted: bool) -> None:
    shape = (1088, 1456)
    _, p, q = noisy(shape)
    gradients = field(p, q, weights(shape) if weighted else np.ones(shape))
    solver = Integrator(shape)
    threads = numba.get_num_threads()
    if threads < 2:
        pytest.skip("a single processor runs one thread only")
    heights = []
    try:
        for count in (1, 2, 2):
            numba.set_num_threads(count)
            heights.append(solver.integrate(gradients, 1.0)[0].z_um)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(heights[0], heights[1])
    np.testing.assert_array_equal(heights[1], heights[2])


@pytest.mark.parametrize("shape", [(3, 3), (64, 96), (65, 96), (1088, 1456)])
def test_a_full_rectangle_that_says_so_has_the_same_heights_with_mean_zero(shape: tuple[int, int]) -> None:
    _, p, q = noisy(shape)
    said = full_rectangle(p.astype(np.float32), q.astype(np.float32))
    height, report = integrate(said, 2.0)
    written, _ = integrate(field(p, q, np.ones(shape)), 2.0)
    np.testing.assert_array_equal(height.z_um, written.z_um)
    assert report.components == 1
    assert abs(float(height.z_um.mean(dtype=np.float64))) < 1e-6 * float(np.abs(height.z_um).max())


def test_a_field_that_says_that_no_pixel_is_valid_is_refused() -> None:
    _, p, q = noisy((8, 8))
    said = full_rectangle(p.astype(np.float32), q.astype(np.float32))
    with pytest.raises(IntegrationError, match="no pixel"):
        integrate(replace(said, valid=np.broadcast_to(np.False_, (8, 8))), 1.0)


@pytest.mark.parametrize("shape", [(240, 320), (151, 203)])
def test_it_agrees_with_the_cosine_transform(shape: tuple[int, int]) -> None:
    _, p, q = noisy(shape)
    gradients = field(p, q, np.ones(shape))
    height, report = integrate(gradients, 5.0, edges="two-point", tolerance_px=1e-5)
    assert report.converged
    expected = integrate_dct(gradients.p, gradients.q, 5.0)
    assert np.abs(height.z_um - expected).max() < 5.0 * 2e-4


def test_full_multigrid_alone_is_as_good_as_the_exact_answer_where_slopes_are_noisy() -> None:
    shape = (544, 728)
    z, p, q = noisy(shape)
    for weight in (np.ones(shape), weights(shape)):
        gradients = field(p, q, weight)
        used = weight > 0.0
        error = []
        for tolerance_px in (None, 1e-5):
            height, report = integrate(gradients, 1.0, tolerance_px=tolerance_px)
            error.append(float(np.std((height.z_um - z)[used])))
            assert report.converged
        assert error[0] < 1.02 * error[1]
    assert error[1] < 0.05


def test_a_groove_with_steep_walls_keeps_its_depth() -> None:
    z = np.zeros((96, 128))
    z[:, 40:88] = -6.0
    z[:, 39] = z[:, 88] = -3.0
    p, q = np.gradient(z, axis=1), np.zeros_like(z)
    height, _ = integrate(field(p, q, np.ones_like(z)), 1.0, edges="two-point")
    depth = height.z_um[:, :30].mean() - height.z_um[:, 50:78].mean()
    assert depth == pytest.approx(6.0, abs=0.01)


def test_cycles_contract_alike_at_every_size() -> None:
    factors = []
    for size in (96, 192, 384, 768):
        _, p, q = noisy((size, size))
        gradients = field(p, q, weights((size, size)))
        _, report = integrate(gradients, 1.0, tolerance_px=1e-7, max_cycles=4)
        factors.append((report.residuals[3] / report.residuals[0]) ** (1.0 / 3.0))
    assert max(factors) < 0.5
    assert max(factors) < 2.0 * min(factors)


def test_a_solver_is_not_marked_by_the_fields_before() -> None:
    shape = (120, 170)
    _, p, q = noisy(shape)
    first, second = field(p, q, np.ones(shape)), field(q, p, weights(shape))
    solver, out = Integrator(shape), np.empty(shape, np.float32)
    for gradients in (first, second, first):
        height, _ = solver.integrate(gradients, 2.0, out=out)
        assert height.z_um is out
        np.testing.assert_array_equal(out, integrate(gradients, 2.0)[0].z_um)
