"""The fused kernels against the portable path, bit for bit."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from device.errors import CalibrationMismatch
from device.imaging.flat_field import LinearFrame, NormalizedImage, demosaic, flat_field_correct
from device.imaging.frame_light import FrameLight
from hal.frame import BAYER_ORDERS, BayerOrder, CameraSettings, RawFrame
from host_sync.frames.linear_light import light_of_values
from host_sync.gradients.flat_field_kernel import empty_intensity, raw_intensity, stored_intensity, take_out_light
from host_sync.kernels.cell_rows import in_planes

SHAPES = [(4, 4), (6, 4), (4, 10), (2, 2), (2, 8), (66, 70), (98, 130)]


def mosaic(shape: tuple[int, int], order: BayerOrder = "RGGB", seed: int = 0) -> RawFrame:
    random = np.random.default_rng(seed)
    counts = random.integers(200, 3900, shape, dtype=np.uint16)
    counts[random.random(shape) < 0.002] = 4095
    return RawFrame(counts, order, 256.0, 4095.0, CameraSettings(2000.0, 1.0), 0)


def flat_field(shape: tuple[int, int]) -> np.ndarray:
    """A reference with a dark corner."""
    values = np.random.default_rng(1).uniform(0.2, 0.6, (*shape, 3)).astype(np.float32)
    values[: shape[0] // 2, 0] = 0.001
    return values


def assert_same(one: NormalizedImage, other: NormalizedImage) -> None:
    np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_array_equal(one.valid, other.valid)
    np.testing.assert_array_equal(one.clipped, other.clipped)


@pytest.mark.parametrize("order", BAYER_ORDERS)
@pytest.mark.parametrize("shape", SHAPES)
def test_a_raw_frame_becomes_what_the_portable_path_makes_of_it(shape: tuple[int, int], order: BayerOrder) -> None:
    frame, rest = mosaic(shape, order), flat_field(shape)
    assert_same(raw_intensity(frame, rest), flat_field_correct(demosaic(frame), rest))
    assert_same(raw_intensity(frame, in_planes(rest)), flat_field_correct(demosaic(frame), rest))


def test_clipping_reaches_as_far_as_demosaicing_mixes() -> None:
    frame = mosaic((40, 40))
    frame.mosaic[:] = 1000
    frame.mosaic[[0, 20], [39, 20]] = 4090
    clipped = raw_intensity(frame, flat_field((40, 40))).clipped
    assert clipped.sum() == 4 + 9
    assert clipped[19:22, 19:22].all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_a_stored_image_becomes_what_the_portable_path_makes_of_it(dtype: Any, encoding: Any) -> None:
    pixels = np.random.default_rng(2).integers(0, np.iinfo(dtype).max, (33, 47, 3), dtype=dtype, endpoint=True)
    light, rest = light_of_values(np.dtype(dtype), encoding), flat_field((33, 47))
    rgb = light[pixels]
    expected = flat_field_correct(LinearFrame(rgb, (rgb >= np.float32(0.98)).any(axis=-1)), rest)
    assert_same(stored_intensity(pixels, light, rest), expected)
    assert_same(stored_intensity(pixels, light, in_planes(rest)), expected)


def test_an_image_is_filled_again_without_a_trace_of_what_it_held() -> None:
    out, rest = empty_intensity((66, 70)), flat_field((66, 70))
    raw_intensity(mosaic((66, 70), seed=5), rest, out)
    assert raw_intensity(mosaic((66, 70), seed=6), rest, out) is out
    assert_same(out, raw_intensity(mosaic((66, 70), seed=6), rest))


def test_one_thread_and_two_agree_to_the_bit() -> None:
    frame, rest = mosaic((98, 130)), flat_field((98, 130))
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = raw_intensity(frame, rest)
    finally:
        numba.set_num_threads(before)
    assert_same(alone, raw_intensity(frame, rest))


def test_another_size_than_the_references_is_refused() -> None:
    with pytest.raises(CalibrationMismatch, match="the frame is 8x6 pixels and the reference 10x6"):
        raw_intensity(mosaic((6, 8)), flat_field((6, 10)))
    with pytest.raises(CalibrationMismatch, match="the frame is 8x6 pixels"):
        stored_intensity(
            np.zeros((6, 8, 3), np.uint8), light_of_values(np.dtype(np.uint8), "linear"), flat_field((6, 10))
        )


@pytest.mark.parametrize(
    ("gains", "offsets"), [((1.1, 0.9, 1.0), (0.0, 0.01, -0.02)), ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))]
)
def test_light_is_taken_out_as_on_the_handheld(gains: tuple[float, ...], offsets: tuple[float, ...]) -> None:
    random = np.random.default_rng(8)
    values = random.uniform(0.2, 2.0, (7, 9, 3)).astype(np.float32)
    rest = random.uniform(0.0, 0.8, (7, 9, 3)).astype(np.float32)
    rest[0, 0] = 0.0
    light = FrameLight(np.array(gains), np.array(offsets))
    wanted, found = values.copy(), in_planes(values)
    light.take_out(wanted, rest)
    take_out_light(light, found, in_planes(rest))
    assert np.array_equal(found, wanted)
