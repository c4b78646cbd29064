import numba
import numpy as np
import pytest

from host_sync.johnson2009.gradient_kernel import GateSettings, decay, estimate_slopes, judge_candidate
from host_sync.johnson2009.lookup_table import LookupTable

JACOBIAN = np.array([[0.8, 0.1], [-0.5, 0.7], [-0.3, -0.9]])
CENTRE = np.array([1.0, 1.1, 0.9])
LOW, STEP, BINS = np.zeros(3, np.float32), np.full(3, 1.0, np.float32), 2


def settings(**changes):
    chosen = {
        "tikhonov": 1e-6, "gate": 1e-4, "noise": 0.0, "flat_variance": 10.0, "trusted": 1.0, "lost": 9.0
    } | changes  # fmt: skip
    return GateSettings(**{name: np.float32(value) for name, value in chosen.items()})


def candidate(p, q, colour, jacobian):
    return np.array([p, q, *colour, *jacobian.ravel(), 0.0], np.float32)


def estimate(values, candidates, **changes):
    """Slopes of an image under a table whose every bin holds the same candidates."""
    table = LookupTable(
        LOW, STEP, np.zeros((BINS,) * 3, np.int32), np.array([0, len(candidates)], np.int32), np.stack(candidates)
    )  # fmt: skip
    return estimate_slopes(values.astype(np.float32), np.ones(values.shape[:2], bool), table, settings(**changes))


def quadratic(rows=24, columns=300, bend=1e-3):
    """Slopes of a surface with a constant Hessian."""
    row, column = np.mgrid[:rows, :columns].astype(float)
    p = bend * (1.0 * (column - columns / 2) + 0.3 * (row - rows / 2))
    q = bend * (0.3 * (column - columns / 2) - 0.6 * (row - rows / 2))
    return p, q


def test_a_linear_reflectance_is_inverted_exactly_and_the_gate_stays_open():
    p, q = quadratic()
    values = CENTRE + np.stack([p, q], axis=-1) @ JACOBIAN.T
    found = estimate(values, [candidate(0.0, 0.0, CENTRE, JACOBIAN)])
    inner = (slice(1, -1), slice(1, -1))
    np.testing.assert_allclose(found[0][inner], p[inner], atol=2e-6)
    np.testing.assert_allclose(found[1][inner], q[inner], atol=2e-6)


def judged(across, down, **changes):
    c = tuple(candidate(0.1, -0.2, CENTRE, JACOBIAN)[:11])
    colour = tuple((CENTRE + JACOBIAN @ [0.05, 0.02]).astype(np.float32))
    pair = (tuple(np.float32(v) for v in across), tuple(np.float32(v) for v in down))
    return judge_candidate(c, colour, *pair, settings(tikhonov=1e-7, **changes))


def test_epsilon_vanishes_for_a_consistent_hessian_and_not_for_a_twisted_one():
    hessian = np.array([[0.02, 0.01], [0.01, -0.03]])
    *_, error = judged(*(JACOBIAN @ hessian).T)
    assert error == pytest.approx(0.0, abs=1e-6)
    twisted = np.array([[0.02, 0.02], [-0.02, -0.03]])
    *_, error = judged(*(JACOBIAN @ twisted).T)
    antisymmetric = np.array([[0.0, 0.02], [-0.02, 0.0]])
    assert error == pytest.approx(np.sum((JACOBIAN @ antisymmetric) ** 2), rel=1e-3)


def test_large_errors_fall_back_to_the_coarse_slope_small_ones_refine():
    hessian = np.array([[0.02, 0.01], [0.01, -0.03]])
    fine = judged(*(JACOBIAN @ hessian).T)
    np.testing.assert_allclose(fine[:2], [0.15, -0.18], atol=1e-5)
    coarse = judged(*(JACOBIAN @ np.array([[0.0, 0.5], [-0.5, 0.0]])).T)
    np.testing.assert_allclose(coarse[:2], [0.1, -0.2], atol=1e-5)
    assert coarse[2] < 0.01 * fine[2]


def test_decay_is_the_exponential():
    x = np.linspace(0.0, 40.0, 400, dtype=np.float32)
    np.testing.assert_allclose([decay(value) for value in x], np.exp(-x), atol=1e-5)


def test_gradients_are_exact_on_a_ramp_across_tiles_and_rows():
    """A Hessian error appears where a difference crosses a tile's border wrongly."""
    p, q = quadratic(columns=700)
    values = CENTRE + np.stack([p, q], axis=-1) @ JACOBIAN.T
    found = estimate(values, [candidate(0.0, 0.0, CENTRE, JACOBIAN)], gate=1e-9)
    inner = (slice(1, -1), slice(1, -1))
    np.testing.assert_allclose(found[0][inner], p[inner], atol=1e-3)


def test_epsilon_alone_chooses_among_candidates():
    """The nearer colour loses when the pixel's neighbourhood contradicts its reflectance."""
    p, q = quadratic(columns=200, bend=2e-3)
    values = CENTRE + np.stack([p, q], axis=-1) @ JACOBIAN.T
    turned = JACOBIAN @ np.array([[0.0, -1.0], [1.0, 0.0]])
    away = candidate(-0.3, 0.2, CENTRE + JACOBIAN @ [-0.3, 0.2], JACOBIAN)
    for pair in ([candidate(0.7, 0.7, CENTRE, turned), away], [away, candidate(0.7, 0.7, CENTRE, turned)]):
        found = estimate(values, pair)
        inner = (slice(1, -1), slice(1, -1))
        np.testing.assert_allclose(found[0][inner], p[inner], atol=1e-5)
        np.testing.assert_allclose(found[1][inner], q[inner], atol=1e-5)


def test_one_thread_and_two_give_the_same_bits():
    rng = np.random.default_rng(0)
    values = CENTRE + 0.1 * rng.standard_normal((70, 530, 3))
    pair = [candidate(0.3, 0.1, CENTRE, JACOBIAN), candidate(-0.3, 0.1, CENTRE, JACOBIAN[:, ::-1])]
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            results.append(estimate(values, pair))
    finally:
        numba.set_num_threads(before)
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)
