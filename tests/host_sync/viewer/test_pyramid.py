import numpy as np
import pytest

from host_sync.viewer.cache import coarse_levels, finest_rows, level_count, padded_shape


def rippled(shape: tuple[int, int] = (190, 250)) -> np.ndarray:
    row, column = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    return (30.0 * np.sin(column / 3.0) + 0.5 * row + 900.0).astype(np.float32)


def heights(surface: np.ndarray) -> np.ndarray:
    return surface[..., 2].astype(np.float64) + surface[..., 3]


def test_the_finest_level_is_the_height_map_itself() -> None:
    z = rippled()
    above = coarse_levels(z, 2.0)[0]
    rows = padded_shape(z.shape)[0]
    bands = [finest_rows(z, 2.0, above, first, min(first + 50, rows)) for first in range(0, rows, 50)]
    surface = np.concatenate([band.surface for band in bands])[: z.shape[0], : z.shape[1]]
    valid = np.concatenate([band.valid for band in bands])
    np.testing.assert_allclose(heights(surface), z, rtol=1e-6)
    q, p = np.gradient(z / 2.0)
    np.testing.assert_allclose(surface[..., 0], p, atol=4e-3)
    np.testing.assert_allclose(surface[..., 1], q, atol=4e-3)
    assert valid.shape == padded_shape(z.shape)
    assert (valid[: z.shape[0], : z.shape[1]] == 255).all()
    assert not valid[z.shape[0] :].any()
    assert not valid[:, z.shape[1] :].any()


def test_a_level_holds_the_means_of_slopes_and_not_the_slopes_of_few_pixels() -> None:
    """Ripples shorter than a cell vanish from the slope, as they do for an eye further away: nothing sparkles."""
    z = rippled()
    levels = coarse_levels(z, 2.0)
    _, p = np.gradient(z / 2.0)
    for number, level in enumerate(levels, start=1):
        side = 2**number
        rows, columns = (size // side for size in z.shape)
        whole = p[: rows * side, : columns * side].reshape(rows, side, columns, side).mean(axis=(1, 3))
        np.testing.assert_allclose(level.surface[:rows, :columns, 0], whole, atol=4e-3)
    assert len(levels) == level_count(z.shape) - 1


def test_invalid_pixels_neither_count_nor_pull_heights_down() -> None:
    z = rippled((192, 256))
    truth = z.copy()
    z[64:96, 64:128] = np.nan
    z[10, 10] = np.nan
    level = coarse_levels(z, 2.0)[0]
    hole = heights(level.surface)[34:46, 34:62]
    assert (level.valid[34:46, 34:62] == 0).all()
    assert 850.0 < hole.min() <= hole.max() < 1050.0
    beside = heights(level.surface)[4:7, 4:7]
    np.testing.assert_allclose(beside, truth[8:14, 8:14].reshape(3, 2, 3, 2).mean(axis=(1, 3)), atol=16.0)
    assert 0 < level.valid[5, 5] < 255 or level.valid[4, 5] < 255


@pytest.mark.parametrize("shape", [(2, 2), (3, 97), (97, 3), (1000, 700)])
def test_every_size_has_levels_that_lie_on_each_other(shape: tuple[int, int]) -> None:
    z = np.zeros(shape, np.float32)
    rows, columns = padded_shape(shape)
    levels = coarse_levels(z, 1.0)
    assert [level.valid.shape for level in levels] == [
        (rows >> number, columns >> number) for number in range(1, level_count(shape))
    ]
    assert finest_rows(z, 1.0, levels[0] if levels else None, 0, rows).valid.shape == (rows, columns)


def test_a_map_without_a_valid_pixel_is_all_hole() -> None:
    levels = coarse_levels(np.full((200, 300), np.nan, np.float32), 1.0)
    assert not any(level.valid.any() for level in levels)
    assert all(np.isfinite(level.surface.astype(np.float32)).all() for level in levels)
