import msgspec
import numpy as np
import pytest

from hal.board_profile import BoardProfile
from hal.simulator.lens import Lens
from hal.simulator.surfaces import Block, Plane, Sphere


def bent(profile: BoardProfile, distortion: float) -> Lens:
    assert profile.twin is not None
    return Lens.of(msgspec.structs.replace(profile, twin=msgspec.structs.replace(profile.twin, distortion=distortion)))


@pytest.mark.parametrize("distortion", [0.0, 0.05])
def test_each_pixel_sees_a_point_of_the_object(profile: BoardProfile, distortion: float) -> None:
    lens, centre_mm, top_mm = bent(profile, distortion), (4.0, -2.0), 1.2
    height = lens.see(Sphere(3.0), centre_mm, 0.3, top_mm)
    near = height > 0.0
    x, y = lens.points_mm(height)
    off = (x - centre_mm[0]) ** 2 + (y - centre_mm[1]) ** 2 + (height - (top_mm - 3.0)) ** 2
    assert near.sum() > 1000
    np.testing.assert_allclose(np.sqrt(off[near]), 3.0, atol=5e-5)


@pytest.mark.parametrize("distortion", [0.0, 0.05])
def test_slopes_are_those_of_the_object_not_of_the_picture(profile: BoardProfile, distortion: float) -> None:
    lens, centre_mm, top_mm = bent(profile, distortion), (5.0, -3.0), 1.2
    height = lens.see(Sphere(3.0), centre_mm, 0.0, top_mm).astype(np.float64)
    slope_x, slope_y = lens.skin_slopes(height)
    x, y = lens.points_mm(height)
    inner = height > 0.5
    depth = height - (top_mm - 3.0)
    np.testing.assert_allclose(slope_x[inner], ((centre_mm[0] - x) / depth)[inner], atol=1e-3)
    np.testing.assert_allclose(slope_y[inner], ((centre_mm[1] - y) / depth)[inner], atol=1e-3)


def test_what_is_nearer_looks_larger(profile: BoardProfile) -> None:
    lens = Lens.of(profile)
    plate = Plane(Block(3.0, 2.0), 0.0, 0.0)
    low, high = (np.isfinite(lens.see(plate, (0.0, 0.0), 0.0, top)).sum() for top in (0.0, 2.4))
    # The rounded sides belong to the plate and lie a little lower than its face.
    assert high / low == pytest.approx((1.0 / (1.0 - 2.4 / lens.distance_mm)) ** 2, rel=0.01)


def test_barrel_distortion_widens_the_field(profile: BoardProfile) -> None:
    x, y = bent(profile, 0.05).aim_mm()
    plain = Lens.of(profile)
    assert np.hypot(x, y)[0, 0] == pytest.approx(1.05 * plain.corner_mm, rel=1e-4)
    middle = (y.shape[0] // 2, x.shape[1] // 2)
    assert x[middle] == pytest.approx(plain.column_mm[0, middle[1]], rel=1e-4)


def test_point_spread_keeps_the_light_and_spreads_a_point(profile: BoardProfile) -> None:
    lens = Lens.of(profile)
    point = np.zeros((lens.row_mm.size, lens.column_mm.size), np.float32)
    point[136, 182] = 1.0
    seen = lens.transmit(point, np.zeros_like(point))
    assert seen.sum() == pytest.approx(1.0, rel=1e-3)
    spread = (seen * (np.arange(seen.shape[1]) - 182) ** 2).sum()
    assert np.sqrt(spread) == pytest.approx(lens.point_spread_px, abs=0.05)


def test_vignetting_darkens_the_corner(profile: BoardProfile) -> None:
    lens = Lens.of(profile)
    even = np.ones((lens.row_mm.size, lens.column_mm.size), np.float32)
    seen = lens.transmit(even, np.zeros_like(even))
    assert seen[136, 182] == pytest.approx(1.0, abs=1e-3)
    assert seen[0, 0] == pytest.approx(1.0 - lens.vignetting, abs=5e-3)
