"""A folder is recognized by what it holds; its balls are found and shown, and what is missing is asked for."""

from __future__ import annotations

import builtins
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from ball_folder import OPTIONS, PLACES, RADIUS_PX, frame, presses, put

from device.errors import CalibrationError, CalibrationMismatch
from device.imaging.flat_field import LinearFrame, make_flat_field
from host_sync.calibration.balls import PressFrame
from host_sync.calibration.located_presses import flat_field_of, locate_all
from host_sync.calibration_file.inputs import frames_of_set
from host_sync.cli.main import main
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, load_frame_set
from host_sync.frames.linear_light import mark_pattern
from host_sync.importers.draft import Said
from host_sync.importers.image_folder import look_at, survey_radius
from host_sync.importers.recognition import IMPORTERS, Kind, read_folder, recognize


def run(*words: object) -> int:
    return main([str(word) for word in ("import", *words)])


def names_of(found: FrameSet) -> tuple[str | None, list[str]]:
    reference = found.reference.images[0].name if found.reference else None
    return reference, [press.frame.images[0].name for press in found.presses]


@pytest.mark.parametrize(
    ("rest", "names"),
    [
        ("ref.jpg", "sample_{}.jpg"),
        ("frame0.png", "Im_{}00.png"),
        ("frame_0.png", "frame_{}.png"),
        ("0.png", "{}.png"),
        ("bg-0.png", "cal-{}.png"),
        ("background.png", "{:04d}.png"),
    ],
)
def test_names_of_known_programs_distinguish_presses_and_untouched_skin(
    rest: str, names: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(tmp_path / rest)
    presses(tmp_path, names)
    assert run(tmp_path, *OPTIONS) == 0
    said = capsys.readouterr().out
    assert f"Untouched skin: {rest}" in said
    assert "7 of 7 presses show a ball" in said
    found = load_frame_set(tmp_path / "frameset.toml")
    assert names_of(found) == (rest, [names.format(number) for number in range(1, 8)])
    sheet = cv2.imread(str(tmp_path / "frameset-balls.png"))
    assert sheet is not None
    assert sheet.std() > 10.0


def test_balls_beside_numbered_calibration_frames_are_scans(tmp_path: Path) -> None:
    put(tmp_path / "background.png")
    presses(tmp_path, "calib_{}.png")
    shutil.copyfile(tmp_path / "calib_1.png", tmp_path / "sphere_0.25.png")
    assert run(tmp_path, *OPTIONS) == 0
    found = load_frame_set(tmp_path / "frameset.toml")
    assert names_of(found) == ("background.png", [f"calib_{number}.png" for number in range(1, 8)])
    assert "sphere_0.25" in [scan.name for scan in found.scans]


def test_the_width_of_the_field_states_the_pitch_with_its_uncertainty(tmp_path: Path) -> None:
    put(tmp_path / "flat.png")
    presses(tmp_path, "ball-{}.png")
    columns = cv2.imread(str(tmp_path / "flat.png")).shape[1]
    options = dict(zip(OPTIONS[::2], OPTIONS[1::2], strict=True))
    pitch_um = options.pop("--pixel-pitch-um")
    field_mm = float(pitch_um) * columns / 1e3
    others = [word for option in options.items() for word in option]
    assert run(tmp_path, "--field-mm", field_mm, "--pixel-pitch-um", pitch_um, *others) == 2
    assert run(tmp_path, "--field-mm", field_mm, *others) == 0
    found = load_frame_set(tmp_path / "frameset.toml")
    assert found.pixel_pitch_um == pytest.approx(float(pitch_um), rel=1e-4)
    assert found.pitch_tolerance == pytest.approx(0.05, rel=0.01)


def test_two_pitches_and_a_diameter_stand_in_the_set(tmp_path: Path) -> None:
    put(tmp_path / "flat.png")
    presses(tmp_path, "ball-{}.png")
    lengths = ("--pixel-pitch-um", 50, "--pixel-pitch-down-um", 54, "--ball-diameter-mm", 4, "--encoding", "linear")
    assert run(tmp_path, *lengths, "--ball-radius-mm", 2) == 2
    assert run(tmp_path, *lengths) == 0
    found = load_frame_set(tmp_path / "frameset.toml")
    assert (found.pixel_pitch_um, found.pixel_shape) == (54.0, pytest.approx(1.08))
    assert found.states_diameters
    assert found.presses[0].ball_radius_mm == 2.0


def test_the_full_scale_of_images_of_16_bit_is_stated(tmp_path: Path) -> None:
    for name, places in (("ref", []), *((f"ball-{number}", [place]) for number, place in enumerate(PLACES))):
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), frame(places).astype(np.uint16) * 16)
    assert run(tmp_path, *OPTIONS, "--full-scale", 4095) == 0
    assert load_frame_set(tmp_path / "frameset.toml").full_scale == 4095


def test_grey_images_are_refused_and_nothing_is_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "ball-{}.png")
    for image in tmp_path.iterdir():
        assert cv2.imwrite(str(image), cv2.imread(str(image), cv2.IMREAD_GRAYSCALE))
    assert run(tmp_path, *OPTIONS) == 2
    assert "is grey: give frames of three lights or more" in capsys.readouterr().err
    assert not (tmp_path / "frameset.toml").exists()


def test_a_second_import_ignores_the_contact_sheet_of_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "ball-{}.png")
    assert run(tmp_path, *OPTIONS) == 0
    assert (tmp_path / "frameset-balls.png").exists()
    assert run(tmp_path, *OPTIONS, "--out", tmp_path / "again.toml") == 0
    assert "left out" not in capsys.readouterr().out


def test_copies_of_a_press_are_named_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    (tmp_path / "sample_8.png").write_bytes((tmp_path / "sample_3.png").read_bytes())
    assert run(tmp_path, *OPTIONS) == 0
    assert "sample_8.png is the same file as sample_3.png: left out of the presses" in capsys.readouterr().out
    assert names_of(load_frame_set(tmp_path / "frameset.toml"))[1] == [f"sample_{number}.png" for number in range(1, 8)]


def test_a_first_image_that_is_pressed_is_a_press(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    presses(tmp_path, "{:04d}.png", first=0)
    assert run(tmp_path, *OPTIONS) == 0
    assert "0000.png is not taken as untouched skin: it looks like a press" in capsys.readouterr().out
    reference, found = names_of(load_frame_set(tmp_path / "frameset.toml"))
    assert (reference, len(found)) == (None, 7)


def test_a_first_image_of_another_exposure_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "frame_0.png", gain=0.7)
    presses(tmp_path, "frame_{}.png")
    assert run(tmp_path, *OPTIONS) == 0
    assert "frame_0.png is not taken as untouched skin: it looks like another exposure" in capsys.readouterr().out
    reference, found = names_of(load_frame_set(tmp_path / "frameset.toml"))
    assert (reference, len(found)) == (None, 7)


def test_a_set_that_cannot_be_read_is_not_left_behind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "ball-{}.png")
    assert main(["import", str(tmp_path), *OPTIONS, "--reference", str(tmp_path / "absent.png")]) == 2
    assert "absent.png: cannot be read" in capsys.readouterr().err
    assert main(["import", str(tmp_path), *OPTIONS]) == 0
    assert load_frame_set(tmp_path).reference is not None


def test_numbered_images_without_balls_are_scans(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in range(6):
        put(tmp_path / f"{number:03d}.png", gain=1.0 - 0.01 * number)
    assert run(tmp_path, "--pixel-pitch-um", 50, "--encoding", "linear") == 0
    assert "No press calibrates" in capsys.readouterr().out
    assert not load_frame_set(tmp_path / "frameset.toml", calibrates=False).presses


def test_frames_under_white_lamps_are_no_presses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, places in enumerate(([], PLACES[:1])):
        grey = frame(places).max(axis=-1, keepdims=True).repeat(3, axis=-1)
        assert cv2.imwrite(str(tmp_path / f"one_{number}.png"), grey)
    options = ("--pixel-pitch-um", 50, "--encoding", "linear", "--results", tmp_path / "results")
    assert run(tmp_path, *options) == 2
    said = capsys.readouterr()
    assert "no frame is a press: all channels show the same light" in said.out
    assert "no press calibrates: call the images of the ball ball-" in said.err


def test_presses_of_something_else_are_refused_for_their_balls(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise CalibrationMismatch("two gels are mixed")

    monkeypatch.setattr("host_sync.calibration.located_presses.check_agreement", refuse)
    image = np.ascontiguousarray(frame([])[..., ::-1].astype(np.float32) / 255.0)
    one = LinearFrame(image, np.zeros(image.shape[:2], np.bool_))
    press, flat_field = PressFrame("a", one, 40.0), make_flat_field(one)
    with pytest.raises(CalibrationError, match="0 usable balls in 1 calibration presses"):
        locate_all([press], flat_field, 50.0, None)


@pytest.mark.parametrize("reference", ["ref.png", None])
@pytest.mark.parametrize("dots", [False, True])
def test_import_shows_the_balls_that_calibration_uses(tmp_path: Path, reference: str | None, dots: bool) -> None:
    for number, place in enumerate([None, *PLACES]):
        image = frame([place] if place else [])
        if number == 3:  # a lamp that shines on the skin clips half of the ball
            row, column = np.mgrid[: image.shape[0], : image.shape[1]]
            image[(np.hypot(column - place[0], row - place[1]) < 27.0) & (column > place[0])] = 255
        if dots:  # the skin takes them along
            image[8 + 2 * number % 5 :: 40, 10 + number % 4 :: 40] = 0
            image = cv2.erode(image, np.ones((4, 4), np.uint8))
        if number or reference:
            assert cv2.imwrite(str(tmp_path / (f"ball-{number}.png" if number else "ref.png")), image)
    assert run(tmp_path, *OPTIONS) == 0
    found = load_frame_set(tmp_path / "frameset.toml")
    assert (mark_pattern(found.reference) is not None) == dots if found.reference else not reference
    frames = frames_of_set(found)
    flat_field = flat_field_of([*(press.frame for press in frames.presses), *frames.others], frames.reference)
    located, _ = locate_all(frames.presses, flat_field, found.pixel_pitch_um, frames.reference)
    shown = [seen.search.found for seen in look_at(found, 100)]
    assert shown == [used.balls for used in located]
    assert not shown[2]
    assert sum(map(bool, shown)) >= 5


def test_images_of_another_size_are_named_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    assert cv2.imwrite(str(tmp_path / "sample_9.png"), frame([])[:100])
    assert run(tmp_path, *OPTIONS) == 0
    assert "1 of 9 images are not 240x180 pixels, or not whole, and left out, such as sample_9.png" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(
    "table",
    [
        b"img_names;center_x;center_y;radius\r\nimgs\\0001.PNG;30,5;20,25;10,0\r\n",
        '"","img_names","center_x","center_y","radius"\n"0","imgs\\0001.png","30.5","20.25","10"\n'.encode("utf-16"),
        b"\xef\xbb\xbfimg_names, center_x, center_y, radius\nimgs/0001.png, 30.5, 20.25, 10\n,,,\n",
    ],
)
def test_circles_of_a_spreadsheet_on_windows_are_read(tmp_path: Path, table: bytes) -> None:
    for name in ("0000.png", "0001.png"):
        put(tmp_path / "imgs" / name)
    (tmp_path / "circles.csv").write_bytes(table)
    assert recognize(tmp_path) == "fots"
    (press,) = read_folder(tmp_path, "fots", Said(20.0, 2.0, "srgb")).presses
    assert press.images == (tmp_path / "imgs" / "0001.png",)
    assert press.circles == ((30.5, 20.25, 8.5),)


def test_circles_wider_than_their_ball_are_refused(tmp_path: Path) -> None:
    put(tmp_path / "0001.png")
    (tmp_path / "circles.csv").write_text("img_names,center_x,center_y,radius\n0001.png,30,20,13\n")
    assert len(read_folder(tmp_path, "fots", Said(20.0, 0.25, "srgb")).presses) == 1
    with pytest.raises(FrameSetError, match=r"radius of 13 px, and the ball has 10 px: check the ball's radius and"):
        read_folder(tmp_path, "fots", Said(20.0, 0.2, "srgb"))


@pytest.mark.parametrize("circle", ["a,20,10", "30,nan,10", "30,20,-10"])
def test_a_circle_that_is_none_is_named(tmp_path: Path, circle: str) -> None:
    put(tmp_path / "0001.png")
    (tmp_path / "circles.csv").write_text(f"img_names,center_x,center_y,radius\n0001.png,{circle}\n")
    with pytest.raises(FrameSetError, match=r"circles.csv: 0001.png: '.*' is no circle: correct the table"):
        read_folder(tmp_path, "fots", Said(20.0, 2.0, "srgb"))


def test_drawn_circles_of_fots_are_kept_narrower(tmp_path: Path) -> None:
    put(tmp_path / "0000.png")
    presses(tmp_path / "gelsight", "{:04d}.png")
    rows = ["img_names,center_x,center_y,radius"]
    rows += [f"elsewhere/gelsight/{number:04d}.png,{x:g},{y:g},30" for number, (x, y) in enumerate(PLACES, start=1)]
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv" / "annotate.csv").write_text("\n".join(rows))
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "set.yaml").write_text("mm_to_pixel: 20.0 # of another sensor 21\n")
    assert run(tmp_path, "--ball-radius-mm", 2, "--encoding", "linear") == 0
    found = load_frame_set(tmp_path / "frameset.toml")
    assert (found.pixel_pitch_um, len(found.presses)) == (50.0, 7)
    assert found.reference is not None
    assert found.presses[2].balls is not None
    ball = found.presses[2].balls[0]
    assert (ball.column, ball.row, ball.contact_radius_px) == (110.0, 120.0, pytest.approx(25.5))


@pytest.mark.parametrize(("scale", "pitch_um"), [("8,03", 124.533), ("2.0e1", 50.0), ("8.0.3", None), ("'20'", 50.0)])
def test_a_scale_next_to_a_table_of_circles_is_read_whole(scale: str, pitch_um: float | None, tmp_path: Path) -> None:
    presses(tmp_path, "{}.png")
    (tmp_path / "circles.csv").write_text("img_names,center_x,center_y,radius\n1.png,70,60,30\n")
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "set.yaml").write_text(f"mm_to_pixel: {scale}\n")
    assert read_folder(tmp_path, "fots", Said()).pixel_pitch_um == (pitch_um and pytest.approx(pitch_um, rel=1e-5))


@pytest.mark.parametrize(
    ("radius_mm", "shown", "hint"), [(8, 7, "is ball_radius_mm the diameter?"), (12, 0, "or press deeper")]
)
def test_a_radius_that_does_not_fit_is_said(
    radius_mm: float, shown: int, hint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    assert run(tmp_path, "--pixel-pitch-um", 50, "--ball-radius-mm", radius_mm, "--encoding", "linear") == 0
    said = capsys.readouterr().out
    assert f"{shown} of 7 presses show a ball" in said
    assert hint in said


def test_the_radius_of_balls_is_found_within_what_contacts_allow(tmp_path: Path) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    assert run(tmp_path, *OPTIONS) == 0
    found = load_frame_set(tmp_path / "frameset.toml")
    best = survey_radius([press.frame for press in found.presses], found.reference)
    assert best is not None
    assert best.presses == 7
    assert 0.6 * RADIUS_PX < best.radius_px < 1.7 * RADIUS_PX
    assert best.radii_px[0] < RADIUS_PX < best.radii_px[-1]


def test_what_is_stopped_is_not_in_the_way_of_the_next_try(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    with monkeypatch.context() as patch:
        patch.setattr("host_sync.importers.recognition.write_contact_sheet", stop)
        assert run(tmp_path, *OPTIONS) == 130
    assert not (tmp_path / "frameset.toml").exists()


def test_at_a_terminal_what_is_missing_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    assert run(tmp_path) == 2
    said = capsys.readouterr().err
    assert all(option in said for option in ("--pixel-pitch-um", "--ball-diameter-mm", "--encoding"))
    answers = iter(["fifty", "50", "-1", "4,0", "gamma", "linear"])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(builtins, "input", lambda _: next(answers))
    assert run(tmp_path) == 0
    assert next(answers, None) is None
    found = load_frame_set(tmp_path / "frameset.toml")
    assert (found.pixel_pitch_um, found.presses[0].ball_radius_mm, found.presses[0].frame.encoding) == (
        50.0,
        2.0,
        "linear",
    )


def test_a_kind_may_stand_before_the_folder_or_be_an_option(tmp_path: Path) -> None:
    put(tmp_path / "ref.png")
    presses(tmp_path, "sample_{}.png")
    assert run("images", tmp_path, *OPTIONS) == 0
    assert run(tmp_path, "--kind", "digit", *OPTIONS, "--out", tmp_path / "new" / "set.toml") == 0
    assert (tmp_path / "new" / "set-balls.png").is_file()


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("scan.yaml", "gelsight"),
        ("one/scan.yaml", "gelsight"),
        ("catalog.csv", "gs_sdk"),
        ("annotations/annotations.csv", "py3dcal"),
        ("dataPack.npz", "taxim"),
        ("7.jpg", "images"),
        ("film.mp4", "images"),
    ],
)
def test_files_show_the_kind(file: str, kind: Kind, tmp_path: Path) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_bytes(b"")
    assert recognize(tmp_path) == kind
    assert kind in IMPORTERS


def test_a_folder_of_nothing_known_names_the_one_inside(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no image")
    with pytest.raises(FrameSetError, match="holds no images"):
        recognize(tmp_path)
    put(tmp_path / "data" / "sample_1.png")
    with pytest.raises(FrameSetError, match=r"data is one"):
        recognize(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("frame_0.bmp", b"BM", "images of a kind that is not read: save them as PNG"),
        (
            "dataPack.npz",
            b"version https://git-lfs/v1\n",
            "a pointer of Git LFS: fetch the file itself",
        ),
        ("catalog.csv", b"experiment_reldir,diameter(mm)\n", "its table lists no press: fill it in"),
    ],
)
def test_a_folder_that_leads_nowhere_is_named_as_it_is(
    name: str, content: bytes, sentence: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FrameSetError, match=sentence):
        read_folder(tmp_path, recognize(tmp_path), Said(pixel_pitch_um=25.0))


def test_two_folders_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, tmp_path) == 2
    assert "name the one folder" in capsys.readouterr().err
