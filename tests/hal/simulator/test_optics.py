import dataclasses

import numpy as np
import pytest

from hal.board_profile import BoardProfile
from hal.simulator.lens import Lens
from hal.simulator.scene import coat, radiance, skin_geometry, visible_fraction

LIGHT_MM = (18.0, 5.0, 12.5)


@pytest.fixture
def lens(profile: BoardProfile) -> Lens:
    """A camera so far away that every pixel looks straight down."""
    return dataclasses.replace(Lens.of(profile), distance_mm=1e6)


def tilted(lens: Lens, slope_x: float) -> np.ndarray:
    rows = lens.row_mm.size
    return np.repeat(lens.column_mm * np.float32(slope_x), rows, axis=0)


def test_flat_skin_under_a_near_light_follows_fall_off_and_cosine(lens: Lens) -> None:
    flat = skin_geometry(lens, tilted(lens, 0.0))
    seen = radiance(flat, lens, coat("diffuse"), LIGHT_MM, 1.0)
    squared = (LIGHT_MM[0] - lens.column_mm) ** 2 + (LIGHT_MM[1] - lens.row_mm) ** 2 + LIGHT_MM[2] ** 2
    np.testing.assert_allclose(seen, 25.0**2 * LIGHT_MM[2] / squared**1.5, rtol=1e-4)


def test_skin_that_faces_a_light_25_mm_away_has_radiance_one(lens: Lens) -> None:
    slope = -np.tan(np.radians(60.0))
    place = (25.0 * np.cos(np.radians(30.0)), 0.0, 25.0 * np.sin(np.radians(30.0)))
    facing = skin_geometry(lens, tilted(lens, slope))
    seen = radiance(facing, lens, coat("diffuse"), place, 1.0)
    assert seen[lens.row_mm.size // 2, lens.column_mm.size // 2] == pytest.approx(1.0, abs=5e-3)


def test_skin_turned_away_is_dark(lens: Lens) -> None:
    away = skin_geometry(lens, tilted(lens, 2.0))
    assert radiance(away, lens, coat("diffuse"), (21.7, 0.0, 0.5), 1.0)[:, 300:].max() == 0.0


@pytest.mark.parametrize(("name", "half_width_deg"), [("flake", 20.0), ("sharp-flake", 8.0)])
def test_flakes_shine_where_the_normal_halves_the_angle_and_half_as_much_at_the_half_width(
    lens: Lens, name: str, half_width_deg: float
) -> None:
    far = (2.5e5 * np.cos(np.radians(30.0)), 0.0, 2.5e5 * np.sin(np.radians(30.0)))
    shine = {}
    for turned_deg in (30.0, 30.0 - half_width_deg):
        skin = skin_geometry(lens, tilted(lens, -np.tan(np.radians(turned_deg))))
        seen, plain = (radiance(skin, lens, coat(c), far, 1.0)[136, 182] for c in (name, "diffuse"))
        # Half of the skin is Lambertian; grazing flakes shade one another by c / (c + 0.1).
        cosine = np.cos(np.radians(60.0 - turned_deg))
        shine[turned_deg] = (seen / plain * cosine - 0.5 * cosine) / 0.5 * (cosine + 0.1) / cosine
    assert shine[30.0] == pytest.approx(1.0, rel=1e-2)
    assert shine[30.0 - half_width_deg] == pytest.approx(0.5, rel=1e-2)


@pytest.mark.parametrize("elevation_deg", [20.0, 30.0, 45.0])
def test_a_wall_casts_a_shadow_of_its_own_height_over_the_tangent(elevation_deg: float) -> None:
    pitch_mm, wall_mm = 0.05, 1.0
    height = np.zeros((120, 320), np.float32)
    height[:, 220:] = wall_mm
    light_mm = (1e5 * np.cos(np.radians(elevation_deg)), 0.0, 1e5 * np.sin(np.radians(elevation_deg)))
    share = visible_fraction(height, pitch_mm, light_mm, 1.0)[60]
    length_mm = (share[:220] < 0.5).sum() * pitch_mm
    assert length_mm == pytest.approx(wall_mm / np.tan(np.radians(elevation_deg)), abs=2.0 * pitch_mm)
    assert (share[225:] == 1.0).all()
    assert (share[:100] == 1.0).all()


def test_a_larger_light_softens_the_edge_of_the_shadow() -> None:
    height = np.zeros((120, 320), np.float32)
    height[:, 220:] = 1.0
    soft = []
    for radius_mm in (0.2, 2.0):
        share = visible_fraction(height, 0.05, (30.0, 0.0, 17.0), radius_mm)[60, :220]
        soft.append(int(((share > 0.02) & (share < 0.98)).sum()))
    assert soft[1] > 3 * soft[0]


def test_flat_skin_hides_no_light() -> None:
    share = visible_fraction(np.zeros((272, 364), np.float32), 0.048, LIGHT_MM, 1.0)
    assert (share == 1.0).all()
