import numpy as np
import pytest

from device.errors import CalibrationMismatch, FrameError
from device.imaging.flat_field import (
    DEMOSAIC_BLUR_PX,
    LinearFrame,
    bin_bayer,
    check_exposed,
    demosaic,
    estimate_flat_field,
    flat_field_correct,
    make_flat_field,
)
from hal.frame import BAYER_ORDERS, BayerOrder, CameraSettings, RawFrame

COLOUR_DN = {"R": 1000, "G": 2000, "B": 3000}
BLACK_DN, WHITE_DN = 256.0, 4095.0


def raw_of(mosaic: np.ndarray, order: BayerOrder) -> RawFrame:
    return RawFrame(mosaic.astype(np.uint16), order, BLACK_DN, WHITE_DN, CameraSettings(1000.0, 1.0), 0)


def uniform(order: BayerOrder, shape: tuple[int, int] = (16, 24)) -> RawFrame:
    tile = np.array([COLOUR_DN[letter] for letter in order]).reshape(2, 2)
    return raw_of(np.tile(tile, (shape[0] // 2, shape[1] // 2)), order)


def expected_rgb() -> np.ndarray:
    return (np.array([COLOUR_DN[c] for c in "RGB"]) - BLACK_DN) / (WHITE_DN - BLACK_DN)


@pytest.mark.parametrize("order", BAYER_ORDERS)
def test_demosaic_puts_each_colour_into_its_channel(order: BayerOrder) -> None:
    frame = demosaic(uniform(order))
    np.testing.assert_allclose(frame.rgb, np.broadcast_to(expected_rgb(), frame.rgb.shape), atol=1e-5)


@pytest.mark.parametrize("order", BAYER_ORDERS)
@pytest.mark.parametrize("along", [0, 1])
def test_demosaicing_takes_of_a_grey_wave_what_its_blur_says(order: BayerOrder, along: int) -> None:
    period = 24
    wave = 2000.0 + 1000.0 * np.sin(2.0 * np.pi * np.arange(10 * period) / period)
    mosaic = np.broadcast_to(wave[:, None] if along == 0 else wave, (10 * period, 10 * period))
    frame = demosaic(raw_of(np.rint(mosaic), order))
    assert frame.demosaiced
    seen = frame.rgb.mean(axis=(1 - along, 2))[period:-period]
    sine = np.sin(2.0 * np.pi * np.arange(period, 9 * period) / period)
    kept = 2.0 * (seen * sine).mean() / (1000.0 / (WHITE_DN - BLACK_DN))
    assert 1.0 - kept == pytest.approx(0.5 * (DEMOSAIC_BLUR_PX * 2.0 * np.pi / period) ** 2, rel=0.05)


@pytest.mark.parametrize("order", BAYER_ORDERS)
@pytest.mark.parametrize("factor", [2, 4])
def test_binning_puts_each_colour_into_its_channel(order: BayerOrder, factor: int) -> None:
    frame = bin_bayer(uniform(order), factor)
    assert frame.shape == (16 // factor, 24 // factor)
    np.testing.assert_allclose(frame.rgb, np.broadcast_to(expected_rgb(), frame.rgb.shape), atol=1e-5)


def test_a_tall_frame_is_binned_as_its_parts_are() -> None:
    """Rows of bins are made band by band; a saturated pixel marks its own bin and no other."""
    mosaic = np.random.default_rng(3).integers(256, 3000, (4 * 205 + 3, 4 * 9 + 2)).astype(np.uint16)
    mosaic[4 * 97 + 1, 11] = 65535
    whole = bin_bayer(raw_of(mosaic, "GRBG"), 4)
    parts = [bin_bayer(raw_of(mosaic[4 * r : 4 * r + 4], "GRBG"), 4) for r in range(205)]
    np.testing.assert_array_equal(whole.rgb, np.concatenate([part.rgb for part in parts]))
    assert np.argwhere(whole.clipped).tolist() == [[97, 2]]


def test_binning_leaves_out_what_does_not_fill_a_bin() -> None:
    assert bin_bayer(uniform("RGGB", (18, 22)), 4).shape == (4, 5)


@pytest.mark.parametrize("highest", [4095, 65535])
@pytest.mark.parametrize("factor", [2, 4, 8])
def test_a_bin_is_the_mean_of_its_own_pixels(factor: int, highest: int) -> None:
    mosaic = np.random.default_rng(0).integers(0, highest + 1, (32, 48), dtype=np.uint16)
    frame = bin_bayer(raw_of(mosaic, "GBRG"), factor)
    counts = mosaic.reshape(32 // factor, factor, 48 // factor, factor).astype(np.float64)
    red = counts[:, 1::2, :, 0::2].mean(axis=(1, 3))
    green = (counts[:, 0::2, :, 0::2] + counts[:, 1::2, :, 1::2]).mean(axis=(1, 3)) / 2.0
    for channel, expected in ((0, red), (1, green)):
        np.testing.assert_allclose(frame.rgb[..., channel], (expected - BLACK_DN) / (WHITE_DN - BLACK_DN), rtol=1e-5)
    limit = BLACK_DN + 0.98 * (WHITE_DN - BLACK_DN)
    np.testing.assert_array_equal(frame.clipped, counts.max(axis=(1, 3)) >= limit)


@pytest.mark.parametrize("factor", [0, 1, 3])
def test_an_odd_binning_is_refused(factor: int) -> None:
    with pytest.raises(ValueError, match="even"):
        bin_bayer(uniform("RGGB"), factor)


def test_a_saturated_pixel_is_marked_with_those_it_mixes_into() -> None:
    mosaic = uniform("RGGB").mosaic.copy()
    mosaic[6, 9] = 4095
    full, half = demosaic(raw_of(mosaic, "RGGB")), bin_bayer(raw_of(mosaic, "RGGB"), 2)
    assert full.clipped[5:8, 8:11].all()
    assert full.clipped.sum() == 9
    assert half.clipped[3, 4]
    assert half.clipped.sum() == 1


def flat(level: float, shape: tuple[int, int] = (40, 60)) -> LinearFrame:
    return LinearFrame(np.full((*shape, 3), level, np.float32), np.zeros(shape, bool))


def test_a_frame_like_its_reference_reads_one() -> None:
    image = flat_field_correct(flat(0.4), make_flat_field(flat(0.4)))
    np.testing.assert_allclose(image.values, 1.0, rtol=1e-5)
    assert image.valid.all()


def test_a_dark_reference_makes_pixels_invalid_not_zero() -> None:
    reference = flat(0.4)
    reference.rgb[:, :20, 1] = 0.0
    image = flat_field_correct(flat(0.4), reference.rgb)
    assert not image.valid[:, :20].any()
    assert image.valid[:, 20:].all()
    assert np.isfinite(image.values).all()


def test_another_size_than_the_reference_is_refused() -> None:
    with pytest.raises(CalibrationMismatch, match="60x40 pixels and the reference 30x20"):
        flat_field_correct(flat(0.4), make_flat_field(flat(0.4, (20, 30))))


def test_black_and_saturated_frames_are_refused_by_name() -> None:
    with pytest.raises(FrameError, match=r"press\.png is black"):
        check_exposed(flat(0.001), "press.png")
    bright = LinearFrame(np.ones((40, 60, 3), np.float32), np.ones((40, 60), bool))
    with pytest.raises(FrameError, match=r"press\.png is saturated over 100%"):
        check_exposed(bright, "press.png")
    check_exposed(flat(0.3), "press.png")


def test_the_stand_in_reference_ignores_what_presses() -> None:
    row, column = np.mgrid[:120, :160] / 100.0
    shade = 0.3 + 0.1 * column - 0.05 * row**2
    frames = []
    for centre in ((40, 40), (80, 110)):
        rgb = np.repeat(shade[..., None], 3, axis=-1).astype(np.float32)
        disc = (np.mgrid[:120, :160][0] - centre[0]) ** 2 + (np.mgrid[:120, :160][1] - centre[1]) ** 2 < 20**2
        rgb[disc] *= np.float32(1.8)
        frames.append(LinearFrame(rgb, np.zeros(shade.shape, bool)))
    flat_field = estimate_flat_field(frames)
    error = np.abs(flat_field / shade[..., None] - 1.0)
    assert np.median(error) < 0.002
    assert error.max() < 0.06  # at the corners, where a polynomial has least to hold on to


def test_the_edge_of_the_gel_stays_sharp_and_noise_and_marks_are_blurred() -> None:
    random = np.random.default_rng(7)
    light = np.full((120, 160, 3), 0.4, np.float32)
    light[:, 140:] = 0.05  # beyond the edge of the gel
    light[50:54, 60:64] = 0.1  # a mark on the skin
    noisy = (light * (1.0 + 0.01 * random.standard_normal(light.shape))).astype(np.float32)
    flat_field = make_flat_field(LinearFrame(noisy, np.zeros(light.shape[:2], np.bool_)))
    edge = np.s_[:, 136:144]
    np.testing.assert_array_equal(flat_field[edge], noisy[edge])
    calm = np.s_[10:40, 10:120]
    assert (flat_field[calm] / light[calm]).std() < 0.002
    assert flat_field[51, 61, 0] > 0.2


def test_a_field_without_an_edge_is_blurred_everywhere() -> None:
    random = np.random.default_rng(8)
    noisy = (0.3 * (1.0 + 0.02 * random.standard_normal((90, 120, 3)))).astype(np.float32)
    flat_field = make_flat_field(LinearFrame(noisy, np.zeros((90, 120), np.bool_)))
    assert (flat_field / 0.3).std() < 0.004
