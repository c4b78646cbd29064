from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from host_sync.api_arguments import press_frame
from host_sync.api_types import Press
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, FrameSpec, load_frame_set
from host_sync.frames.linear_light import decode_srgb, read_frame
from tests.apparatus.ball_folder import frame

DATA = Path(os.environ.get("RETROGRAPH_DATA", Path(__file__).parents[4] / "shared" / "data"))
SHAPE = (20, 30)

GOOD = """
name = "bench"
pixel_pitch_um = 10.0
encoding = "linear"
[reference]
image = "flat.png"
[[press]]
image = ["r.png", "g.png", "b.png"]
ball_radius_mm = 0.1
balls = [{ x = 12.5, y = 9, r = 6 }]
[[scan]]
name = "coin 1"
image = "scan.png"
"""

Write = Callable[[str], Path]


def rgb(seed: int = 0, shape: tuple[int, int] = SHAPE, dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, (*shape, 3)).astype(dtype)


def save(path: Path, image: np.ndarray) -> None:
    """Write an R, G, B image (or a grey one) with OpenCV, which stores B, G, R."""
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes the images of `GOOD` beside a frame set of the given text."""
    for name in ("flat.png", "scan.png"):
        save(tmp_path / name, rgb())
    for channel, name in enumerate(("r.png", "g.png", "b.png")):
        save(tmp_path / name, rgb(1)[..., channel])

    def write_text(text: str) -> Path:
        path = tmp_path / "frameset.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


def test_a_folder_stands_for_the_file_in_it(write: Write, tmp_path: Path) -> None:
    file = write(GOOD)
    assert load_frame_set(tmp_path) == load_frame_set(file)


def refused(path: Path) -> str:
    with pytest.raises(FrameSetError) as caught:
        load_frame_set(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_a_frame_set_is_read(write: Write) -> None:
    frame_set = load_frame_set(write(GOOD))
    assert (frame_set.name, frame_set.shape, frame_set.pixel_pitch_um) == ("bench", SHAPE, 10.0)
    (press,), (scan,) = frame_set.presses, frame_set.scans
    assert press.radius_px == pytest.approx(10.0)
    assert press.balls is not None
    assert (press.balls[0].column, press.balls[0].row, press.balls[0].contact_radius_px) == (12.5, 9.0, 6.0)
    assert scan.name == "coin 1"
    assert np.array_equal(read_frame(press.frame).rgb, (rgb(1) / 255.0).astype(np.float32))
    assert np.array_equal(read_frame(scan.frame).rgb, (rgb() / 255.0).astype(np.float32))


def test_backslashes_separate_folders(write: Write) -> None:
    path = write(GOOD.replace('"flat.png"', "'at rest\\flat.png'"))
    (path.parent / "at rest").mkdir()
    (path.parent / "flat.png").rename(path.parent / "at rest" / "flat.png")
    reference = load_frame_set(path).reference
    assert reference is not None
    assert reference.images == (path.parent / "at rest" / "flat.png",)


def test_balls_and_reference_may_be_left_out(write: Write) -> None:
    text = GOOD.replace('[reference]\nimage = "flat.png"\n', "").replace("balls = [{ x = 12.5, y = 9, r = 6 }]", "")
    frame_set = load_frame_set(write(text + "\n"))
    assert frame_set.reference is None
    assert frame_set.presses[0].balls is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('name = "bench"\n', "", "name is missing"),
        ("encoding", "encodng", "encodng is not a key; accepted: name, pixel_pitch_um, encoding"),
        ("ball_radius_mm", "ball_radius", "press[0]: ball_radius is not a key; accepted: image, ball_radius_mm"),
        ("= 0.1", '= "0,1"', "press[0].ball_radius_mm: is a text; accepted is a number or nothing: write it without"),
        (
            "um = 10.0",
            "um = [10,0, 10,5]",
            "pixel_pitch_um: is too long; accepted is a list of at most 2: write decimal",
        ),
        ("um = 10.0", "um = [40,5]", "pixel_pitch_um: [40, 5] are no two pitches of one camera: write decimal points"),
        ('"flat.png"', '"temp\\new.png"', 'holds a line break or a tab, which "\\n" and "\\t" in a path make'),
        ('"linear"', '"gamma"', "encoding: 'gamma' is not accepted; accepted: 'linear', 'srgb'"),
        ("10.0", '"ten"', "pixel_pitch_um: is a text; accepted is a number"),
        ("10.0", "0", "pixel_pitch_um: "),
        ("10.0", "-3", "pixel_pitch_um: "),
        ("10.0", "nan", "pixel_pitch_um: "),
        ("10.0", "inf", "pixel_pitch_um: "),
        ("0.1\n", "0.0\n", "press[0].ball_radius_mm: "),
        ("0.1\n", "0.1\ngrid_pitch_mm = -1\n", "press[0].grid_pitch_mm: "),
        ("[{ x = 12.5, y = 9, r = 6 }]", "[]", "press[0].balls: "),
        ("r = 6", "radius = 6", "press[0].balls[0]: radius is not a key"),
        ("r = 6", "r = 0", "press[0].balls[0].r: "),
        ("r = 6", "r = 10.5", "press[0].balls[0].r: a contact of 10.5 px is not smaller than the ball, 10.0 px"),
        ("x = 12.5", "x = 29.5", "press[0].balls[0]: its centre (29.5, 9) is outside the frame, 30x20"),
        ("y = 9", "y = nan", "press[0].balls[0]: its centre"),
        ("[[scan]]", "[[press]]", "press[1]: name is not a key"),
        ('"coin 1"', '"../coin"', "scan[0].name: '../coin' cannot name a result folder"),
        ('"coin 1"', '"a/b"', "scan[0].name"),
        ('"coin 1"', "'a\\b'", "scan[0].name"),
        ('"coin 1"', '".."', "scan[0].name"),
        ('"coin 1"', '""', "scan[0].name"),
        ('"coin 1"', '"Calibration"', "scan[0].name"),
        ('"scan.png"', '"gone.png"', "scan[0].image: "),
        ('"scan.png"', '"r.png"', "scan[0].image: has 1 channel and reference.image 3: name the same lights"),
        ('"scan.png"', '["r.png", "g.png"]', "scan[0].image: "),
        ('"b.png"', '"scan.png"', "press[0].image: "),
        ('"scan.png"', '"a\\u0000b"', "scan[0].image: "),
        ("name =", "name ==", "is not TOML"),
        ("[reference]", "[[reference]]", "reference: is a list; accepted is a table or nothing"),
    ],
)
def test_a_wrong_key_is_named(write: Write, old: str, new: str, sentence: str) -> None:
    assert old in GOOD
    assert sentence in refused(write(GOOD.replace(old, new, 1)))


def test_missing_lists_and_double_names_are_refused(write: Write) -> None:
    head, rest = GOOD.split("[[press]]")
    press, scan = rest.split("[[scan]]")
    assert "press: missing" in refused(write(f"{head}[[scan]]{scan}"))
    assert "scan: missing" in refused(write(f"{head}[[press]]{press}"))
    again = scan.replace("coin", "COIN")
    assert "scan[1].name: 'COIN 1' is used twice" in refused(write(f"{GOOD}[[scan]]{again}"))


@pytest.mark.parametrize(("name", "key"), [("g.png", "press[0]"), ("scan.png", "scan[0]"), ("r.png", "press[0]")])
def test_another_size_is_named(write: Write, tmp_path: Path, name: str, key: str) -> None:
    path = write(GOOD)
    image = rgb(shape=(20, 31))
    save(tmp_path / name, image if name == "scan.png" else image[..., 0])
    sentence = refused(path)
    assert f"{key}.image: {tmp_path / name} is 31x20 pixels and reference.image is 30x20" in sentence


def test_a_missing_or_wrong_frame_set_is_reported(tmp_path: Path) -> None:
    assert "cannot be read (No such file" in refused(tmp_path / "absent.toml")
    assert "holds no frameset.toml: `retrosync import` describes" in refused(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b'name = "\xff"')
    assert "is not TOML" in refused(tmp_path / "latin.toml")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.995])
def test_a_truncated_image_is_named(
    write: Write, tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, share: float
) -> None:
    image = tmp_path / f"scan{suffix}"
    smooth = cv2.GaussianBlur(rgb(shape=(200, 300)), (0, 0), 2.0)
    save(image, smooth)
    data = image.read_bytes()
    image.write_bytes(data[: int(share * len(data))])
    with pytest.raises(FrameSetError, match=re.escape(str(image))):
        read_frame(FrameSpec((image,), "linear"))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
def test_a_cut_scan_is_found_before_anything_is_calibrated(write: Write, tmp_path: Path, suffix: str) -> None:
    path = write(GOOD.replace("scan.png", f"scan{suffix}"))
    image = tmp_path / f"scan{suffix}"
    save(image, rgb(2))
    load_frame_set(path)
    data = image.read_bytes()
    for size in (len(data) // 2, len(data) * 9 // 10):
        image.write_bytes(data[:size])
        assert f"scan{suffix}: is truncated or damaged" in refused(path)


@pytest.mark.parametrize("flags", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2]])
def test_half_a_jpeg_with_a_forged_end_is_refused(tmp_path: Path, flags: list[int]) -> None:
    path = tmp_path / "frame.jpg"
    assert cv2.imwrite(str(path), cv2.resize(rgb(4), (240, 160)), flags)
    data = path.read_bytes()
    assert read_frame(FrameSpec((path,), "srgb")).rgb.shape == (160, 240, 3)
    for share in (0.3, 0.5, 0.7, 0.9):
        path.write_bytes(data[: int(len(data) * share)].rstrip(b"\xff") + b"\xff\xd9")
        with pytest.raises(FrameSetError, match="truncated or damaged"):
            read_frame(FrameSpec((path,), "srgb"))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda path: path.write_text("no image"), "holds text, such as a web page"),
        (lambda path: cv2.imwrite(str(path), np.zeros((20, 30, 4), np.uint8)), "has transparent pixels"),
        (lambda path: tifffile.imwrite(path, np.zeros((20, 30, 3), np.float32), photometric="rgb"), "holds float32"),
        (lambda path: tifffile.imwrite(path, np.zeros((2, 20, 30), np.uint8), photometric="minisblack"), "2 pages"),
        (
            lambda path: tifffile.imwrite(path, np.zeros((20, 30, 4), np.uint8), photometric="separated"),
            "neither grey nor RGB",
        ),
        (
            lambda path: path.write_bytes(
                b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\x7f\xff\xff\xff" * 2 + b"\x08\x02" + b"\0" * 9
            ),
            "more than any sensor has",
        ),
    ],
)
def test_an_image_that_carries_no_light_is_refused(
    write: Write, tmp_path: Path, make: Callable[[Path], object], sentence: str
) -> None:
    path = write(GOOD)
    make(tmp_path / "scan.png")
    message = refused(path)
    assert sentence in message
    assert f"scan[0].image: {tmp_path / 'scan.png'}" in message


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_every_depth_is_a_fraction_of_full_scale(tmp_path: Path, suffix: str, dtype: type) -> None:
    image, path = rgb(3, dtype=dtype), tmp_path / f"image{suffix}"
    save(path, image)
    frame = read_frame(FrameSpec((path,), "linear"))
    assert frame.rgb.dtype == np.float32
    assert np.array_equal(frame.rgb, (image / np.iinfo(dtype).max).astype(np.float32))


def test_a_jpeg_is_read_in_rgb_order(tmp_path: Path) -> None:
    path = tmp_path / "image.jpg"
    save(path, np.full((16, 16, 3), (200, 100, 20), np.uint8))
    assert read_frame(FrameSpec((path,), "linear")).rgb[8, 8] * 255 == pytest.approx([200, 100, 20], abs=3)


def test_srgb_is_decoded_exactly(tmp_path: Path) -> None:
    # IEC 61966-2-1: both branches meet at 0.04045, and code 188 of 255 is half the light within one code.
    assert decode_srgb(np.array([0.0, 0.04045, 1.0])) == pytest.approx([0.0, 0.0031308, 1.0], abs=1e-7)
    grey = np.repeat(np.arange(256, dtype=np.uint8).reshape(16, 16, 1), 3, axis=2)
    save(tmp_path / "grey.png", grey)
    light = read_frame(FrameSpec((tmp_path / "grey.png",), "srgb")).rgb[..., 0].ravel()
    assert light[188] == pytest.approx(0.5029, abs=1e-4)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert np.array_equal(np.round(encoded * 255), np.arange(256))


def test_a_pixel_is_clipped_when_one_channel_is(tmp_path: Path) -> None:
    image = np.full((4, 4, 3), 100, np.uint8)
    image[1, 2, 2] = 250
    image[3, 3, 0] = 249
    save(tmp_path / "image.png", image)
    clipped = read_frame(FrameSpec((tmp_path / "image.png",), "linear")).clipped
    assert np.argwhere(clipped).tolist() == [[1, 2]]


@pytest.mark.parametrize(("name", "presses", "scans"), [("oem-bga", 1, 1), ("finger", 1, 1), ("taxim-small", 39, 10)])
def test_real_sets_are_read(name: str, presses: int, scans: int) -> None:
    path = DATA / name / "frameset.toml"
    if not path.exists():
        pytest.skip(f"real frames are not here: set RETROGRAPH_DATA (looked in {DATA})")
    frame_set: FrameSet = load_frame_set(path)
    assert (len(frame_set.presses), len(frame_set.scans)) == (presses, scans)
    frame = read_frame(frame_set.scans[0].frame)
    assert frame.shape == frame_set.shape
    assert 0.02 < float(frame.rgb.mean()) < 0.9


GRID = "ball_radius_mm = 0.1\nball_radius_tolerance_mm = 0.001\ngrid_pitch_mm = 0.3\ngrid_pitch_tolerance_mm = 0.002"


def test_a_grids_spacing_and_tolerances_are_read(write: Write) -> None:
    (press,) = load_frame_set(write(GOOD.replace("ball_radius_mm = 0.1", GRID))).presses
    assert (press.grid_pitch_mm, press.grid_tolerance_mm, press.radius_tolerance_mm) == (0.3, 0.002, 0.001)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("_mm = 0.001", "_mm = 0.1", "press[0].ball_radius_tolerance_mm: 0.1 is not smaller"),
        ("_mm = 0.001", "_mm = -1", "press[0].ball_radius_tolerance_mm"),
        ("_mm = 0.002", "_mm = 0.3", "press[0].grid_pitch_tolerance_mm: 0.3 is not smaller"),
        ("grid_pitch_mm = 0.3\n", "", "press[0].grid_pitch_tolerance_mm: needs grid_pitch_mm"),
    ],
)
def test_tolerances_that_cannot_be_are_refused(write: Write, old: str, new: str, sentence: str) -> None:
    assert sentence in refused(write(GOOD.replace("ball_radius_mm = 0.1", GRID.replace(old, new))))


LAMPS = """
[[light]]
name = "red"
position_mm = [0.0, -20.0, 12.0]
[[light]]
name = "green"
position_mm = [-18.0, 10.0, 12.0]
[[light]]
name = "blue"
"""


def test_lamps_stand_where_the_file_says(write: Write) -> None:
    found = load_frame_set(write(GOOD + LAMPS + "position_mm = [18.0, 10.0, 12.0]\n"))
    assert found.lights_mm == ((0.0, -20.0, 12.0), (-18.0, 10.0, 12.0), (18.0, 10.0, 12.0))
    assert load_frame_set(write(GOOD)).lights_mm == ()


@pytest.mark.parametrize(
    ("last", "words"), [("", "stated for 2 of 3 lights"), ("position_mm = [18.0, 10.0, -1.0]\n", "position_mm")]
)
def test_lamps_of_some_lights_or_below_the_skin_are_refused(write: Write, last: str, words: str) -> None:
    with pytest.raises(FrameSetError, match=words):
        load_frame_set(write(GOOD + LAMPS + last))


def test_the_camera_stands_where_the_file_says(write: Write) -> None:
    stated = GOOD.replace('encoding = "linear"', 'encoding = "linear"\npupil_height_mm = 160')
    assert load_frame_set(write(stated)).pupil_height_mm == 160.0
    assert load_frame_set(write(GOOD)).pupil_height_mm is None
    with pytest.raises(FrameSetError, match="pupil_height_mm"):
        load_frame_set(write(stated.replace("160", "-160")))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("10.0", "20,0", "line 3, pixel_pitch_um = 20,0: write a decimal point"),
        ('"scan.png"', '"presses\\p0.png"', 'line 13, image = "presses\\p0.png": write / in paths'),
        ('"scan.png"', '"scans\\new.png"', "scan[0].image"),  # \n is an escape
        ("[[scan]]", "[scan]", "scan: is a table; accepted is a list: write [[scan]]"),
        ("[reference]", "[[reference]]", "reference: is a list; accepted is a table or nothing: write [ref"),
        ('"flat.png"', '"flat.png"\nfull_scale = 4095', "full_scale is not a key of this table: write it above"),
    ],
)
def test_a_slip_in_the_file_is_named_with_its_mend(write: Write, old: str, new: str, words: str) -> None:
    message = refused(write(GOOD.replace(old, new, 1)))
    assert words in message
    assert "name a frameset.toml" not in message


def test_a_frame_set_in_utf_16_is_named(tmp_path: Path) -> None:
    (tmp_path / "frameset.toml").write_text(GOOD, encoding="utf-16")
    assert "is text in UTF-16: save it as UTF-8" in refused(tmp_path / "frameset.toml")


def test_frames_that_are_marked_as_turned_in_different_ways_are_refused(write: Write) -> None:
    path = write(GOOD)
    exif = Image.Exif()
    for name, orientation in (("flat.png", 3), ("scan.png", 3), ("r.png", 3), ("g.png", 3), ("b.png", 3)):
        exif[274] = orientation
        Image.open(path.parent / name).save(path.parent / name, exif=exif)
    assert load_frame_set(path).shape == SHAPE
    exif[274] = 6
    Image.open(path.parent / "scan.png").save(path.parent / "scan.png", exif=exif)
    sentence = refused(path)
    assert "scan.png is marked as turned otherwise than" in sentence
    assert "(orientation 6 and 3): remove the marks" in sentence


@pytest.mark.parametrize("kind", ["png", "jpg"])
@pytest.mark.parametrize("copied", [[0, 0, 2], [0, 1, 1], [2, 1, 2]])
def test_two_equal_channels_of_a_press_are_named(write: Write, kind: str, copied: list[int]) -> None:
    image = frame([(70.0, 60.0)])[..., ::-1]
    path = write(GOOD.replace('["r.png", "g.png", "b.png"]', f'"ball.{kind}"'))
    for name in ("flat.png", "scan.png"):
        save(path.parent / name, image)
    save(path.parent / f"ball.{kind}", image)
    load_frame_set(path)
    save(path.parent / f"ball.{kind}", image[..., copied])
    (first, second) = (at for at in range(3) if copied.count(copied[at]) == 2)
    assert f"ball.{kind}: its channels {'RGB'[first]} and {'RGB'[second]} are equal" in refused(path)


def test_an_image_that_stands_for_two_lights_is_named(write: Write) -> None:
    path = write(GOOD)
    image = frame([(15.0, 10.0)])[:20, :30]
    for channel, name in enumerate(("r.png", "g.png", "b.png")):
        save(path.parent / name, image[..., channel])
    load_frame_set(path)
    shutil.copy(path.parent / "r.png", path.parent / "b.png")
    assert "press[0].image: r.png and b.png show the same: name the image of each light" in refused(path)


def test_two_equal_channels_of_an_array_are_named() -> None:
    image = frame([(70.0, 60.0)])[..., ::-1]
    form = FrameSpec((), "linear")
    assert press_frame(0, Press(image, ball_radius_mm=2.0), 50.0, form).balls is None
    with pytest.raises(FrameSetError, match="press 0: its channels G and B are equal"):
        press_frame(0, Press(np.ascontiguousarray(image[..., [0, 1, 1]]), ball_radius_mm=2.0), 50.0, form)
