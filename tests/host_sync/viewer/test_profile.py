import numpy as np
import pytest

from host_sync.errors import ViewError
from host_sync.profile.profile_line import Line
from host_sync.viewer.responses import MeasuredLine, measure_line

Z = np.random.default_rng(3).normal(size=(40, 60)).astype(np.float32)


def profile(z_um: np.ndarray, pitch_um: float, ends: tuple[float, ...], **known: np.ndarray) -> MeasuredLine:
    """The profile from (row, column) to (row, column), px."""
    row_0, column_0, row_1, column_1 = (pitch_um * end for end in ends)
    return measure_line(z_um, pitch_um, Line((column_0, row_0), (column_1, row_1)), **known)


def test_along_a_row_or_a_column_it_is_the_array_itself() -> None:
    np.testing.assert_array_equal(profile(Z, 2.0, (7, 3, 7, 55)).z_um, Z[7, 3:56])
    np.testing.assert_array_equal(profile(Z, 2.0, (39, 59, 0, 59)).z_um, Z[::-1, 59])


def test_distances_are_along_the_skin() -> None:
    found = profile(Z, 2.5, (0, 0, 30, 40))
    assert found.along_um[[0, -1]] == pytest.approx([0.0, 125.0])
    assert np.diff(found.along_um).max() <= 2.5


def test_a_plane_stays_a_plane_between_pixels() -> None:
    row, column = np.mgrid[:40, :60].astype(np.float32)
    found = profile(3.0 * row - 2.0 * column, 1.0, (0.25, 1.5, 33.0, 57.75))
    np.testing.assert_allclose(found.z_um, 3.0 * found.rows - 2.0 * found.columns, atol=1e-4)


def test_an_invalid_pixel_spoils_only_what_needs_it() -> None:
    z = Z.copy()
    z[7, 20] = np.nan
    assert np.flatnonzero(np.isnan(profile(z, 1.0, (7, 0, 7, 59)).z_um)).tolist() == [20]
    assert np.isfinite(profile(z, 1.0, (8, 0, 8, 59)).z_um).all()


def test_the_difference_of_two_heights_is_known_better_than_either_when_their_error_is_one() -> None:
    rng = np.random.default_rng(1)
    samples = (
        rng.normal(size=(16, 1, 1)).astype(np.float32) * 5.0 + rng.normal(size=(16, 20, 30)).astype(np.float32) * 0.1
    )
    found = profile(Z, 1.0, (5, 2, 5, 50), samples_um=samples)
    assert found.sigma_um is not None
    assert found.sigma_um.mean() == pytest.approx(5.0, rel=0.5)
    step_sigma = found.difference_sigma_um(0, 48)
    assert step_sigma is not None
    assert 0.02 < step_sigma < 0.4


def test_draws_lie_where_the_field_they_reduce_lies() -> None:
    """A draw that rises along the columns rises along the profile as much."""
    reduced = np.repeat((np.arange(15, dtype=np.float32) * 4.0 + 1.5)[None, :], 10, axis=0)[None]
    found = profile(Z, 1.0, (20, 2, 20, 57), samples_um=reduced)
    assert found.samples_um is not None
    np.testing.assert_allclose(found.samples_um[0], np.arange(2, 58), atol=0.2)


def test_without_samples_the_map_of_sigma_counts_and_no_difference_is_claimed() -> None:
    found = profile(Z, 1.0, (5, 2, 5, 50), sigma_um=np.full_like(Z, 0.75))
    assert found.sigma_um == pytest.approx(np.full(49, 0.75))
    assert found.difference_sigma_um(0, 48) is None


@pytest.mark.parametrize("ends", [(0, 0, 0, 0), (-1, 0, 5, 5), (0, 0, 5, 60), (0, 0, float("nan"), 5), (0, 0, 40, 0)])
def test_a_line_that_is_none_is_refused(ends: tuple[float, float, float, float]) -> None:
    with pytest.raises(ViewError, match="profile"):
        profile(Z, 1.0, ends)


def test_a_very_long_line_is_not_sampled_without_end() -> None:
    wide = np.zeros((2, 70_000), np.float32)
    assert len(profile(wide, 1.0, (0, 0, 0, 69_999), samples_um=np.zeros((2, 2, 900), np.float32)).z_um) <= 20_000
