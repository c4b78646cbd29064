"""Promises of `hal.interfaces.Camera`, for every driver."""

import numpy as np
import pytest

from hal.errors import CameraError
from hal.frame import BAYER_ORDERS, CameraSettings
from hal.hardware import Hardware

ASKED = CameraSettings(exposure_us=3_000.0, analogue_gain=2.0)


def shows(granted: CameraSettings, asked: CameraSettings) -> bool:
    return bool(
        np.isclose(granted.exposure_us, asked.exposure_us, rtol=0.02)
        and np.isclose(granted.analogue_gain, asked.analogue_gain, rtol=0.02)
    )


def test_a_frame_says_everything_about_itself(driver: Hardware) -> None:
    camera = driver.camera
    with driver:
        frame = camera.next_frame(2.0)
    assert camera.camera_id
    assert frame.mosaic.dtype == np.uint16
    assert frame.shape == camera.shape == frame.mosaic.shape
    assert frame.shape[0] % 2 == frame.shape[1] % 2 == 0
    assert frame.bayer_order in BAYER_ORDERS
    assert 0.0 <= frame.black_level_dn < frame.white_level_dn
    assert frame.mosaic.max() <= frame.white_level_dn


def test_frames_follow_one_another_and_end_after_they_were_asked_for(driver: Hardware) -> None:
    with driver:
        last_began_ns = -1
        for _ in range(5):
            asked_ns = driver.clock.monotonic_ns()
            frame = driver.camera.next_frame(2.0)
            exposed_ns = frame.sensor_timestamp_ns + frame.granted.exposure_us * 1e3
            assert asked_ns < exposed_ns + 2e7
            assert frame.sensor_timestamp_ns > last_began_ns
            assert exposed_ns <= driver.clock.monotonic_ns()
            last_began_ns = frame.sensor_timestamp_ns


def test_a_late_caller_never_gets_an_old_frame(driver: Hardware) -> None:
    with driver:
        driver.camera.next_frame(2.0)
        driver.clock.sleep(5.0)
        asked_ns = driver.clock.monotonic_ns()
        frame = driver.camera.next_frame(2.0)
    assert frame.sensor_timestamp_ns > asked_ns - 1e8


def test_settings_arrive_within_a_dozen_frames(driver: Hardware) -> None:
    with driver:
        driver.camera.next_frame(2.0)
        driver.camera.apply(ASKED)
        assert any(shows(driver.camera.next_frame(2.0).granted, ASKED) for _ in range(12))
        assert shows(driver.camera.next_frame(2.0).granted, ASKED)


def test_a_frame_of_a_closed_camera_is_refused(driver: Hardware) -> None:
    with driver:
        pass
    with pytest.raises(CameraError):
        driver.camera.next_frame(1.0)


def test_aiming_views_are_small_grey_and_live(driver: Hardware) -> None:
    with driver:
        asked_ns = driver.clock.monotonic_ns()
        views = [driver.camera.aiming_view(2.0) for _ in range(3)]
        assert driver.clock.monotonic_ns() > asked_ns
    rows, columns = driver.camera.shape
    assert {(view.dtype, view.ndim) for view in views} == {(np.dtype(np.uint8), 2)}
    assert len({view.shape for view in views}) == 1
    assert views[0].shape[0] < rows
    assert views[0].shape[1] < columns
