"""The camera driver on an emulated picamera2: what is refused by name, what is restarted, and that nothing leaks."""

import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from emulated_board import CAMERA_ID, EmulatedBoard, emulated_hardware

from hal.board_profile import BoardProfile, LibcameraConfig
from hal.clock import VirtualClock
from hal.drivers.camera_picamera2 import STALLED_S, PicameraCamera
from hal.drivers.picamera_stack import load_picamera2
from hal.errors import CameraError, DriverMissing, FrameTimeout
from hal.frame import BAYER_ORDERS, BayerOrder, CameraSettings
from hal.simulator.bench import SimulatedScene, build


@pytest.fixture
def emulated(bench: SimulatedScene) -> EmulatedBoard:
    return emulated_hardware(bench, "PCA9955B")


def test_stride_and_black_level_are_honoured(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        hardware.lights.switch_on(hardware.profile.currents_ma)
        hardware.clock.sleep(0.1)
        frame = hardware.camera.next_frame(1.0)
    assert frame.shape == (272, 364)
    assert 2 * 364 % 64
    assert frame.mosaic.flags.c_contiguous
    assert frame.mosaic.max() <= frame.white_level_dn
    assert frame.black_level_dn == 256.0


def test_the_time_of_a_frame_is_when_its_exposure_began(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
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


def test_everything_automatic_is_off_before_the_first_frame(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        frame = hardware.camera.next_frame(1.0)
    asked = hardware.profile.camera
    assert frame.granted.exposure_us == pytest.approx(asked.exposure_us, rel=0.02)
    assert frame.granted.analogue_gain == pytest.approx(asked.analogue_gain, rel=0.02)


@pytest.mark.parametrize(
    ("granted", "complaint"),
    [
        ("BGGR_PISP_COMP1", "which loses counts: .*unpacked"),
        ("SRGGB12_CSI2P", "the packed format SRGGB12_CSI2P"),
        ("SBGGR12", r"grants BGGR but the board profile says RGGB: correct sensor\.bayer_order, or say \"as granted\""),
        ("SRGGB10", r"grants 10 but the board profile says 12: correct libcamera\.raw_bits"),
        ("NV12", "not a raw colour format"),
    ],
)
def test_another_raw_format_is_refused_and_the_camera_given_back(
    emulated: EmulatedBoard, granted: str, complaint: str
) -> None:
    emulated.cameras.faults.raw_format = granted
    with pytest.raises(CameraError, match=complaint), emulated.hardware:
        pass
    assert emulated.cameras.opened == 0
    emulated.cameras.faults.raw_format = ""
    with emulated.hardware as hardware:
        hardware.camera.next_frame(1.0)


@pytest.mark.parametrize("order", BAYER_ORDERS)
def test_the_order_that_libcamera_grants_is_taken_where_the_profile_says_so(
    profile: BoardProfile, order: BayerOrder
) -> None:
    sensor = msgspec.structs.replace(profile.sensor, bayer_order="as granted")
    left_open = msgspec.structs.replace(profile, sensor=sensor)
    board = emulated_hardware(build(left_open, VirtualClock()), "PCA9955B")
    board.cameras.faults.raw_format = f"S{order}12"
    with board.hardware as hardware:
        assert hardware.camera.next_frame(1.0).bayer_order == order
    board.cameras.faults.raw_format = f"S{order}10"
    with pytest.raises(CameraError, match="grants 10 but the board profile says 12"), board.hardware:
        pass


@pytest.mark.parametrize("fault", ["no_raw", "no_raw_granted"])
def test_a_camera_without_raw_such_as_the_virtual_one_is_refused_by_name(emulated: EmulatedBoard, fault: str) -> None:
    setattr(emulated.cameras.faults, fault, True)
    with pytest.raises(CameraError, match="grants no raw stream, as a USB or virtual camera"), emulated.hardware:
        pass
    assert emulated.cameras.opened == 0


def test_a_missing_an_ambiguous_and_a_busy_camera_are_named(emulated: EmulatedBoard) -> None:
    emulated.bench.faults.camera_missing = True
    emulated.cameras.others = ["/base/soc/usb/cam@1"]
    with pytest.raises(CameraError, match=r"imx296@1a is not there: cameras are /base/soc/usb/cam@1; check the ribbon"):
        emulated.hardware.camera.__enter__()
    emulated.bench.faults.camera_missing = False
    emulated.cameras.others = [CAMERA_ID.replace("i2c@1", "i2c@0")]
    with pytest.raises(CameraError, match="is ambiguous"):
        emulated.hardware.camera.__enter__()
    emulated.cameras.others, emulated.cameras.faults.in_use = ["/base/soc/usb/cam@1"], True
    with pytest.raises(CameraError, match="no other program uses it"):
        emulated.hardware.camera.__enter__()
    emulated.cameras.faults.in_use = False
    with emulated.hardware.camera as camera:
        assert camera.camera_id == CAMERA_ID


def test_no_memory_at_configure_says_what_to_give_it(emulated: EmulatedBoard) -> None:
    emulated.cameras.faults.no_memory = True
    with pytest.raises(CameraError, match=r"no memory to be configured: keep dtoverlay=vc4-kms-v3d"), emulated.hardware:
        pass
    assert emulated.cameras.opened == 0


def test_a_stalled_pipeline_is_opened_again_by_the_next_call_and_keeps_its_settings(emulated: EmulatedBoard) -> None:
    asked = CameraSettings(3_000.0, 2.0)
    emulated.cameras.faults.stalled_openings = 2
    with emulated.hardware as hardware:
        hardware.camera.apply(asked)
        with pytest.raises(FrameTimeout, match=r"delivered no frame within 1 s: check its ribbon"):
            hardware.camera.next_frame(1.0)
        with pytest.raises(FrameTimeout):
            hardware.camera.aiming_view(1.0)
        assert hardware.clock.monotonic_ns() == pytest.approx(2e9, rel=0.1)
        frame = hardware.camera.next_frame(1.0)
    assert frame.granted.exposure_us == pytest.approx(asked.exposure_us, rel=0.02)
    assert frame.granted.analogue_gain == pytest.approx(asked.analogue_gain, rel=0.02)


def test_asking_for_settings_opens_a_stalled_pipeline_before_any_light_is_on(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        emulated.bench.faults.camera_stalled = True
        with pytest.raises(FrameTimeout):
            hardware.camera.next_frame(0.5)
        first = emulated.cameras.openings
        emulated.bench.faults.camera_stalled = False
        hardware.camera.apply(hardware.profile.camera.settings)
        assert emulated.cameras.openings == first + 1
        assert hardware.camera.next_frame(0.5).shape == hardware.camera.shape
        assert emulated.cameras.openings == first + 1


def test_impatience_is_no_stall(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        for _ in range(5):
            with pytest.raises(FrameTimeout):
                hardware.camera.next_frame(0.2 * STALLED_S * 1e-3)
            hardware.camera.next_frame(0.5)
        assert emulated.cameras.openings == 1


def test_requests_that_complete_while_they_are_called_off_are_given_back(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        for _ in range(5):
            emulated.cameras.faults.late_requests = 1
            with pytest.raises(FrameTimeout):
                hardware.camera.next_frame(0.3)
            assert emulated.cameras.held_requests == 0
            assert hardware.camera.next_frame(0.3).shape == hardware.camera.shape


def test_a_camera_that_is_unplugged_and_plugged_in_again(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        hardware.camera.next_frame(0.5)
        emulated.bench.faults.camera_missing = True
        with pytest.raises(FrameTimeout, match="delivered no frame within"):
            hardware.camera.next_frame(0.5)
        for ask in (lambda: hardware.camera.next_frame(0.5), lambda: hardware.camera.apply(CameraSettings(1e3, 1.0))):
            with pytest.raises(CameraError, match="is not there"):
                ask()
        emulated.bench.faults.camera_missing = False
        assert hardware.camera.next_frame(0.5).shape == hardware.camera.shape


def test_a_frame_of_the_wrong_size_is_refused_and_its_buffer_given_back(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        emulated.cameras.faults.rows_lost = 2
        for _ in range(5):
            with pytest.raises(CameraError, match=r"270 rows .* where it granted 272"):
                hardware.camera.next_frame(0.5)
        assert emulated.cameras.held_requests == 0
        emulated.cameras.faults.rows_lost = 0
        hardware.camera.next_frame(0.5)


def test_what_picamera2_raises_on_a_buffer_is_reported_and_the_buffer_given_back(emulated: EmulatedBoard) -> None:
    emulated.cameras.faults.unmappable = True
    with emulated.hardware as hardware:
        for take in (hardware.camera.next_frame, hardware.camera.aiming_view):
            with pytest.raises(CameraError, match=r"cannot deliver a frame \(cannot reshape"):
                take(0.5)
        assert emulated.cameras.held_requests == 0


@pytest.mark.parametrize("key", ["SensorTimestamp", "ExposureTime", "AnalogueGain", "SensorBlackLevels"])
def test_a_frame_without_proof_is_refused(emulated: EmulatedBoard, key: str) -> None:
    emulated.cameras.faults.without = key
    with emulated.hardware as hardware, pytest.raises(CameraError, match=key):
        hardware.camera.next_frame(0.5)


@pytest.mark.parametrize("ahead_s", [5.0, -1000.0])
def test_frames_stamped_by_another_clock_are_refused(emulated: EmulatedBoard, ahead_s: float) -> None:
    emulated.cameras.faults.clock_offset_ns = round(ahead_s * 1e9)
    with emulated.hardware as hardware, pytest.raises(CameraError, match="not the monotonic clock"):
        hardware.camera.next_frame(0.5)


def test_buffers_are_always_given_back(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        for _ in range(20):
            hardware.camera.next_frame(0.5)
            hardware.camera.aiming_view(0.5)
            with pytest.raises(FrameTimeout):
                hardware.camera.next_frame(1e-6)
        assert emulated.cameras.held_requests == 0
    assert emulated.cameras.opened == 0


def test_an_aiming_view_shows_the_whole_field(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        hardware.lights.switch_on(hardware.profile.currents_ma)
        hardware.clock.sleep(0.1)
        frame, view = hardware.camera.next_frame(0.5), hardware.camera.aiming_view(0.5)
    rows, columns = frame.shape
    for row, column in ((0, 0), (-1, 0), (0, -1), (-1, -1)):
        at = (row % view.shape[0] * rows // view.shape[0], column % view.shape[1] * columns // view.shape[1])
        seen = view[row, column] / 255.0 * frame.white_level_dn
        patch = frame.mosaic[max(at[0] - 3, 0) : at[0] + 4, max(at[1] - 3, 0) : at[1] + 4]
        assert patch.min() - 20 <= seen <= patch.max() + 20


def test_aiming_is_live_at_ten_views_a_second(emulated: EmulatedBoard) -> None:
    with emulated.hardware as hardware:
        hardware.lights.switch_on(hardware.profile.currents_ma)
        hardware.clock.sleep(0.1)
        began_ns = hardware.clock.monotonic_ns()
        views = [hardware.camera.aiming_view(0.5) for _ in range(20)]
        assert (hardware.clock.monotonic_ns() - began_ns) * 1e-9 <= 2.0
    assert {view.shape for view in views} == {(120, 160)}
    assert all(view.mean() > 20.0 for view in views)


def test_a_control_that_the_camera_does_not_know_is_refused(emulated: EmulatedBoard) -> None:
    profile = emulated.bench.profile
    facts: LibcameraConfig = msgspec.structs.replace(profile.libcamera, lens_position=5.0)
    camera = PicameraCamera(
        profile.sensor, facts, profile.camera.settings, lambda: emulated.cameras, emulated.hardware.clock
    )
    with pytest.raises(CameraError, match="AfMode is not advertised"):
        camera.__enter__()


def test_a_camera_manager_that_fails_is_reported(emulated: EmulatedBoard) -> None:
    emulated.cameras.faults.unlisted = True
    with (
        pytest.raises(CameraError, match=r"libcamera cannot list the cameras \(failed to start.*ribbon"),
        emulated.hardware,
    ):
        pass
    emulated.cameras.faults.unlisted = False
    with emulated.hardware as hardware:
        hardware.camera.next_frame(0.5)


@pytest.mark.parametrize("call", ["configure", "start"])
def test_a_time_out_of_the_kernel_is_a_fault_of_the_camera_when_it_is_opened(
    emulated: EmulatedBoard, call: str
) -> None:
    emulated.cameras.faults.timed_out = call
    with pytest.raises(CameraError, match="timed out") as reported, emulated.hardware:
        pass
    assert not isinstance(reported.value, FrameTimeout)
    assert emulated.cameras.opened == 0


@pytest.mark.parametrize("call", ["get_result", "cancel_all_and_flush"])
def test_a_time_out_of_the_kernel_is_a_fault_of_the_camera_when_it_runs(emulated: EmulatedBoard, call: str) -> None:
    with emulated.hardware as hardware:
        emulated.cameras.faults.timed_out = call
        emulated.bench.faults.camera_stalled = call != "get_result"
        with pytest.raises(CameraError, match="timed out"):
            hardware.camera.next_frame(0.5)
        emulated.cameras.faults.timed_out, emulated.bench.faults.camera_stalled = "", False
        assert hardware.camera.next_frame(0.5).shape == hardware.camera.shape
        assert emulated.cameras.openings == 2


@pytest.mark.parametrize(
    "failure",
    [
        ValueError("numpy.dtype size changed, may indicate binary incompatibility"),
        ImportError("libcamera.so.0.5: cannot open shared object file"),
        RuntimeError("module compiled against another ABI"),
    ],
)
def test_a_picamera2_that_does_not_fit_its_surroundings_is_reported(
    failure: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "picamera2.py").write_text(f"raise {failure!r}\n", encoding="utf-8")
    (tmp_path / "libcamera.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "picamera2", raising=False)
    with pytest.raises(DriverMissing, match=r"installed but cannot be imported .*simplejpeg") as reported:
        load_picamera2()
    assert str(failure) in str(reported.value)


def test_without_picamera2_its_installation_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "picamera2", None)  # as if it were not installed
    with pytest.raises(DriverMissing, match="apt install python3-picamera2 --no-install-recommends"):
        load_picamera2()
