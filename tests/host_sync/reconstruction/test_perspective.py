"""Heights on the pixels of a camera nearby, beside a dome whose rays are followed."""

from dataclasses import replace

import numpy as np

from device.balls.sphere import Viewpoint
from device.surface import GradientField, HeightMap, integrate_dct
from host_sync.reconstruction.slope_reading import seen_elevation, seen_slopes

SHAPE = (301, 401)
VIEW = Viewpoint(200.0, 150.0, 900.0)
TOP, WIDTH, PLACE = 30.0, 28.0, (70.0, 40.0)
PITCH_UM = 10.0


def dome(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return TOP * np.exp(-0.5 * ((x - PLACE[0]) ** 2 + (y - PLACE[1]) ** 2) / WIDTH**2)


def seen() -> tuple[np.ndarray, GradientField]:
    """Elevation of what each pixel sees, and the slopes of the dome itself there."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    x, y = column - VIEW.column, row - VIEW.row
    z = np.zeros(SHAPE)
    for _ in range(60):
        z = dome(x * (1.0 - z / VIEW.height_px), y * (1.0 - z / VIEW.height_px))
    at = [axis * (1.0 - z / VIEW.height_px) for axis in (x, y)]
    p, q = (np.asarray(-z * (a - c) / WIDTH**2, np.float32) for a, c in zip(at, PLACE, strict=True))
    return z, GradientField(p, q, np.ones(SHAPE, bool), np.ones(SHAPE, np.float32))


def test_heights_rise_over_pixels_as_seen_slopes_say() -> None:
    z, slopes = seen()
    found = seen_slopes(slopes, VIEW, HeightMap(z.astype(np.float32), 1.0))
    q, p = np.gradient(z)
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(found.p[inner], p[inner], atol=2e-3)
    np.testing.assert_allclose(found.q[inner], q[inner], atol=2e-3)
    assert np.abs(slopes.p - p).max() > 0.03


def test_elevation_need_not_be_known_to_integrate() -> None:
    z, slopes = seen()
    before = seen_slopes(slopes, VIEW)
    height = HeightMap(integrate_dct(before.p, before.q, PITCH_UM), PITCH_UM)
    height = replace(height, z_um=height.z_um - height.z_um[0, 0])
    found = seen_elevation(height, VIEW).z_um / PITCH_UM
    np.testing.assert_allclose(found, z, atol=0.03)
    straight = integrate_dct(slopes.p, slopes.q, 1.0)
    assert np.abs(straight - straight[0, 0] - z).max() > 0.5


def test_results_may_replace_what_they_come_from() -> None:
    z, slopes = seen()
    apart = seen_slopes(slopes, VIEW, HeightMap(z.astype(np.float32), 1.0))
    own = replace(slopes, p=slopes.p.copy(), q=slopes.q.copy())
    np.testing.assert_array_equal(seen_slopes(own, VIEW, HeightMap(z.astype(np.float32), 1.0), out=own).p, apart.p)
    heights = z.astype(np.float32)
    expected = seen_elevation(HeightMap(heights, 1.0), VIEW).z_um
    np.testing.assert_array_equal(seen_elevation(HeightMap(heights, 1.0), VIEW, out=heights).z_um, expected)


def test_invalid_heights_stay_invalid() -> None:
    heights = np.full(SHAPE, 5.0, np.float32)
    heights[3, 4] = np.nan
    assert np.isnan(seen_elevation(HeightMap(heights, 1.0), VIEW).z_um).sum() == 1


def test_skin_whose_height_is_not_known_counts_as_untouched() -> None:
    z, slopes = seen()
    holed, level = z.astype(np.float32), z.astype(np.float32)
    holed[140:150, 100:120], level[140:150, 100:120] = np.nan, 0.0
    found = seen_slopes(slopes, VIEW, HeightMap(holed * np.float32(PITCH_UM), PITCH_UM))
    wanted = seen_slopes(slopes, VIEW, HeightMap(level * np.float32(PITCH_UM), PITCH_UM))
    np.testing.assert_array_equal(found.p, wanted.p)
    np.testing.assert_array_equal(found.q, wanted.q)
