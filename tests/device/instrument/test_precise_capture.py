"""Precise captures by the whole instrument: noise, frames that moved, ambient light, and what the bundle states."""

from dataclasses import replace

import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.precise_capture import AVERAGE_S, FrameMean, capture_precisely, exposures_record
from device.bundles.scan import CaptureMode, ScanBundle
from device.imaging.flat_field import SATURATED, bin_bayer, flat_field_correct, make_flat_field
from device.instrument.events import ScanFinished
from device.instrument.instrument import Instrument
from device.inverse_map.model import InverseMap, read_model
from device.store.choices import Settings
from device.store.store import BundleStore
from device.surface import Float32Array
from hal.frame import RawFrame
from hal.hardware import Hardware
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene
from hal.simulator.operator import specimen
from hal.simulator.scene import Press

HEALTHY_MIN = 0.9
"""Of the root of the number of frames."""


def pressed(name: str) -> Press:
    shown = specimen(name)
    return Press(shown.surface, (0.0, 0.0), 0.0, shown.indentation_mm)


def scanned(
    bench: SimulatedScene, hardware: Hardware, store: BundleStore, mode: CaptureMode, ambient: float = 0.0
) -> tuple[ScanFinished, ScanBundle]:
    """A scan of a coin after a push of the button, and its bundle."""
    with Instrument(hardware, store) as instrument:
        instrument.set_settings(Settings(capture=mode))
        for _ in range(24):
            instrument.step()
        bench.faults.ambient = ambient
        bench.place(pressed("coin"))
        for _ in range(4):
            instrument.step()
        bench.schedule_button(ButtonPress(bench.clock.monotonic_ns() + 50_000_000, 0.4))
        for _ in range(30):
            instrument.step()
        bench.place(None)
        for _ in range(600):
            instrument.step()
            for event in instrument.take_events():
                if isinstance(event, ScanFinished):
                    return event, store.scans().bundles[-1]
    raise AssertionError("no scan came of the push")


def slope_noise(frames: tuple[RawFrame, RawFrame], flat_field: Float32Array, inverse_map: InverseMap) -> float:
    """Standard deviation of one frame's slopes, from two of the same press, where both are known."""
    one, other = (inverse_map.gradients(flat_field_correct(bin_bayer(frame), flat_field), 2) for frame in frames)
    known = one.valid & other.valid & (np.hypot(one.p, one.q) < 0.5)
    return float(np.std((one.p - other.p)[known]) / np.sqrt(2.0))


def test_noise_of_slopes_falls_with_the_root_of_the_frames(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    calibration = calibrated.active_calibration()
    with hardware:
        plan = CaptureSettings.of_calibration(hardware, calibration.record.fingerprint, calibration.record.asked)
        bench.place(pressed("coin"))
        single = (capture(hardware, plan), capture(hardware, plan))
        precise = [capture_precisely(hardware, plan, "average") for _ in range(2)]
    frames = precise[0].averaged
    assert frames >= 8
    assert [each.moved for each in precise] == [0, 0]
    flat_field = make_flat_field(bin_bayer(calibration.reference()))
    inverse_map = read_model(calibration.path(calibration.record.model_files[0]))
    averages = (precise[0].capture.frame, precise[1].capture.frame)
    gain = slope_noise(single, flat_field, inverse_map) / slope_noise(averages, flat_field, inverse_map)
    print(f"{frames} frames: noise of slopes {gain:.2f} times lower, root {np.sqrt(frames):.2f}")  # noqa: T201
    assert gain >= HEALTHY_MIN * np.sqrt(frames)


def test_an_average_is_good_and_says_how_many_frames_it_has(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    finished, scan = scanned(bench, hardware, calibrated, "average")
    assert finished.verdict.level == "good", finished.verdict.reason
    assert scan.record.exposures.averaged >= 8
    assert scan.record.exposures.files == ()
    frame = scan.raw_frame()
    assert frame.white_level_dn == 16 * bench.profile.sensor.white_level_dn
    scan.verify()


def test_frames_that_moved_are_left_out_and_counted(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    with hardware:
        plan = CaptureSettings.of_board(hardware)
        bench.place(pressed("coin"))
        bench.faults.wobble_mm = 0.1
        precise = capture_precisely(hardware, plan, "average")
        bench.faults.wobble_mm = 0.0
        at_ns = precise.capture.frame.sensor_timestamp_ns
        still = capture_precisely(hardware, plan, "average").capture.frame
    assert precise.moved >= 3
    assert precise.averaged >= 2
    assert precise.averaged + precise.moved <= AVERAGE_S * 1e9 / 16_000_000
    assert at_ns > 0
    held = precise.capture.frame.mosaic / 16.0
    shifted = capture_of_shifted(bench, hardware, plan)
    truth = still.mosaic / 16.0
    assert min(rms(held, truth), rms(held, shifted)) < 0.5 * rms(shifted, truth)


def capture_of_shifted(bench: SimulatedScene, hardware: Hardware, plan: CaptureSettings) -> np.ndarray:
    """Mean counts of the coin where the wobble takes it."""
    held = bench.pressed
    assert held is not None
    with hardware:
        bench.place(replace(held, centre_mm=(held.centre_mm[0] + 0.1, held.centre_mm[1])))
        return np.asarray(capture_precisely(hardware, plan, "average").capture.frame.mosaic / 16.0)


def rms(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))


def test_a_pixel_that_is_saturated_in_one_frame_stays_so(bench: SimulatedScene, hardware: Hardware) -> None:
    with hardware:
        frame = capture(hardware, CaptureSettings.of_board(hardware))
    bright = frame.mosaic.copy()
    bright[4, 6] = round(frame.white_level_dn)
    mean = FrameMean(frame)
    mean.add(replace(frame, mosaic=bright))
    mean.add(frame)
    found = mean.frame()
    assert found.mosaic[4, 6] >= SATURATED * found.white_level_dn
    rest = np.ones(frame.shape, bool)
    rest[4, 6] = False
    assert (found.mosaic[rest] == 16 * frame.mosaic[rest]).all()


def test_each_light_alone_is_stored_and_ambient_light_is_taken_out(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    _, scan = scanned(bench, hardware, calibrated, "lights", ambient=0.05)
    exposures = scan.record.exposures
    assert (exposures.dark_file, len(exposures.alone_files)) == ("dark.tif", len(hardware.lights.names))
    assert scan.record.verdict.figures["ambient_share"] == pytest.approx(0.05, abs=0.003)
    scan.verify()
    lit = bin_bayer(scan.lit_frame()).rgb
    stored = bin_bayer(scan.raw_frame()).rgb
    assert float((stored - lit).mean()) == pytest.approx(0.05, abs=0.003)
    dark = scan.dark_frame()
    assert dark is not None
    alone = sum(bin_bayer(scan.named_frame(name)).rgb - bin_bayer(dark).rgb for name in exposures.alone_files.values())
    assert float(np.abs(alone - lit).mean()) < 0.01


def test_frames_of_single_lights_are_left_out_where_the_object_moved(
    bench: SimulatedScene, hardware: Hardware, calibrated: BundleStore
) -> None:
    names = hardware.lights.names
    with hardware:
        plan = CaptureSettings.of_board(hardware)
        for shown in ("coin", "texture", "plane"):
            bench.place(pressed(shown))
            still = capture_precisely(hardware, plan, "lights")
            assert (tuple(still.alone), still.alone_moved) == (names, 0), shown
        bench.faults.ambient = 0.05
        bench.place(pressed("coin"))
        assert capture_precisely(hardware, plan, "lights").alone_moved == 0
        bench.faults.wobble_mm = 0.1
        moved = capture_precisely(hardware, plan, "lights")
    assert (moved.alone, moved.alone_moved) == ({}, len(names))
    assert moved.dark is not None
    record = exposures_record(moved)
    assert (record.alone_files, record.alone_moved) == ({}, len(names))


def test_the_choice_survives_a_restart_and_its_room_is_reckoned(hardware: Hardware, calibrated: BundleStore) -> None:
    with Instrument(hardware, calibrated) as instrument:
        instrument.step()
        single = instrument.state.scans_left
        instrument.set_settings(Settings(capture="lights"))
    with Instrument(hardware, calibrated) as instrument:
        instrument.step()
        assert instrument.state.settings.capture == "lights"
        assert single is not None
        assert instrument.state.scans_left == pytest.approx(single / 5, rel=0.1)
