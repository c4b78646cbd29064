"""The written-out polynomial against the sum of its terms, and images by plane against images by pixel."""

import numpy as np
import pytest

from device.inverse_map.regressor import colour_exponents, monomials
from host_sync.gradients.polynomial_kernel import tabled_degree, term_numbers, write_polynomial
from host_sync.kernels.cell_rows import as_stored, colour_rows, empty_planes, in_planes


@pytest.mark.parametrize("degree", range(9))
def test_horner_and_the_sum_of_terms_agree(degree: int) -> None:
    random = np.random.default_rng(degree)
    colours = random.uniform(-1.0, 1.0, (3, 50)).astype(np.float32)
    coefficients = random.normal(size=len(colour_exponents(degree)))
    tabled = np.zeros(len(colour_exponents(tabled_degree(degree))), np.float32)
    tabled[term_numbers(degree)] = coefficients
    out = np.empty(50, np.float32)
    write_polynomial(tabled_degree(degree), tabled, *colours, out)
    expected = monomials(colours.T.astype(np.float64), degree) @ coefficients
    np.testing.assert_allclose(out, expected, atol=2e-5)


def test_both_ways_of_storing_an_image_read_alike() -> None:
    image = np.random.default_rng(0).random((5, 40, 3), np.float32)
    planar = in_planes(image)
    np.testing.assert_array_equal(planar, image)
    assert as_stored(planar)[1]
    assert as_stored(empty_planes((5, 40)))[1]
    assert not as_stored(image)[1]
    spare = np.empty((3, 64), np.float32)
    for stored in (image, planar):
        for channel, colour in enumerate(colour_rows(*as_stored(stored), 3, 7, 31, spare)):
            np.testing.assert_array_equal(colour, image[3, 7:31, channel])


def test_an_image_that_is_planar_already_is_not_copied() -> None:
    planar = empty_planes((4, 6))
    assert np.shares_memory(in_planes(planar), planar)
    assert np.shares_memory(as_stored(planar)[0], planar)
