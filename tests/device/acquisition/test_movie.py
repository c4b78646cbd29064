"""A movie of a press: frames of half the size while it deepens, and the scan's own frame at full size."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.errors import RecordError
from device.imaging.flat_field import bin_mosaic, can_bin, unbin_mosaic
from device.store.store import BundleStore
from hal.frame import CameraSettings, RawFrame
from hal.hardware import Hardware
from hal.interfaces import PressObject
from hal.simulator.bench import SimulatedScene
from tests.apparatus.deepening_press import STEPS, press_deeper


@pytest.fixture
def scanner(hardware: Hardware, calibrated: BundleStore) -> Iterator[Scanner]:
    with hardware:
        found = Scanner(hardware, calibrated)
        found.measure_lights()
        yield found


def test_contact_and_depth_grow_while_the_object_is_pressed(
    scanner: Scanner, bench: SimulatedScene, hardware: Hardware
) -> None:
    press_deeper(bench, hardware)
    bundle = scanner.scan(Annotations(), mode="movie").bundle
    movie = bundle.record.movie
    assert movie is not None
    contact = [frame.contact_fraction or 0.0 for frame in movie.frames]
    depth_um = [frame.depth_um or 0.0 for frame in movie.frames]
    assert len(movie.frames) > STEPS
    assert contact[0] < 0.05
    assert contact[-1] > contact[0] + 0.1
    assert depth_um[-1] > 2.0 * max(depth_um[0], 1.0)
    assert movie.frames[0].at_ms == 0.0
    assert all(a.at_ms < b.at_ms for a, b in zip(movie.frames, movie.frames[1:], strict=False))
    assert movie.best > len(movie.frames) / 4
    assert bench.currents_ma == {}


def test_the_scans_own_frame_is_the_mean_of_the_best_and_of_those_that_did_not_move(
    scanner: Scanner, bench: SimulatedScene, hardware: Hardware
) -> None:
    press_deeper(bench, hardware)
    bundle = scanner.scan(Annotations(), mode="movie").bundle
    movie, exposures = bundle.record.movie, bundle.record.exposures
    assert movie is not None
    bundle.verify()
    still = movie.frames[movie.best :]
    assert exposures.averaged == len(still) > 30
    assert exposures.moved == 0
    whole, small = bundle.raw_frame(), [bundle.movie_frame(frame.file) for frame in still]
    assert whole.sensor_timestamp_ns == small[0].sensor_timestamp_ns
    mean = np.mean([light_of(frame) for frame in small], axis=0)
    count = 1.0 / (whole.white_level_dn - whole.black_level_dn)  # the mean and its binning round to half of one each
    np.testing.assert_allclose(light_of(bin_mosaic(whole)), mean, rtol=0.0, atol=1.01 * count)
    noise = np.std(light_of(small[0]) - light_of(small[1])) / np.sqrt(2.0)
    left = np.std(light_of(small[0]) - light_of(bin_mosaic(whole)))
    print(f"{len(still)} frames averaged, noise of one {noise:.5f}")  # noqa: T201
    assert left == pytest.approx(noise * np.sqrt(1.0 - 1.0 / len(still)), rel=0.02)


def test_frames_after_the_press_is_let_go_are_left_out_and_counted(
    scanner: Scanner, bench: SimulatedScene, hardware: Hardware
) -> None:
    press_deeper(bench, hardware)
    let_go_ms = 2900.0
    bench.place_at(bench.clock.monotonic_ns() + round(let_go_ms * 1e6), None)
    bundle = scanner.scan(Annotations(), mode="movie").bundle
    movie, exposures = bundle.record.movie, bundle.record.exposures
    assert movie is not None
    still = [frame for frame in movie.frames[movie.best :] if (frame.contact_fraction or 0.0) > 0.3]
    assert exposures.averaged == len(still) > 5
    assert exposures.moved == len(movie.frames) - movie.best - len(still) > 5


def light_of(frame: RawFrame) -> np.ndarray:
    """Light as a fraction of full scale: float64 array of shape (H, W)."""
    return (frame.mosaic - frame.black_level_dn) / (frame.white_level_dn - frame.black_level_dn)


def test_a_scan_without_a_movie_says_so(scanner: Scanner, hardware: Hardware) -> None:
    hardware.operator.ask(PressObject("coin"))
    hardware.button.wait_for_press(None)
    bundle = scanner.scan(Annotations()).bundle
    assert bundle.record.movie is None
    with pytest.raises(RecordError, match="holds no movie"):
        bundle.movie_frame("movie-0000.tif")


@pytest.mark.parametrize(("white", "scale"), [(1023.0, 4), (65535.0, 1)])
def test_pixels_of_one_colour_are_taken_together(white: float, scale: int) -> None:
    counts = np.arange(64, dtype=np.uint16).reshape(8, 8)
    frame = make_frame(counts, white)
    small = bin_mosaic(frame)
    assert small.mosaic.shape == (4, 4)
    assert small.white_level_dn == scale * white
    expected = counts[0:4:2, 0:4:2].astype(float).mean()
    assert small.mosaic[0, 0] / scale == pytest.approx(expected, abs=0.5)
    again = unbin_mosaic(small)
    assert again.mosaic.shape == (8, 8)
    assert (again.mosaic[0:4:2, 0:4:2] == small.mosaic[0, 0]).all()
    np.testing.assert_array_equal(bin_mosaic(replace(again, white_level_dn=65535.0)).mosaic, small.mosaic)


def make_frame(counts: np.ndarray, white: float) -> RawFrame:
    return RawFrame(counts, "RGGB", 0.0, white, CameraSettings(1000.0, 1.0), 0)


def test_a_frame_that_is_no_whole_number_of_blocks_is_refused() -> None:
    assert not can_bin((6, 8))
    with pytest.raises(ValueError, match="4x4 blocks"):
        bin_mosaic(make_frame(np.zeros((6, 8), np.uint16), 1023.0))
