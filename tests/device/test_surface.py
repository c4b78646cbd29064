import numpy as np
import pytest

from device.surface import integrate_dct


def slopes_of(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes whose means over neighbouring pixels are exactly the differences of z along columns and rows."""
    q, p = np.gradient(z)
    return p.astype(np.float32), q.astype(np.float32)


@pytest.mark.parametrize("shape", [(3, 3), (3, 40), (64, 64), (51, 130)])
def test_a_tilted_plane_comes_back(shape: tuple[int, int]) -> None:
    row, column = np.mgrid[: shape[0], : shape[1]]
    z = 0.3 * column - 0.2 * row
    found = integrate_dct(*slopes_of(z), 2.0)
    np.testing.assert_allclose(found, 2.0 * (z - z.mean()), atol=1e-3)


def test_a_smooth_surface_comes_back_with_its_borders() -> None:
    row, column = np.mgrid[:120, :160] / 40.0
    z = 20.0 * np.sin(column) * np.cos(0.7 * row) + 5.0 * column
    p = (20.0 * np.cos(column) * np.cos(0.7 * row) + 5.0) / 40.0
    q = -14.0 * np.sin(column) * np.sin(0.7 * row) / 40.0
    found = integrate_dct(p.astype(np.float32), q.astype(np.float32), 1.0)
    assert np.abs(found - (z - z.mean())).max() < 0.01


def test_it_is_the_least_squares_surface_of_slopes_that_belong_to_none() -> None:
    random = np.random.default_rng(0)
    p, q = (random.normal(0, 0.1, (12, 15)).astype(np.float32) for _ in range(2))
    found = integrate_dct(p, q, 1.0).astype(np.float64)
    number = np.arange(p.size).reshape(p.shape)
    rows, targets = [], []
    for tail, head, slope in (
        (number[:, :-1], number[:, 1:], 0.5 * (p[:, 1:] + p[:, :-1])),
        (number[:-1], number[1:], 0.5 * (q[1:] + q[:-1])),
    ):
        for a, b, g in zip(tail.ravel(), head.ravel(), slope.ravel(), strict=True):
            equation = np.zeros(p.size)
            equation[a], equation[b] = -1.0, 1.0
            rows.append(equation)
            targets.append(g)
    best = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0].reshape(p.shape)
    np.testing.assert_allclose(found, best - best.mean(), atol=1e-5)
