"""The tabulated inverse map against the map that it stands for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from device.bundles.calibration import CalibrationBundle
from device.calibration.cross_validation import angle_between_deg
from device.imaging.flat_field import NormalizedImage, bin_bayer, flat_field_correct, make_flat_field
from device.inverse_map.model import InverseMap, read_model
from device.inverse_map.tabulated import TabulatedInverseMap, spline_weights
from device.store.registry_file import read_active
from device.surface import GradientField

BINNING = 2
SHAPE = (136, 182)


@pytest.fixture(scope="module")
def calibration(calibrated_root: Path) -> CalibrationBundle:
    return read_active(calibrated_root)


@pytest.fixture(scope="module")
def inverse_map(calibration: CalibrationBundle) -> InverseMap:
    return read_model(calibration.path(calibration.record.model_files[0]))


@pytest.fixture(scope="module")
def table(inverse_map: InverseMap) -> TabulatedInverseMap:
    return TabulatedInverseMap.of(inverse_map, BINNING)


@pytest.fixture(scope="module")
def presses(calibration: CalibrationBundle) -> list[NormalizedImage]:
    flat_field = make_flat_field(bin_bayer(calibration.reference(), BINNING))
    frames = [calibration.press_frame(press) for press in calibration.record.presses]
    return [flat_field_correct(bin_bayer(frame, BINNING), flat_field) for frame in frames]


def image_of(values: np.ndarray) -> NormalizedImage:
    return NormalizedImage(values.astype(np.float32), np.ones(SHAPE, bool), np.zeros(SHAPE, bool))


def difference_deg(found: GradientField, expected: GradientField) -> np.ndarray:
    slopes = (np.stack([g.p, g.q], axis=-1)[expected.valid].astype(np.float64) for g in (found, expected))
    return np.asarray(angle_between_deg(*slopes))


def test_the_spline_is_that_of_scipy() -> None:
    at = np.linspace(0.0, 12.0, 97)
    np.testing.assert_allclose(spline_weights(at, 13), CubicSpline(np.arange(13.0), np.eye(13))(at), atol=1e-13)


def test_every_press_is_read_as_the_map_reads_it(
    inverse_map: InverseMap, table: TabulatedInverseMap, presses: list[NormalizedImage]
) -> None:
    """The error of a bin's width is noise: small, and without preference."""
    for image in presses:
        found, expected = table.gradients(image), inverse_map.gradients(image, BINNING)
        error = difference_deg(found, expected)
        assert error.mean() < 0.5
        assert np.percentile(error, 99.0) < 1.5
        assert abs(float((found.p - expected.p).mean())) < 5e-4
        assert abs(float((found.q - expected.q).mean())) < 5e-4


def test_validity_and_confidence_are_those_of_the_map(
    inverse_map: InverseMap, table: TabulatedInverseMap, presses: list[NormalizedImage]
) -> None:
    strange = np.random.default_rng(0).uniform(-0.2, 6.0, (*SHAPE, 3))
    clipped = np.random.default_rng(1).random(SHAPE) < 0.1
    lit = np.random.default_rng(2).random(SHAPE) < 0.9
    for image in (presses[0], replace(image_of(strange), clipped=clipped, valid=lit)):
        found, expected = table.gradients(image), inverse_map.gradients(image, BINNING)
        np.testing.assert_array_equal(found.valid, expected.valid)
        np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-5)
        assert np.isfinite(found.p).all()
        assert np.isfinite(found.q).all()


def test_no_slope_exceeds_that_of_the_balls_by_more_than_half(inverse_map: InverseMap) -> None:
    bounded = replace(inverse_map, max_trained_slope=0.1)
    image = image_of(np.random.default_rng(1).uniform(0.6, 1.5, (*SHAPE, 3)))
    table = TabulatedInverseMap.of(bounded, BINNING).gradients(image)
    column, row = (2.0 * axis.ravel() + 0.5 for axis in np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0])))
    pixels = image.values.reshape(-1, 3), column.astype(np.float32), row.astype(np.float32)
    slopes, free = bounded.predict(*pixels), inverse_map.predict(*pixels)
    steep = np.linalg.norm(free, axis=1) > 0.15
    assert 0.2 < steep.mean() < 1.0
    for p, q in (slopes.T, (table.p.ravel(), table.q.ravel())):
        assert np.hypot(p, q).max() == pytest.approx(0.15, rel=1e-4)
    np.testing.assert_array_equal(slopes[~steep], free[~steep])
    kept = np.linalg.norm(free[steep], axis=1, keepdims=True)
    np.testing.assert_allclose(slopes[steep], 0.15 * free[steep] / kept, rtol=1e-6)


def test_untouched_skin_has_no_step_of_a_bin(inverse_map: InverseMap, table: TabulatedInverseMap) -> None:
    """Intensity 1 is the centre of a bin: no bias over the largest part of every scan."""
    flat = image_of(np.ones((*SHAPE, 3)))
    assert difference_deg(table.gradients(flat), inverse_map.gradients(flat, BINNING)).max() < 0.02


def test_one_colour_means_other_slopes_in_other_places(inverse_map: InverseMap, table: TabulatedInverseMap) -> None:
    """Near lights: position must not be lost in the table."""
    shade = image_of(np.broadcast_to(np.array([1.3, 0.8, 0.9]), (*SHAPE, 3)))
    found, expected = table.gradients(shade), inverse_map.gradients(shade, BINNING)
    assert np.ptp(expected.p) > 0.02
    assert np.ptp(found.p) == pytest.approx(np.ptp(expected.p), rel=0.05)
    assert difference_deg(found, expected).std() < 0.1


def test_a_map_without_position_needs_one_table(inverse_map: InverseMap) -> None:
    curve = inverse_map.curve
    level = replace(curve, position_degree=0, coefficients=curve.coefficients[:, :1])
    everywhere = replace(inverse_map, curve=level)
    assert len(TabulatedInverseMap.of(everywhere, BINNING).terms) == 1
    assert len(TabulatedInverseMap.of(inverse_map, BINNING).terms) > 1
