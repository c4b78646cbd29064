"""The driver of sensors on USB, on an emulated one: what is locked and proved, refused by name, lost and found."""

import cv2
import msgspec
import numpy as np
import pytest
from fake_v4l2 import CARD, FakeVideo, encoded, usb_sensor, uvc_profile

from hal.drivers.camera_uvc import WHITE_DN, ChosenCamera, UvcCamera, decoded, mosaic_of
from hal.drivers.v4l2_stack import StreamFormat, VideoInfo
from hal.errors import BoardProfileError, CameraError, FrameTimeout, LightError
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.profile_tables import UvcConfig
from hal.simulator.bench import SimulatedScene

ASKED = CameraSettings(exposure_us=3_000.0, analogue_gain=2.0)


@pytest.fixture
def sensor(bench: SimulatedScene) -> tuple[Hardware, FakeVideo]:
    return usb_sensor(bench)


def _camera(bench: SimulatedScene, config: UvcConfig, video: FakeVideo | None = None) -> UvcCamera:
    profile = uvc_profile(bench.profile)
    chosen = ChosenCamera(video or FakeVideo(bench), config.card)
    return UvcCamera(profile.sensor, config, profile.camera.settings, chosen, bench.clock)


def test_everything_automatic_is_off_and_reads_so(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    assert video.controls["automatic_exposure"] == 3
    with hardware:
        frame = hardware.camera.next_frame(1.0)
        assert video.controls["automatic_exposure"] == 1
        assert video.controls["exposure_time"] == 20
        assert [video.controls[name] for name in ("white_balance_automatic", "exposure_dynamic_framerate")] == [0, 0]
        assert video.controls["white_balance_temperature"] == 4600
    assert frame.granted == CameraSettings(2000.0, 1.0)
    assert video.opened == 0


def test_new_settings_show_only_once_they_can_have_taken_effect(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    with hardware:
        hardware.camera.next_frame(1.0)
        hardware.camera.apply(ASKED)
        seen = [hardware.camera.next_frame(1.0).granted for _ in range(6)]
    assert seen[0] == CameraSettings(2000.0, 1.0)
    assert seen[-1] == ASKED
    assert (video.controls["exposure_time"], video.controls["gain"]) == (30, 32)


@pytest.mark.parametrize(
    ("control", "complaint"),
    [
        ("automatic_exposure", "cannot lock its exposure: it has no control 'automatic_exposure'"),
        ("exposure_time", "cannot lock its exposure: it has no control 'exposure_time'"),
        ("gain", "cannot lock its gain: it has no control 'gain'"),
        ("white_balance_automatic", "cannot lock its white balance: it has no control"),
    ],
)
def test_what_has_no_control_is_refused_by_name(
    sensor: tuple[Hardware, FakeVideo], control: str, complaint: str
) -> None:
    hardware, video = sensor
    video.faults.lacks.add(control)
    with pytest.raises(CameraError, match=complaint), hardware:
        pass
    assert video.opened == 0


def test_focus_without_a_control_is_refused_unless_it_is_said_to_be_fixed(bench: SimulatedScene) -> None:
    profile = uvc_profile(bench.profile)
    assert profile.uvc
    config = msgspec.structs.replace(profile.uvc, fixed=())
    camera = _camera(bench, config)
    with pytest.raises(CameraError, match=r"cannot lock its focus.*add 'focus' to uvc\.fixed"), camera:
        pass


@pytest.mark.parametrize(
    "control", ["automatic_exposure", "exposure_time", "white_balance_automatic", "exposure_dynamic_framerate"]
)
def test_a_control_that_keeps_another_value_is_refused_by_name(
    sensor: tuple[Hardware, FakeVideo], control: str
) -> None:
    hardware, video = sensor
    video.faults.ignores.add(control)
    with pytest.raises(CameraError, match=f"does not keep its control {control}"), hardware:
        pass


def test_a_control_that_another_program_changes_is_found_at_the_next_frame(
    sensor: tuple[Hardware, FakeVideo],
) -> None:
    hardware, video = sensor
    with hardware:
        hardware.camera.next_frame(1.0)
        video.controls["white_balance_temperature"] = 3000
        with pytest.raises(CameraError, match="white_balance_temperature: 4600 was set and 3000 is read"):
            hardware.camera.next_frame(1.0)
        assert hardware.camera.next_frame(1.0).granted == CameraSettings(2000.0, 1.0)
        assert video.controls["white_balance_temperature"] == 4600


def test_a_control_without_a_value_keeps_the_one_first_read(bench: SimulatedScene) -> None:
    profile, video = uvc_profile(bench.profile), FakeVideo(bench)
    assert profile.uvc
    camera = _camera(bench, msgspec.structs.replace(profile.uvc, white_balance_k=None), video)
    video.controls["white_balance_temperature"] = 5100
    with camera:
        camera.next_frame(1.0)
        video.controls["white_balance_temperature"] = 3000
        camera.apply(ASKED)
        assert video.controls["white_balance_temperature"] == 5100
        video.unplug()
        with pytest.raises(CameraError, match="does not answer"):
            camera.next_frame(1.0)
        video.plug_in()
        assert video.controls["white_balance_temperature"] == 4600
        camera.next_frame(1.0)
        assert video.controls["white_balance_temperature"] == 5100
        video.faults.ignores.add("white_balance_temperature")
        video.controls["white_balance_temperature"] = 3000
        with pytest.raises(CameraError, match="white_balance_temperature: 5100 was set and 3000 is read"):
            camera.apply(ASKED)


def test_an_exposure_without_a_control_stays_the_profiles_whatever_is_asked(bench: SimulatedScene) -> None:
    profile, video = uvc_profile(bench.profile), FakeVideo(bench)
    assert profile.uvc
    video.faults.lacks |= {"automatic_exposure", "exposure_time"}
    video.controls |= {"automatic_exposure": 1, "exposure_time": 20}
    with _camera(bench, msgspec.structs.replace(profile.uvc, fixed=("focus", "exposure")), video) as camera:
        camera.apply(CameraSettings(exposure_us=9_000.0, analogue_gain=2.0))
        seen = [camera.next_frame(1.0).granted for _ in range(6)]
    assert seen[-1] == CameraSettings(profile.camera.exposure_us, 2.0)


def test_a_control_of_the_profile_that_the_camera_lacks_is_refused(bench: SimulatedScene) -> None:
    profile = uvc_profile(bench.profile)
    assert profile.uvc
    for controls, complaint in (({"sharpness": 0}, "has no control sharpness"), ({"sharpest": 0}, "is not a control")):
        config = msgspec.structs.replace(profile.uvc, controls=controls)
        camera = _camera(bench, config)
        with pytest.raises(CameraError, match=complaint), camera:
            pass


def test_unplugged_is_said_and_plugged_in_again_is_mended(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    with hardware:
        hardware.camera.next_frame(1.0)
        video.unplug()
        with pytest.raises(CameraError, match=r"does not answer.*plug it in again"):
            hardware.camera.next_frame(1.0)
        with pytest.raises(CameraError, match=f"{CARD} is not there: cameras are none"):
            hardware.camera.apply(hardware.profile.camera.settings)
        video.plug_in()
        hardware.camera.apply(hardware.profile.camera.settings)
        assert hardware.camera.next_frame(1.0).granted == CameraSettings(2000.0, 1.0)
        assert video.controls["automatic_exposure"] == 1
    assert video.opened == 0


@pytest.mark.parametrize("plugged_again", [False, True])
def test_pictures_before_the_camera_has_settled_are_dropped(
    sensor: tuple[Hardware, FakeVideo], plugged_again: bool
) -> None:
    hardware, video = sensor
    with hardware:
        settled = hardware.camera.next_frame(1.0)
    video.faults.unsettled = 3
    with hardware:
        first = hardware.camera.next_frame(1.0)
        if plugged_again:
            video.unplug()
            with pytest.raises(CameraError, match="does not answer"):
                hardware.camera.next_frame(1.0)
            video.plug_in()
            first = hardware.camera.next_frame(0.1)
    assert np.median(first.mosaic) > 0.9 * np.median(settled.mosaic)


def test_another_sensor_of_the_name_is_not_taken_for_the_one_that_was_unplugged(
    sensor: tuple[Hardware, FakeVideo],
) -> None:
    hardware, video = sensor
    twin = VideoInfo(video.path, CARD, "D20002")
    with hardware:
        hardware.camera.next_frame(1.0)
        assert hardware.camera.camera_id == CARD
        video.unplug()
        video.others = [twin]
        with pytest.raises(CameraError, match="does not answer"):
            hardware.camera.next_frame(1.0)
        with pytest.raises(CameraError, match=r"is not there: cameras are .* D20002 \(/dev/video2\)"):
            hardware.camera.next_frame(1.0)
        video.plug_in()
        assert hardware.camera.next_frame(1.0).mosaic.any()


def test_a_serial_number_chooses_among_sensors_of_one_name(bench: SimulatedScene) -> None:
    video = FakeVideo(bench)
    video.others = [VideoInfo("/dev/video7", CARD, "D20002"), VideoInfo("/dev/video8", CARD, "D20003")]
    with pytest.raises(CameraError, match="is ambiguous"):
        ChosenCamera(video, "GelSight Mini").open()
    video.path = "/dev/video8"
    chosen = ChosenCamera(video, "D20003")
    chosen.open().close()
    assert chosen.name == f"{CARD} D20003"


def test_a_stalled_camera_is_reopened(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    with hardware:
        video.faults.stalled = True
        with pytest.raises(FrameTimeout, match="no whole frame"):
            hardware.camera.next_frame(1.0)
        video.faults.stalled = False
        assert hardware.camera.next_frame(1.0).mosaic.any()
        assert video.opened == 1


def test_damaged_pictures_are_left_out(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    with hardware:
        video.faults.damaged = 3
        frame = hardware.camera.next_frame(1.0)
        assert np.median(frame.mosaic) > 1000
        assert video.faults.damaged == 0


def test_pictures_that_nobody_took_are_not_handed_out_late(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, _ = sensor
    with hardware:
        hardware.camera.next_frame(1.0)
        hardware.clock.sleep(5.0)
        asked_ns = hardware.clock.monotonic_ns()
        assert hardware.camera.next_frame(1.0).sensor_timestamp_ns > asked_ns - 1e7


def test_absent_ambiguous_and_another_format_are_said(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, video = sensor
    video.others = [VideoInfo("/dev/video0", "GelSight Mini R0B 1111-1111: Ge")]
    with pytest.raises(CameraError, match=r"is ambiguous: cameras are GelSight Mini R0B 1111.*/dev/video0"), hardware:
        pass
    video.others.clear()
    video.faults.another_format = "YUYV"
    with pytest.raises(CameraError, match="grants YUYV of 364x272 where the board profile asks for MJPG"), hardware:
        pass
    assert video.opened == 0


def test_lights_that_are_always_on_cannot_shine_alone(sensor: tuple[Hardware, FakeVideo]) -> None:
    hardware, _ = sensor
    everything = hardware.profile.currents_ma
    with hardware:
        hardware.lights.switch_on(everything)
        hardware.lights.off()
        assert hardware.lights.granted_ma(everything) == everything
        with pytest.raises(LightError, match="always on: none of them can shine alone"):
            hardware.lights.switch_on({"red": everything["red"]})
        with pytest.raises(LightError, match="light red cannot be set to 1 mA"):
            hardware.lights.granted_ma({"red": 1.0})


def test_lights_of_the_zoom_control_are_set_and_read_back(bench: SimulatedScene) -> None:
    hardware, video = usb_sensor(bench, switched_by_zoom=True)
    with hardware:
        granted = hardware.lights.granted_ma({"red": 6.4, "green": 4.9, "blue": 4.9})
        assert granted == {"red": 6.0, "green": 5.0, "blue": 5.0}
        hardware.lights.switch_on(granted)
        assert video.controls["zoom"] == 0x655
        assert bench.currents_ma == granted
        hardware.lights.switch_on({"blue": 3.0})
        assert bench.currents_ma == {"blue": 3.0}
        for wrong, complaint in (({"red": 16.0}, "0 to 15"), ({"white": 1.0}, "no light 'white'")):
            with pytest.raises(LightError, match=complaint):
                hardware.lights.switch_on(wrong)
    assert video.controls["zoom"] == 0
    video.faults.ignores.add("zoom")
    with pytest.raises(LightError, match="do not keep their steps"):
        hardware.lights.switch_on({"blue": 3.0})
    video.unplug()
    with pytest.raises(LightError, match="is not there"):
        hardware.lights.off()


@pytest.mark.parametrize("letters", ["MJPG", "YUYV", "RGB3"])
def test_pixel_formats_show_the_same_picture(letters: str) -> None:
    ramp = np.linspace(20.0, 220.0, 64)
    picture = np.stack([np.tile(ramp, (48, 1)), np.full((48, 64), 90.0), np.full((48, 64), 160.0)], axis=-1)
    stream = StreamFormat(64, 48, letters, {"YUYV": 128, "RGB3": 192}.get(letters, 0))
    shown = decoded(encoded(picture.astype(np.uint8), stream), stream)
    assert shown is not None
    assert np.abs(shown.astype(float) - picture).mean() < 2.5
    assert decoded(b"none", stream) is None


def test_a_mosaic_holds_the_mean_light_around_each_pixel_and_shows_saturation() -> None:
    flat = mosaic_of(np.full((4, 4, 3), (10, 20, 30), np.uint8), "linear")
    assert (flat[0, 0], flat[0, 1], flat[1, 0], flat[1, 1]) == (30 * 257, 20 * 257, 20 * 257, 10 * 257)
    spot = np.zeros((8, 8, 3), np.uint8)
    spot[4, 4] = 100
    mosaic = mosaic_of(spot, "linear")
    assert (mosaic[4, 4], mosaic[4, 5], mosaic[3, 4], mosaic[5, 5]) == (6425, 3212, 3212, 1606)
    assert mosaic[2, 4] == mosaic[4, 6] == 0
    spot[4, 4] = 255
    assert (mosaic_of(spot, "linear") == WHITE_DN).sum() == 9
    grey = mosaic_of(np.full((2, 2, 3), 128, np.uint8), "srgb")
    assert abs(float(grey[0, 0]) / WHITE_DN - 0.2158) < 1e-3


def test_colours_of_a_mosaic_stay_where_they_were_seen() -> None:
    ramp = np.tile(np.arange(64, dtype=np.uint8)[None, :, None] * 3, (64, 1, 3))
    mosaic = mosaic_of(ramp, "linear")
    inner = mosaic[2:-2, 2:-2].astype(float) / 257.0
    assert np.abs(inner - 3.0 * np.arange(2, 62)).max() < 0.01


def test_a_damaged_jpeg_is_none_and_its_size_is_checked() -> None:
    _, data = cv2.imencode(".jpg", np.zeros((32, 32, 3), np.uint8))
    assert decoded(data.tobytes(), StreamFormat(64, 48, "MJPG", 0)) is None
    assert decoded(data.tobytes()[:40], StreamFormat(32, 32, "MJPG", 0)) is None


def test_a_profile_without_its_table_is_refused(bench: SimulatedScene) -> None:
    from hal.drivers.usb_hardware import usb_hardware

    with pytest.raises(BoardProfileError, match=r"no \[uvc\] table"):
        usb_hardware(bench.profile, bench.clock, FakeVideo(bench))
    assert UvcConfig(card="abc", columns=16, rows=16, frame_period_us=1.0).lights == "always on"
