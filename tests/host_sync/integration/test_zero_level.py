"""The zero of height maps of known surfaces: free skin, objects over the border, none free, uneven skin."""

import numpy as np
import pytest

from device.surface import GradientField, HeightMap
from host_sync.integration.zero_level import ZERO_SIGMA_BY_SPREAD, block_medians, find_datum

SHAPE, PITCH_UM = (240, 320), 10.0
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)


def gradients_of(z_um: np.ndarray) -> GradientField:
    q, p = (part + 0.01 * np.random.default_rng(0).standard_normal(SHAPE) for part in np.gradient(z_um / PITCH_UM))
    return GradientField(p.astype(np.float32), q.astype(np.float32), np.ones(SHAPE, bool), np.ones(SHAPE, np.float32))


def datum_of(z_um: np.ndarray, off_um: float = 0.0):
    return find_datum(HeightMap((z_um + off_um).astype(np.float32), PITCH_UM), gradients_of(z_um))


def soft_step(distance: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(np.clip(distance / 3.0, -50.0, 50.0)))


def test_the_zero_is_the_skin_around_an_object() -> None:
    disc = 100.0 * soft_step(np.hypot(ROW - 120.0, COLUMN - 160.0) - 60.0)
    found = datum_of(disc, 33.0)
    assert not found.is_relative
    assert found.zero_um == pytest.approx(33.0, abs=0.2)
    assert found.spread_um < 0.2
    assert not found.skin[120, 160]


def test_a_plate_beyond_the_border_is_not_taken_for_zero_though_it_is_most_of_the_field() -> None:
    plate = 100.0 * soft_step(np.abs(COLUMN - 140.0) - 115.0)
    found = datum_of(plate)
    assert found.zero_um == pytest.approx(0.0, abs=0.5)
    assert not found.skin[:, 140].any()


def corners(depth: int) -> np.ndarray:
    """Return where skin lies at rest in the four corners, as rectangles of `depth` x `depth` pixels."""
    return (np.minimum(ROW, SHAPE[0] - 1 - ROW) < depth) & (np.minimum(COLUMN, SHAPE[1] - 1 - COLUMN) < depth)


@pytest.mark.parametrize(("depth", "has_zero"), [(28, True), (16, False)])
def test_four_corners_at_rest_by_their_light_make_up_a_zero_together(depth: int, *, has_zero: bool) -> None:
    """Each has 1 % of the field, or a third of that."""
    block = 100.0 * soft_step(np.maximum(np.abs(ROW - 120.0) - 60.0, np.abs(COLUMN - 160.0) - 90.0))
    height = HeightMap((block + 33.0).astype(np.float32), PITCH_UM)
    found = find_datum(height, gradients_of(block), at_rest=corners(depth))
    assert found.is_relative != has_zero
    if has_zero:
        assert found.zero_um == pytest.approx(33.0, abs=0.5)
        assert found.blocks == 4


def test_small_skin_at_rest_below_a_large_part_of_it_is_not_the_zero() -> None:
    surface = np.where((ROW > 200) & (COLUMN > 280), -30.0, 0.0) + 100.0 * soft_step(ROW - 60.0)
    at_rest = ((ROW > 215) & (COLUMN > 295)) | ((ROW > 120) & (COLUMN < 200))
    found = find_datum(HeightMap(surface.astype(np.float32), PITCH_UM), gradients_of(surface), at_rest=at_rest)
    assert found.zero_um == pytest.approx(0.0, abs=0.5)


def test_skin_that_sinks_gently_towards_rest_does_not_raise_the_zero() -> None:
    """The skin's lift falls off over 40 px: under 0.01 of slope from 130 px on, where it still stands 2 um high."""
    away = np.maximum(COLUMN - 40.0, 0.0)
    found = datum_of(60.0 * np.exp(-away / 40.0))
    assert found.zero_um < 0.7
    assert not found.skin[:, :150].any()


def test_uneven_skin_at_rest_says_how_unsure_its_zero_is() -> None:
    bowl = 4.0 * ((COLUMN - 160.0) / 160.0) ** 2 + 2.0 * ((ROW - 120.0) / 120.0)
    found = datum_of(bowl)
    assert found.spread_um == pytest.approx(bowl.std(), rel=0.15)
    assert found.zero_um == pytest.approx(bowl.mean(), abs=0.5)
    assert found.zero_sigma_um == pytest.approx(ZERO_SIGMA_BY_SPREAD * found.spread_um)


@pytest.mark.parametrize("kind", ["tilted", "rough"])
def test_where_no_skin_lies_at_rest_heights_are_relative(kind: str) -> None:
    rough = np.random.default_rng(1).standard_normal(SHAPE)
    frequency = np.hypot(np.fft.fftfreq(SHAPE[0])[:, None], np.fft.fftfreq(SHAPE[1])[None, :])
    rough = np.fft.ifft2(np.fft.fft2(rough) * (frequency > 1.0 / 40.0) * (frequency < 1.0 / 6.0)).real
    surface = 3.0 * (COLUMN + ROW) if kind == "tilted" else 10.0 * rough / rough.std()
    found = datum_of(surface)
    assert found.is_relative
    assert found.zero_sigma_um == found.spread_um
    assert found.spread_um == pytest.approx(surface.std(), rel=0.05)
    assert found.level(HeightMap(surface.astype(np.float32), PITCH_UM)).z_um.mean() == pytest.approx(0.0, abs=1.0)


@pytest.mark.parametrize(("deepest_um", "is_zero"), [(60.0, False), (2.0, True)])
def test_skin_that_lies_over_other_skin_is_no_zero(deepest_um: float, is_zero: bool) -> None:
    """Objects press skin towards the camera: a valley shows that its flat surroundings are touched."""
    valley = -deepest_um * np.exp(-((ROW - 120.0) ** 2 + (COLUMN - 160.0) ** 2) / (2.0 * 30.0**2))
    assert datum_of(valley).is_relative != is_zero
    height = HeightMap(valley.astype(np.float32), PITCH_UM)
    assert not find_datum(height, gradients_of(valley), are_its_own=True).is_relative


def test_medians_of_blocks_are_those_of_their_skin_alone() -> None:
    """Blocks of 30 x 30 cells; a block with fewer than eight cells of skin has no median."""
    z_um = np.random.default_rng(5).normal(size=(70, 240)).astype(np.float32)
    skin = z_um > -1.0
    z_um[:5] = np.nan
    skin[30:60, :30] = False
    skin[30, :7] = True
    blocks = [(slice(r, r + 30), slice(c, c + 30)) for r in (0, 30, 60) for c in range(0, 240, 30)]
    known = [z_um[here][skin[here] & np.isfinite(z_um[here])] for here in blocks]
    assert [len(own) for own in known].count(7) == 1
    np.testing.assert_array_equal(block_medians(z_um, skin), [np.median(own) for own in known if len(own) != 7])
