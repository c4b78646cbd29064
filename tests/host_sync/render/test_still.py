import numpy as np
import pytest

from device.surface import HeightMap
from host_sync.errors import RenderError
from host_sync.render.relief_sheet import CELL_PX, contact_sheet
from host_sync.render.shading import ambient_occlusion, shade, shadow_mask
from host_sync.render.still import Still, Viewpoint, project, render, turning_pictures

WHITE = 255


def cone(rows: int = 120, columns: int = 160, steep: float = 0.5) -> HeightMap:
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    far = np.hypot(row - 60.0, column - 80.0)
    return HeightMap(np.maximum(0.0, steep * (40.0 - far)).astype(np.float32) * 10.0, 10.0)


def test_from_above_it_is_the_papers_shading() -> None:
    height = cone()
    still = Still(columns=160, exaggeration=1.0, colour="white", light_azimuth_deg=30.0, light_elevation_deg=55.0)
    expected = np.round(255.0 * shade(height, 30.0, 55.0))
    np.testing.assert_allclose(render(height, still)[..., 1], expected, atol=1.0)


def test_the_light_stands_where_it_was_put() -> None:
    height = cone()
    from_right = render(height, Still(columns=160, exaggeration=1.0, colour="white", light_azimuth_deg=0.0))
    assert from_right[60, 100, 0] > from_right[60, 60, 0] + 30
    from_above = render(height, Still(columns=160, exaggeration=1.0, colour="white", light_azimuth_deg=90.0))
    assert from_above[40, 80, 0] > from_above[80, 80, 0] + 30


def test_seen_from_the_side_the_outline_is_the_profile() -> None:
    """A cone 200 µm high and 800 µm wide, doubled, seen nearly along its plane: as high as half its width."""
    height = cone()
    view = Viewpoint(azimuth_deg=270.0, elevation_deg=0.01)
    seen = render(height, Still(columns=640, viewpoint=view, exaggeration=2.0, colour="white"))
    drawn = (seen != WHITE).any(axis=2)
    tall = drawn.sum(axis=0)
    middle = tall[300:340].max()
    pixels_per_um = 640 / 1.04 / 1590.0
    assert middle == pytest.approx(400.0 * pixels_per_um, abs=4.0)
    assert tall[480] < 6


def test_what_is_nearer_hides_what_is_behind() -> None:
    z = np.zeros((100, 100), np.float32)
    z[60:64, 20:80] = 300.0
    view = Viewpoint(azimuth_deg=270.0, elevation_deg=30.0)
    colours = project(HeightMap(z, 10.0), view, 1.0, 400)
    wall_top = colours.y[61, 50]
    behind = colours.y[50, 50]
    assert wall_top < behind  # the wall reaches above the ground behind it
    seen = render(HeightMap(z, 10.0), Still(columns=200, viewpoint=view, exaggeration=1.0, colour="height"))
    row = round(float(behind) / 2)
    ground = seen[row, 12].astype(int)
    assert np.abs(seen[row, 100].astype(int) - ground).max() > 20


def test_invalid_pixels_are_holes() -> None:
    height = cone()
    height.z_um[50:70, 70:90] = np.nan
    seen = render(height, Still(columns=160, viewpoint=Viewpoint(270.0, 89.9), exaggeration=1.0, colour="height"))
    middle = seen[seen.shape[0] // 2, seen.shape[1] // 2]
    assert (middle == WHITE).all()
    assert (seen[seen.shape[0] // 2, 20] != WHITE).any()


def test_a_wall_throws_a_shadow_as_long_as_its_height_over_the_tangent() -> None:
    z = np.zeros((40, 200), np.float32)
    z[:, 95:100] = 200.0
    share = shadow_mask(HeightMap(z, 10.0), 1.0, azimuth_deg=180.0, elevation_deg=30.0)
    dark = np.flatnonzero(share[20] < 0.5)
    assert dark.min() == 100
    assert (dark.max() - 99) * 10.0 == pytest.approx(200.0 / np.tan(np.radians(30.0)), abs=40.0)
    assert (share[20, :95] == 1.0).all()


def test_a_plane_sees_the_whole_sky_and_a_pit_less() -> None:
    z = np.zeros((80, 80), np.float32)
    assert ambient_occlusion(HeightMap(z, 10.0), 1.0).min() == pytest.approx(1.0)
    z[30:50, 30:50] = -200.0
    share = ambient_occlusion(HeightMap(z, 10.0), 1.0)
    assert share[40, 40] < 0.6 < share[5, 5]


def test_a_large_map_is_averaged_and_not_picked_from() -> None:
    """A ripple of two pixels is gone from a picture of a tenth of the size: no moiré."""
    column = np.arange(2000)
    z = np.repeat((5.0 * (column % 2)).astype(np.float32)[None], 400, axis=0)
    seen = render(HeightMap(z, 10.0), Still(columns=200, exaggeration=1.0, colour="white"))
    assert np.ptp(seen[5:-5, 5:-5].astype(int)) <= 1


def test_holes_do_not_grow_when_a_map_is_reduced() -> None:
    z = np.zeros((400, 800), np.float32)
    z[::10, ::10] = np.nan
    seen = render(HeightMap(z, 10.0), Still(columns=80, exaggeration=1.0, colour="height"))
    assert (seen != WHITE).any(axis=2).all()


def test_a_turntables_pictures_have_one_even_size_and_return() -> None:
    pictures = list(turning_pictures(cone(), Still(columns=150, exaggeration=1.0), frames=4))
    assert {picture.shape for picture in pictures} == {pictures[0].shape}
    assert all(side % 2 == 0 for side in pictures[0].shape[:2])
    assert all((picture != WHITE).any() for picture in pictures)
    assert (pictures[0] != pictures[1]).any()


def test_a_contact_sheet_has_room_for_all() -> None:
    picture = np.zeros((300, CELL_PX, 3), np.uint8)
    sheet = contact_sheet([(f"scan \x1b[31m {n}", "17 mm", picture) for n in range(5)], across=2)
    assert sheet.shape[1] < 3 * CELL_PX
    assert sheet.shape[0] > 3 * 300


@pytest.mark.parametrize(
    "change",
    [
        {"columns": 4},
        {"columns": 10**6},
        {"light_elevation_deg": 0.0},
        {"exaggeration": -1.0},
        {"exaggeration": float("nan")},
        {"viewpoint": Viewpoint(elevation_deg=-5.0)},
        {"viewpoint": Viewpoint(field_deg=170.0)},
        {"light_azimuth_deg": np.nan},
        {"viewpoint": Viewpoint(azimuth_deg=np.nan)},
        {"range_um": (-np.inf, np.inf)},
    ],
)
def test_what_no_picture_can_be_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(RenderError):
        Still(**change)


def test_a_map_without_a_valid_pixel_is_refused() -> None:
    with pytest.raises(RenderError, match="no valid pixel"):
        render(HeightMap(np.full((20, 20), np.nan, np.float32), 1.0), Still())


@pytest.mark.parametrize("azimuth_deg", [0.0, 30.0, 45.0, 90.0, 135.0, 200.0, 315.0])
def test_a_tilted_plane_is_not_in_its_own_shadow_before_the_light_grazes_it(azimuth_deg: float) -> None:
    """It rises towards the light by 34 of the light's 40 degrees, so that the whole light reaches it."""
    row, column = np.mgrid[:40, :50].astype(np.float32)
    turn = np.radians(azimuth_deg)
    towards = column * np.cos(turn) - row * np.sin(turn)
    height = HeightMap((np.tan(np.radians(34.0)) * 10.0 * towards).astype(np.float32), 10.0)
    np.testing.assert_array_equal(shadow_mask(height, 1.0, azimuth_deg, 40.0), 1.0)
    assert (shadow_mask(height, 1.0, azimuth_deg, 28.0)[15:25, 20:30] == 0.0).all()
