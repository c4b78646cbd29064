"""The camera driver over a likeness of picamera2: what is refused by name, what is restarted, what is never leaked."""

import msgspec
import numpy as np
import pytest

from hal.board_parts import LibcameraFacts
from hal.camera_picamera2 import MOST_RESTARTS, PicameraCamera
from hal.errors import CameraError, DriverMissing, FrameTimeout
from hal.frame import CameraSettings
from hal.picamera_stack import load_picamera2
from hal.twin.bench import Bench
from hal.twin.wired.hardware import CAMERA_ID, Wired, wired_hardware


@pytest.fixture
def wired(bench: Bench) -> Wired:
    return wired_hardware(bench, "PCA9955B")


def test_stride_and_black_level_are_honoured(wired: Wired) -> None:
    with wired.hardware as hardware:
        hardware.lights.switch_on(hardware.profile.currents_ma)
        hardware.clock.sleep(0.1)
        frame = hardware.camera.next_frame(1.0)
    assert frame.shape == (272, 364)
    assert 2 * 364 % 64
    assert frame.mosaic.flags.c_contiguous
    assert frame.mosaic.max() <= frame.white_level_dn
    assert frame.black_level_dn == 256.0


def test_the_time_of_a_frame_is_when_its_exposure_began(wired: Wired) -> None:
    with wired.hardware as hardware:
        frame = hardware.camera.next_frame(1.0)
        began_ns = frame.sensor_timestamp_ns
        assert began_ns + frame.granted.exposure_us * 1e3 <= hardware.clock.monotonic_ns()
        hardware.lights.switch_on(hardware.profile.currents_ma)
        lit_ns = hardware.clock.monotonic_ns()
        frames = [hardware.camera.next_frame(1.0) for _ in range(3)]
    bright = [frame for frame in frames if frame.sensor_timestamp_ns >= lit_ns]
    assert bright
    means = [float(frame.mosaic.mean()) for frame in bright]
    assert np.ptp(means) < 0.01 * means[0]


def test_everything_automatic_is_off_before_the_first_frame(wired: Wired) -> None:
    with wired.hardware as hardware:
        frame = hardware.camera.next_frame(1.0)
    asked = hardware.profile.camera
    assert frame.granted.exposure_us == pytest.approx(asked.exposure_us, rel=0.02)
    assert frame.granted.analogue_gain == pytest.approx(asked.analogue_gain, rel=0.02)


@pytest.mark.parametrize(
    ("granted", "complaint"),
    [
        ("BGGR_PISP_COMP1", "which loses counts: .*unpacked"),
        ("SRGGB12_CSI2P", "the packed format SRGGB12_CSI2P"),
        ("SBGGR12", r"grants BGGR where the board profile says RGGB: mend sensor\.bayer_order"),
        ("SRGGB10", r"grants 10 where the board profile says 12: mend libcamera\.raw_bits"),
        ("NV12", "no raw colour format"),
    ],
)
def test_another_raw_format_is_refused_and_the_camera_given_back(wired: Wired, granted: str, complaint: str) -> None:
    wired.cameras.faults.raw_format = granted
    with pytest.raises(CameraError, match=complaint), wired.hardware:
        pass
    assert wired.cameras.opened == 0
    wired.cameras.faults.raw_format = ""
    with wired.hardware as hardware:
        hardware.camera.next_frame(1.0)


@pytest.mark.parametrize("fault", ["no_raw", "no_raw_granted"])
def test_a_camera_without_raw_such_as_the_virtual_one_is_refused_by_name(wired: Wired, fault: str) -> None:
    setattr(wired.cameras.faults, fault, True)
    with pytest.raises(CameraError, match="grants no raw stream, as a USB or virtual camera"), wired.hardware:
        pass
    assert wired.cameras.opened == 0


def test_a_missing_an_ambiguous_and_a_busy_camera_are_named(wired: Wired) -> None:
    wired.bench.faults.camera_missing = True
    wired.cameras.others = ["/base/soc/usb/cam@1"]
    with pytest.raises(CameraError, match=r"imx296@1a is not there: cameras are /base/soc/usb/cam@1; check the ribbon"):
        wired.hardware.camera.__enter__()
    wired.bench.faults.camera_missing = False
    wired.cameras.others = [CAMERA_ID.replace("i2c@1", "i2c@0")]
    with pytest.raises(CameraError, match="is ambiguous"):
        wired.hardware.camera.__enter__()
    wired.cameras.others, wired.cameras.faults.in_use = ["/base/soc/usb/cam@1"], True
    with pytest.raises(CameraError, match="no other program uses it"):
        wired.hardware.camera.__enter__()
    wired.cameras.faults.in_use = False
    with wired.hardware.camera as camera:
        assert camera.camera_id == CAMERA_ID


def test_no_memory_at_configure_says_what_to_give_it(wired: Wired) -> None:
    wired.cameras.faults.no_memory = True
    with pytest.raises(CameraError, match=r"no memory to be configured: give the kernel more \(cma"), wired.hardware:
        pass
    assert wired.cameras.opened == 0


def test_a_stalled_pipeline_is_opened_again_and_keeps_its_settings(wired: Wired) -> None:
    asked = CameraSettings(3_000.0, 2.0)
    wired.cameras.faults.stalled_openings = MOST_RESTARTS
    with wired.hardware as hardware:
        hardware.camera.apply(asked)
        frame = hardware.camera.next_frame(1.0)
        assert hardware.clock.monotonic_ns() == pytest.approx(MOST_RESTARTS * 1e9, rel=0.1)
    assert frame.granted.exposure_us == pytest.approx(asked.exposure_us, rel=0.02)
    assert frame.granted.analogue_gain == pytest.approx(asked.analogue_gain, rel=0.02)


def test_a_camera_that_stays_stalled_is_named_and_works_when_it_is_well_again(wired: Wired) -> None:
    with wired.hardware as hardware:
        wired.bench.faults.camera_stalled = True
        with pytest.raises(FrameTimeout, match="though it was restarted 2 times"):
            hardware.camera.next_frame(0.5)
        wired.bench.faults.camera_stalled = False
        assert hardware.camera.next_frame(0.5).shape == hardware.camera.shape


def test_a_camera_that_is_unplugged_and_plugged_in_again(wired: Wired) -> None:
    with wired.hardware as hardware:
        hardware.camera.next_frame(0.5)
        wired.bench.faults.camera_missing = True
        with pytest.raises(CameraError, match="is not there"):
            hardware.camera.next_frame(0.5)
        with pytest.raises(CameraError, match="is not there"):
            hardware.camera.next_frame(0.5)
        wired.bench.faults.camera_missing = False
        assert hardware.camera.next_frame(0.5).shape == hardware.camera.shape


def test_a_frame_of_the_wrong_size_is_refused_and_its_buffer_given_back(wired: Wired) -> None:
    with wired.hardware as hardware:
        wired.cameras.faults.rows_lost = 2
        for _ in range(5):
            with pytest.raises(CameraError, match=r"270 rows .* where it granted 272"):
                hardware.camera.next_frame(0.5)
        assert wired.cameras.held_requests == 0
        wired.cameras.faults.rows_lost = 0
        hardware.camera.next_frame(0.5)


def test_what_picamera2_raises_on_a_buffer_is_told_and_the_buffer_given_back(wired: Wired) -> None:
    wired.cameras.faults.unmappable = True
    with wired.hardware as hardware:
        for take in (hardware.camera.next_frame, hardware.camera.aiming_view):
            with pytest.raises(CameraError, match=r"cannot hand out a frame \(cannot reshape"):
                take(0.5)
        assert wired.cameras.held_requests == 0


@pytest.mark.parametrize("key", ["SensorTimestamp", "ExposureTime", "AnalogueGain", "SensorBlackLevels"])
def test_a_frame_without_proof_is_refused(wired: Wired, key: str) -> None:
    wired.cameras.faults.without = key
    with wired.hardware as hardware, pytest.raises(CameraError, match=key):
        hardware.camera.next_frame(0.5)


@pytest.mark.parametrize("ahead_s", [5.0, -1000.0])
def test_frames_stamped_by_another_clock_are_refused(wired: Wired, ahead_s: float) -> None:
    wired.cameras.faults.clock_offset_ns = round(ahead_s * 1e9)
    with wired.hardware as hardware, pytest.raises(CameraError, match="not by the monotonic clock"):
        hardware.camera.next_frame(0.5)


def test_buffers_are_always_given_back(wired: Wired) -> None:
    with wired.hardware as hardware:
        for _ in range(20):
            hardware.camera.next_frame(0.5)
            hardware.camera.aiming_view(0.5)
            with pytest.raises(FrameTimeout):
                hardware.camera.next_frame(1e-6)
        assert wired.cameras.held_requests == 0
    assert wired.cameras.opened == 0


def test_aiming_is_live_at_ten_views_a_second(wired: Wired) -> None:
    with wired.hardware as hardware:
        hardware.lights.switch_on(hardware.profile.currents_ma)
        hardware.clock.sleep(0.1)
        began_ns = hardware.clock.monotonic_ns()
        views = [hardware.camera.aiming_view(0.5) for _ in range(20)]
        assert (hardware.clock.monotonic_ns() - began_ns) * 1e-9 <= 2.0
    assert {view.shape for view in views} == {(120, 160)}
    assert all(view.mean() > 20.0 for view in views)


def test_a_control_that_the_camera_does_not_know_is_refused(wired: Wired) -> None:
    profile = wired.bench.profile
    facts: LibcameraFacts = msgspec.structs.replace(profile.libcamera, lens_position=5.0)
    camera = PicameraCamera(profile.sensor, facts, profile.camera.settings, lambda: wired.cameras, wired.hardware.clock)
    with pytest.raises(CameraError, match="AfMode is not advertised"):
        camera.__enter__()


def test_without_picamera2_its_installation_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hal.driver_library.find_spec", lambda _name: None)
    with pytest.raises(DriverMissing, match="apt install python3-picamera2 --no-install-recommends"):
        load_picamera2()
