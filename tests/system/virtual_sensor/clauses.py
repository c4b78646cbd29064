"""In the virtual board: the driver of sensors on USB on the kernel's own test camera, vivid."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture_with_faults
from device.bundles.raw_frame import read_raw, write_raw
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import SystemClock
from hal.drivers.usb_hardware import usb_hardware
from hal.drivers.v4l2_kernel import KernelVideo
from hal.errors import CameraError
from hal.hardware import Hardware
from hal.profile_tables import UvcProperty

DRIVER = Path("/sys/bus/platform/drivers/vivid")
DEVICE = "vivid.0"


def profile(*fixed: UvcProperty) -> BoardProfile:
    """Vivid as a sensor on USB: it has a gain control, and neither exposure nor white balance nor focus."""
    digit = load_board_profile("digit")
    uvc = msgspec.structs.replace(
        digit.uvc, card="vivid", fixed=fixed, gain_units=100.0, lights="always on", controls={"brightness": 100}
    )
    return msgspec.structs.replace(digit, uvc=uvc)


def hardware(*fixed: UvcProperty) -> Hardware:
    return usb_hardware(profile(*fixed), SystemClock())


def test_its_frames_are_live_and_whole() -> None:
    with hardware("exposure", "white balance", "focus") as sensor:
        frames = [sensor.camera.next_frame(2.0) for _ in range(3)]
        view = sensor.camera.aiming_view(2.0)
    assert {frame.shape for frame in frames} == {(344, 456)}
    assert np.ptp(frames[0].mosaic) > 10_000
    stamps = [frame.sensor_timestamp_ns for frame in frames]
    assert stamps == sorted(set(stamps))
    assert view.shape == (43, 57)


def test_a_scan_s_frame_is_confirmed_and_reads_back_from_its_raw_file(tmp_path: Path) -> None:
    with hardware("exposure", "white balance", "focus") as sensor:
        taken = capture_with_faults(sensor, CaptureSettings.of_board(sensor))
    assert taken.light_faults == ()
    write_raw(tmp_path / "frame.tif", taken.frame)
    again = read_raw(tmp_path / "frame.tif")
    assert np.array_equal(again.mosaic, taken.frame.mosaic)
    assert again.granted == taken.frame.granted
    assert again.sensor_timestamp_ns == taken.frame.sensor_timestamp_ns


def test_a_property_without_a_control_is_refused_by_name() -> None:
    with pytest.raises(CameraError, match="cannot lock its exposure: it has no control"), hardware("focus"):
        pass


def test_a_control_that_another_program_changes_is_found() -> None:
    with hardware("exposure", "white balance", "focus") as sensor:
        sensor.camera.next_frame(2.0)
        other = KernelVideo().open(next(info.path for info in KernelVideo().cameras() if "vivid" in info.card))
        other.write_control(0x00980900, 7)
        other.close()
        with pytest.raises(CameraError, match="brightness: 100 was set and 7 is read"):
            sensor.camera.next_frame(2.0)
        assert sensor.camera.next_frame(2.0).mosaic.any()


def test_unplugged_is_said_and_plugged_in_again_is_mended() -> None:
    with hardware("exposure", "white balance", "focus") as sensor:
        sensor.camera.next_frame(2.0)
        (DRIVER / "unbind").write_text(DEVICE)
        try:
            with pytest.raises(CameraError, match="plug it in"):
                sensor.camera.next_frame(2.0)
        finally:
            (DRIVER / "bind").write_text(DEVICE)
        assert sensor.camera.next_frame(2.0).mosaic.any()
