from pathlib import Path

import msgspec
import numpy as np
import pytest

from hal.board_profile import load_board_profile
from hal.drivers.lights_pca9955b import Pca9955b
from hal.drivers.lights_tlc59116 import Tlc59116
from hal.errors import BoardProfileError
from hal.frame import CameraSettings
from hal.profile_tables import profile_names
from hal.simulator.camera import SENSORS, granted


def rewritten(folder: Path, old: str, new: str, name: str = "twin") -> Path:
    """A profile with one text replaced, as a file."""
    board = Path(__file__).parents[2] / "board" / f"{name}.toml"
    text = board.read_text()
    assert old in text
    path = folder / "changed.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(("name", "distance_mm"), [("twin", 25.0), ("twin-distant", 250.0)])
def test_reference_profiles_are_as_the_design_states(name: str, distance_mm: float) -> None:
    profile = load_board_profile(name)
    assert profile.name == name
    assert (profile.sensor.columns, profile.sensor.rows) == (1456, 1088)
    assert profile.sensor.pixel_pitch_um == 12.0
    assert (profile.sensor.full_well_e, profile.sensor.read_noise_e) == (10_000.0, 3.0)
    places = np.array([light.position_mm for light in profile.lights])
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), distance_mm, rtol=1e-4)
    np.testing.assert_allclose(places[:, 2] / distance_mm, np.sin(np.radians(30.0)), rtol=1e-4)
    np.testing.assert_allclose(places[:, :2].sum(axis=0), 0.0, atol=2e-3)


def test_a_path_is_read_as_well_as_a_name(tmp_path: Path) -> None:
    path = rewritten(tmp_path, 'name = "twin"', 'name = "mine"')
    assert load_board_profile(path).name == load_board_profile(str(path)).name == "mine"


def test_unknown_name_lists_the_known_ones() -> None:
    assert set(profile_names()) >= {"twin", "twin-distant"}
    with pytest.raises(BoardProfileError, match=r"'twim'.*twin, twin-distant"):
        load_board_profile("twim")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("retrograph.board/1", "retrograph.board/9", r"schema: .*accepted: retrograph\.board/1"),
        ('driver = "twin"', 'driver = "webcam"', r"driver: \'webcam\' is not accepted; accepted: picamera2, twin"),
        ('"RGGB"', '"RGBG"', r"sensor\.bayer_order: \'RGBG\'.*accepted: BGGR, GBRG, GRBG, RGGB, as granted"),
        ("rows = 1088", "rows = 1087", r"sensor\.rows: .*multiple of 2"),
        (
            "read_noise_e = 3.0",
            'read_noise_e = "low"',
            r"sensor\.read_noise_e: 'low' is.*: a number from 0",
        ),
        ("full_well_e = 10000.0\n", "", r"sensor\.full_well_e: is missing; accepted: a number above 0"),
        ("seed = 1", "sead = 1", r"twin: .*sead.*accepted: skin, seed"),
        ('skin = "diffuse"', 'skin = "chrome"', r"twin\.skin: .*accepted: diffuse, flake, sharp-flake"),
        ('colour = "G"', 'colour = "Y"', r"lights\[1\]\.colour: \'Y\' is not accepted; accepted: B, G, R"),
        ('colour = "G"', 'kolour = "G"', r"lights\[1\]: .*kolour.*accepted: name, colour"),
        ('colour = "G"', 'colour = "R"', r"lights: colours are R, R, B; accepted: the order R, G, B"),
        ('name = "green"', 'name = "red"', r"lights: two have"),
        ("12.500]", "-12.500]", r"lights: position_mm of red .*accepted: z > 0"),
        ("white_level_dn = 4095.0", "white_level_dn = 200.0", r"sensor\.white_level_dn"),
        (
            '[twin]\nskin = "diffuse"\nseed = 1\ncamera_distance_mm = 160.0  # a 35 mm lens at this field\n',
            "",
            r"twin: .*\[twin\] table",
        ),
        ("[gel]", "[gel", r"is not TOML"),
        ("exposure_us = 2000.0", "exposure_us = inf", r"camera\.exposure_us: inf is not accepted; accepted: a number"),
        ("exposure_us = 2000.0", "exposure_us = nan", r"camera\.exposure_us: .*accepted: a (finite )?number"),
        ("current_ma = 6.4", "current_ma = inf", r"lights\[0\]\.current_ma: is not finite"),
        ("12.500]", "inf]", r"lights\[0\]\.position_mm\[2\]: is not finite"),
        (
            "0.000, -21.651, 12.500]",
            "0.000, 12.500]",
            r"position_mm: a list of 2 .*a list of 3, each a n",
        ),
        ("seed = 1", "seed = -1", r"twin\.seed: -1 is not accepted; accepted: a whole number from 0"),
        ('name = "twin"', "name = 7", r"name: 7 is not accepted; accepted: a text"),
    ],
)
def test_wrong_profile_names_file_key_and_what_is_accepted(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = rewritten(tmp_path, old, new)
    with pytest.raises(BoardProfileError, match=message) as caught:
        load_board_profile(path)
    assert str(caught.value).startswith(str(path))


def test_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    with pytest.raises(BoardProfileError, match="cannot be read") as caught:
        load_board_profile(path)
    assert str(path) in str(caught.value)


def test_text_in_another_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "latin.toml"
    path.write_bytes(b'name = "\xb5"\n')
    with pytest.raises(BoardProfileError, match="is not TOML"):
        load_board_profile(path)


REAL_BOARDS = ("pi4-imx477", "pi4-imx477-binned", "pi5-imx296", "zero2w-imx708")


@pytest.mark.parametrize("name", REAL_BOARDS)
def test_real_boards_are_complete(name: str) -> None:
    profile = load_board_profile(name)
    assert profile.name == name
    assert profile.driver == "picamera2"
    assert profile.libcamera is not None
    assert profile.sensor.model.lower() in profile.libcamera.camera_id
    assert profile.libcamera.frame_period_us <= 100_000.0
    assert "under-voltage" in profile.capabilities


def test_capabilities_follow_from_the_tables(tmp_path: Path) -> None:
    assert load_board_profile("twin").capabilities == frozenset()
    everything = {"indicator", "under-voltage", "battery", "light-current", "live-aiming"}
    assert load_board_profile("pi5-imx296").capabilities == everything - {"battery"}
    gauge = '[power.fuel_gauge]\nchip = "MAX17048"\nbus = 1\n\n[lens]\n'
    assert load_board_profile(rewritten(tmp_path, "[lens]\n", gauge, "pi5-imx296")).capabilities == everything
    assert load_board_profile("zero2w-imx708").capabilities == {"under-voltage", "focus", "live-aiming"}
    assert "live-aiming" not in load_board_profile("pi4-imx477").capabilities
    assert "live-aiming" in load_board_profile("pi4-imx477-binned").capabilities


def test_the_binned_profile_sees_the_field_of_the_full_one_with_half_its_pixels() -> None:
    full, binned = (load_board_profile(name) for name in ("pi4-imx477", "pi4-imx477-binned"))
    for size in ("columns", "rows"):
        assert getattr(full.sensor, size) == 2 * getattr(binned.sensor, size)
    assert binned.sensor.pixel_pitch_um == 2.0 * full.sensor.pixel_pitch_um
    assert (full.lights, full.gel, full.camera) == (binned.lights, binned.gel, binned.camera)


@pytest.mark.parametrize("name", REAL_BOARDS)
def test_exposures_of_real_boards_are_fine_steps(name: str) -> None:
    profile = load_board_profile(name)
    assert profile.camera.exposure_us >= 50.0 * profile.sensor.exposure_step_us


def test_the_global_shutter_camera_hands_out_bggr_on_every_board() -> None:
    assert load_board_profile("pi5-imx296").sensor.bayer_order == "BGGR"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("address = 0x15", "address = 0x99", r"light_driver\.address: 153 .*accepted: a whole number from 8 to 119"),
        ('chip = "PCA9955B"', 'chip = "PCA9685"', r"light_driver\.chip: .*accepted: PCA9955B, TLC59116"),
        ("channels = [4, 5]", "channels = [4, 1]", r"lights: channel 1 is named twice"),
        ("channels = [4, 5]", "channels = [4, 16]", r"lights\[1\]\.channels\[1\]: 16 .*from 0 to 15"),
        ("channels = [4, 5]\n", "", r"lights: green has no channels"),
        ("channel = 15", "channel = 9", r"lights: channel 9 is named twice"),
        ("channel = 15", "channel = 15\nline = 3", r"indicator: accepted: exactly one"),
        ("channel = 15 ", "line = 17 ", r"indicator\.line: 17 is the button's line"),
        ("raw_bits = 16", "raw_bits = 12", r"sensor\.white_level_dn: accepted: less than 2\^raw_bits, 4096"),
        (
            "buffer_count = 4",
            "aiming_rows = 180",
            r"libcamera\.aiming_rows: 180 .*only a part of the field; .*about 240",
        ),
        ("raw_bits = 16", "raw_bits = 11", r"libcamera\.raw_bits: 11 .*accepted: 8, 10, 12, 14, 16"),
        ("frame_period_us = 16667.0", "frame_period_us = 1000.0", r"camera\.exposure_us: accepted: at most"),
        ("max_ma = 25.0 ", "max_ma = 4.0 ", r"lights: current_ma of red is 6\.4; accepted: at most its max_ma, 4"),
        ("analogue_gain = 1.0", "analogue_gain = 65.0", r"camera\.analogue_gain: 65\.0 .*to 64"),
        (
            "max_gain = 15.66 ",
            "min_gain = 1.2 ",
            r"camera\.analogue_gain: the IMX296 has no gain of 1; accepted: 1\.2 to",
        ),
        ("exposure_us = 2000.0", "exposure_us = 10.0", r"camera\.exposure_us: accepted: at least 29\.0"),
        ('[button]\nchip_label = "pinctrl-rp1"\nline = 17\n', "", r"button: .*needs a \[button\] table"),
        ('camera_id = "imx296@1a"\n', "", r"libcamera\.camera_id: is missing; accepted: a text of 3 letters"),
        ('throttled = "vcgencmd"', 'throttled = "guess"', r"power\.throttled: .*accepted: sysfs, vcgencmd"),
    ],
)
def test_wrong_wiring_names_file_key_and_what_is_accepted(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = rewritten(tmp_path, old, new, "pi5-imx296")
    with pytest.raises(BoardProfileError, match=message) as caught:
        load_board_profile(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("name", REAL_BOARDS)
def test_a_shipped_profile_requests_only_what_its_sensor_grants(name: str) -> None:
    """The twin's table of gain codes comes from the kernel drivers, not from the profiles."""
    profile = load_board_profile(name)
    sensor, asked = profile.sensor, profile.camera.settings
    found = granted(sensor.model, asked, sensor.exposure_step_us)
    assert found.analogue_gain == pytest.approx(asked.analogue_gain, rel=1e-3)
    assert found.exposure_us == pytest.approx(asked.exposure_us, abs=sensor.exposure_step_us + 1.0)
    controls = SENSORS[sensor.model]
    assert sensor.min_gain == pytest.approx(controls.gain(controls.codes[0]), rel=1e-4)
    assert sensor.max_gain == pytest.approx(controls.gain(controls.codes[1]), rel=1e-3)
    shortest_us = controls.min_lines / controls.lines_per_step * sensor.exposure_step_us + controls.offset_us
    assert (sensor.min_exposure_us or sensor.exposure_step_us) == pytest.approx(shortest_us, rel=1e-4)


@pytest.mark.parametrize(
    ("model", "asked", "gain"), [("IMX708", 1.0, 1024 / 912), ("IMX477", 1.0, 1.0), ("IMX296", 2.0, 10**0.3)]
)
def test_a_sensor_clamps_a_gain_that_it_does_not_have(model: str, asked: float, gain: float) -> None:
    assert granted(model, CameraSettings(2000.0, asked), 10.0).analogue_gain == pytest.approx(gain, rel=2e-3)


@pytest.mark.parametrize(
    ("model", "step_us", "frame_us", "asked_us", "exposure_us"),
    [
        ("IMX296", 14.8148, None, 1.0, 29.0),  # one line and 14.26 us
        ("IMX296", 14.8148, None, 2000.0, 1999.0),  # 134 lines and 14.26 us
        ("IMX296", 14.8148, 16667.0, 1e5, 16621.0),  # 1125 lines in a frame, 4 of them blank
        ("IMX477", 15.1667, None, 1.0, 60.0),  # four lines
        ("IMX477", 15.1667, 25000.0, 25000.0, 24661.0),  # 1648 lines, 22 of them blank
        ("IMX708", 26.7213, None, 1.0, 53.0),
        ("IMX708", 26.7213, None, 40000.0, 40001.0),  # 2993 lines: the kernel rounds to the even 2994
        ("IMX708", 26.7213, 50000.0, 50000.0, 49354.0),  # 3742 lines, 48 of them blank
    ],
)
def test_a_sensor_grants_whole_lines_within_its_frame(
    model: str, step_us: float, frame_us: float | None, asked_us: float, exposure_us: float
) -> None:
    found = granted(model, CameraSettings(asked_us, 2.0), step_us, frame_us)
    assert found.exposure_us == pytest.approx(exposure_us, abs=1.0)


def test_libcamera_reaches_only_half_of_the_gains_of_the_global_shutter_sensor() -> None:
    assert granted("IMX296", CameraSettings(2000.0, 64.0), 14.8148).analogue_gain == pytest.approx(15.668, rel=1e-4)
    assert granted("IMX296", CameraSettings(2000.0, 2.0), 14.8148).analogue_gain == pytest.approx(10**0.3, rel=1e-4)


@pytest.mark.parametrize("name", REAL_BOARDS)
def test_no_light_driver_can_exceed_the_limit_of_its_leds(name: str) -> None:
    profile = load_board_profile(name)
    assert profile.light_driver is not None
    chip = {"PCA9955B": Pca9955b, "TLC59116": Tlc59116}[profile.light_driver.chip]
    for light in profile.lights:
        assert light.max_ma is not None
        assert chip(None, profile.light_driver.reference_ohm).max_ma <= light.max_ma  # type: ignore[arg-type]


def test_a_light_without_a_limit_is_refused(tmp_path: Path) -> None:
    path = rewritten(tmp_path, "max_ma = 25.0              # continuous, of each LED\n", "", "pi5-imx296")
    with pytest.raises(BoardProfileError, match=r"lights: red has no max_ma"):
        load_board_profile(path)


def test_a_cameras_height_is_stated_or_follows_from_its_lens() -> None:
    twin, built = load_board_profile("twin"), load_board_profile("pi5-imx296")
    assert twin.pupil_height_mm == 160.0
    assert built.lens is not None
    in_air_mm = built.lens.focal_mm * (1.0 + built.sensor.pixel_pitch_um / built.lens.pixel_um)
    assert built.pupil_height_mm == pytest.approx(1.41 * in_air_mm)
    stated = msgspec.structs.replace(built, camera=msgspec.structs.replace(built.camera, pupil_height_mm=90.0))
    assert stated.pupil_height_mm == 90.0
    assert load_board_profile("gelsight-mini").pupil_height_mm is None
