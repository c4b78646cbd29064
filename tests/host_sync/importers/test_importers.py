"""Folders of the shapes that other programs write become frame sets; what they do not say is asked for by name."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from host_sync.cli.main import main
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, load_frame_set
from host_sync.importers.draft import result_names

SHAPE = (60, 80)
PUBLIC = os.environ.get("RETROGRAPH_PUBLIC", "")


def image(path: Path, *, grey: bool = False, value: int = 90) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.full(SHAPE if grey else (*SHAPE, 3), value, np.uint8)
    assert cv2.imwrite(str(path), values)
    return path


def run(*words: object) -> int:
    return main([str(word) for word in ("import", *words)])


def loaded(path: Path, *, calibrates: bool = True) -> FrameSet:
    return load_frame_set(path, calibrates=calibrates)


def scan(folder: Path, lights: int, more: str = "") -> None:
    names = [f"image{number:02d}.png" for number in range(1, lights + 1)]
    for name in names:
        image(folder / name, grey=True)
    listed = "".join(f"  - {name}\n" for name in names)
    (folder / "scan.yaml").write_text(f"images:\n{listed}mmperpixel: 0.01\ncrop: [0, 0, 0, 0]\n{more}")


CIRCLES = """iscalib: true
calibradius: 0.2
calibspacing: 1
annotations:
  - type: GridCircle
    name: Circle
    gx: 5
    r: 19.5
    x: 30.5
    y: 31.5
  - type: Line
    name: Line1
    x1: 2
device:
    lights: [true]
"""


def test_scans_of_six_lights_become_a_set(tmp_path: Path) -> None:
    scan(tmp_path / "SDK" / "BGA-001", 6, CIRCLES)
    scan(tmp_path / "SDK" / "Flat-001", 6)
    scan(tmp_path / "SDK" / "part", 6)
    (tmp_path / "SDK" / "part" / "part.tmd").write_bytes(b"")
    before = sorted(path.read_bytes() for path in (tmp_path / "SDK").rglob("*") if path.is_file())
    assert run("gelsight", tmp_path / "SDK", "--out", tmp_path / "set.toml") == 0
    assert sorted(path.read_bytes() for path in (tmp_path / "SDK").rglob("*") if path.is_file()) == before
    found = loaded(tmp_path / "set.toml")
    assert (found.pixel_pitch_um, len(found.lights), len(found.scans)) == (10.0, 6, 2)
    assert found.reference is not None
    assert found.reference.images[0].parent.name == "Flat-001"
    (press,) = found.presses
    assert press.grid_pitch_mm == 1.0
    assert press.balls is not None
    assert (press.balls[0].column, press.balls[0].row, press.balls[0].contact_radius_px) == (30.5, 31.5, 16.0)
    assert "part.tmd" in (tmp_path / "set.toml").read_text()
    assert run("gelsight", tmp_path / "SDK", "--out", tmp_path / "coarse.toml", "--pixel-pitch-um", 20) == 2


def test_a_scan_without_scale_asks_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan(tmp_path / "one", 1)
    (tmp_path / "one" / "scan.yaml").write_text("images:\n  - image01.png\nmmperpixel: 0\n")
    assert run("gelsight", tmp_path / "one") == 2
    told = capsys.readouterr().err
    assert "give --pixel-pitch-um" in told
    assert "--encoding" in told
    assert not (tmp_path / "one" / "frameset.toml").exists()
    assert run("gelsight", tmp_path / "one", "--pixel-pitch-um", 20, "--encoding", "srgb") == 0
    assert loaded(tmp_path / "one" / "frameset.toml", calibrates=False).pixel_pitch_um == 20.0


def test_names_of_scans_are_such_that_reconstruct_takes_them(tmp_path: Path) -> None:
    for name in ("Scan #3", "Scan_3", "(1)", "calibration", "scan-3", "end. "):
        scan(tmp_path / name, 3)
    assert run("gelsight", tmp_path) == 0
    found = [one.name for one in loaded(tmp_path / "frameset.toml", calibrates=False).scans]
    assert found == ["1)", "Scan -3", "Scan_3", "calibration-2", "end", "scan-3"]
    assert result_names(["a", "A", "a", "#", "x" * 200]) == ["a", "A-2", "a-3", "scan", "x" * 90]
    assert result_names(["CON", "aux.1", "com12", "con"]) == ["scan-CON", "scan-aux.1", "com12", "scan-con-2"]


def test_scans_that_call_their_lights_differently_are_not_mixed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan(tmp_path / "a", 3)
    scan(tmp_path / "b", 3)
    listed = (tmp_path / "b" / "scan.yaml").read_text()
    (tmp_path / "b" / "image01.png").rename(tmp_path / "b" / "north.png")
    (tmp_path / "b" / "scan.yaml").write_text(listed.replace("image01", "north"))
    assert run("gelsight", tmp_path) == 2
    assert "which light is which is not known" in capsys.readouterr().err


def test_a_pack_of_taxim_keeps_its_contacts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image(tmp_path / "frame_0.png")
    names = [f"frame_{number}.png" for number in range(1, 8)]
    for number, name in enumerate(names[:-1]):
        image(tmp_path / name, value=91 + number)
    pack = {"touch_center": [[40, 30]] * 7, "touch_radius": [9] * 7, "names": names, "imgs": np.zeros((7, 2, 2, 3))}
    np.savez(tmp_path / "dataPack.npz", **{key: np.array(value) for key, value in pack.items()})
    assert run("taxim", tmp_path) == 2
    told = capsys.readouterr().err
    assert all(f"--{name}" in told for name in ("pixel-pitch-um", "ball-radius-mm", "encoding"))
    options = ("--pixel-pitch-um", 29.5, "--ball-radius-mm", 2, "--encoding", "srgb")
    assert run("taxim", tmp_path, *options) == 0
    assert "1 listed image is not there and left out, such as frame_7.png" in capsys.readouterr().out
    found = loaded(tmp_path / "frameset.toml")
    assert [one.name for one in found.scans] == ["frame_1", "frame_6"]
    assert found.reference is not None
    assert found.presses[0].balls is not None
    assert found.presses[0].balls[0].contact_radius_px == 9.0
    np.savez(tmp_path / "dataPack.npz", names=np.array(names))
    assert run("taxim", tmp_path, *options) == 2
    assert "is no data pack of Taxim" in capsys.readouterr().err


def test_names_of_lights_are_as_many_as_an_images_channels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image(tmp_path / "one.png", grey=True)
    lights = "".join(f'[[light]]\nname = "{name}"\n' for name in "abc")
    scans = '[[scan]]\nname = "one"\nimage = "one.png"\n'
    (tmp_path / "set.toml").write_text(f'name = "x"\npixel_pitch_um = 1\nencoding = "linear"\n{lights}{scans}')
    with pytest.raises(FrameSetError, match="3 lights are described and a frame has 1 channel"):
        loaded(tmp_path / "set.toml", calibrates=False)


def test_scans_of_different_lights_are_not_mixed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan(tmp_path / "a", 6)
    scan(tmp_path / "b", 3)
    assert run("gelsight", tmp_path) == 2
    assert "a 6, b 3" in capsys.readouterr().err


def test_a_folder_of_gs_sdk_keeps_its_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image(tmp_path / "background.png")
    rows = ["experiment_reldir,diameter(mm)"]
    for number in range(6):
        image(tmp_path / "4.0mm" / str(number) / "gelsight.png", value=90 + number)
        np.savez(tmp_path / "4.0mm" / str(number) / "label.npz", center=np.array([30.0, 20.0]), radius=9)
        rows.append(f"4.0mm/{number},4.0")
    (tmp_path / "catalog.csv").write_text("\n".join(rows))
    assert run("gs_sdk", tmp_path) == 2
    told = capsys.readouterr().err
    assert "--pixel-pitch-um" in told
    assert "--encoding" in told
    assert run("gs_sdk", tmp_path, "--pixel-pitch-um", 60, "--encoding", "srgb") == 0
    found = loaded(tmp_path / "frameset.toml")
    assert (len(found.presses), len(found.scans)) == (6, 2)
    assert found.presses[0].ball_radius_mm == 2.0
    assert found.presses[0].balls is not None
    assert found.presses[0].balls[0].column == 30.0
    assert found.reference is not None


def test_a_label_that_is_no_label_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image(tmp_path / "0" / "gelsight.png")
    (tmp_path / "0" / "label.npz").write_bytes(b"nothing")
    (tmp_path / "catalog.csv").write_text("experiment_reldir,diameter(mm)\n0,4.0\n")
    assert run("gs_sdk", tmp_path, "--pixel-pitch-um", 60, "--encoding", "srgb") == 2
    assert "label.npz: is no label of gs_sdk" in capsys.readouterr().err


def test_a_folder_of_py3dcal_says_scale_and_radius(tmp_path: Path) -> None:
    image(tmp_path / "blank_images" / "blank.png")
    image(tmp_path / "probe_images" / "0_1.png")
    (tmp_path / "annotations").mkdir()
    (tmp_path / "annotations" / "annotations.csv").write_text("img_name,x_mm,y_mm,x_px,y_px\n0_1.png,1,1,30,20\n")
    (tmp_path / "annotations" / "metadata.json").write_text(json.dumps({"px_per_mm": 20.0, "probe_radius_mm": 2}))
    assert run("py3dcal", tmp_path, "--encoding", "srgb") == 0
    found = loaded(tmp_path / "frameset.toml")
    assert found.pixel_pitch_um == 50.0
    assert found.presses[0].ball_radius_mm == 2.0


def test_a_folder_of_images_is_read_by_its_names(tmp_path: Path) -> None:
    for number, name in enumerate(("background", "ball-1", "ball-2", "key")):
        image(tmp_path / f"{name}.png", value=90 + number)
    assert run("digit", tmp_path, "--pixel-pitch-um", 30, "--ball-radius-mm", 1, "--encoding", "srgb") == 0
    found = loaded(tmp_path / "frameset.toml")
    assert [press.frame.images[0].name for press in found.presses] == ["ball-1.png", "ball-2.png"]
    assert [one.name for one in found.scans] == ["ball-1", "ball-2", "key"]


@pytest.mark.parametrize("kind", ["digit", "images"])
def test_a_folder_that_holds_a_movie_only_says_how_it_becomes_images(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "recording.MP4").write_bytes(b"a movie")
    assert run(kind, tmp_path) == 2
    said = capsys.readouterr().err
    assert "recording.MP4: a movie does not say which frames are presses" in said
    assert "ffmpeg -i recording.MP4" in said


@pytest.mark.parametrize("kind", ["gelsight", "gs_sdk", "py3dcal", "taxim", "digit"])
def test_an_empty_folder_is_refused(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(kind, tmp_path, "--pixel-pitch-um", 30, "--encoding", "srgb") == 2
    assert capsys.readouterr().err.count("\n") <= 3


@pytest.mark.slow
@pytest.mark.skipif(not PUBLIC, reason="RETROGRAPH_PUBLIC does not name the folder of public repositories")
@pytest.mark.parametrize(
    ("kind", "folder", "options", "presses", "scans", "lights"),
    [
        ("gelsight", "gelsightinc+sdkdemo/testdata/OEMData", (), 4, 5, 6),
        (
            "gelsight",
            "gelsightinc+sdkdemo/testdata/FingerData",
            ("--ball-radius-mm", "1.5875", "--encoding", "linear"),
            2,
            3,
            0,
        ),
        ("gelsight", "gelsightinc+sdkdemo/testdata/HandheldData", (), 0, 1, 6),
        ("gelsight", "gelsightinc+gsmatlab/demo/groove", (), 0, 1, 6),
        ("gs_sdk", "skleff1994+gs_sdk/calibration/data", ("--pixel-pitch-um", "63.4", "--encoding", "srgb"), 51, 11, 0),
    ],
)
def test_public_folders_are_imported(
    kind: str, folder: str, options: tuple[str, ...], presses: int, scans: int, lights: int, tmp_path: Path
) -> None:
    bare = [path.parent for path in (Path(PUBLIC) / folder).rglob("scan.yaml") if not any(path.parent.glob("*.png"))]
    if bare:
        pytest.skip(f"{bare[0]} holds no images: fetch the repository whole")
    assert run(kind, Path(PUBLIC) / folder, *options, "--out", tmp_path / "set.toml") == 0
    found = loaded(tmp_path / "set.toml", calibrates=presses > 0)
    assert (len(found.presses), len(found.scans), len(found.lights)) == (presses, scans, lights)


@pytest.mark.parametrize(
    ("table", "encoding"),
    [
        ("experiment_reldir,diameter(mm)\r\n1.920mm\\0,1.920\r\n", "utf-8"),
        ("experiment_reldir;diameter(mm)\r\n1.920mm\\0;1,920\r\n", "utf-8-sig"),
        ("experiment_reldir\tdiameter(mm)\r\n1.920MM\\0\t1,920\r\n", "utf-16"),
        ("experiment_reldir; diameter(mm); remark\r\n1.920mm/0; 1,920; größer\r\n", "cp1252"),
        ("sep=;\r\nExperiment_RelDir;Diameter(mm)\r\n1.920mm\\0;1,92 mm\r\n;\r\n", "utf-8"),
        ("experiment_reldir,diameter(mm)\r\nC:\\Users\\jo\\set\\1.920mm\\0,1.92mm\r\n", "utf-8"),
    ],
)
def test_a_catalogue_made_on_windows_is_read(tmp_path: Path, table: str, encoding: str) -> None:
    image(tmp_path / "set" / "1.920mm" / "0" / "gelsight.png")
    image(tmp_path / "set" / "background.png")
    (tmp_path / "set" / "catalog.csv").write_bytes(table.encode(encoding))
    out = tmp_path / "set.toml"
    assert run("gs_sdk", tmp_path / "set", "--pixel-pitch-um", 10, "--encoding", "srgb", "--out", out) == 0
    (press,) = loaded(out).presses
    assert press.ball_radius_mm == pytest.approx(0.96)


def test_a_catalogue_without_its_columns_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image(tmp_path / "1.920mm" / "0" / "gelsight.png")
    (tmp_path / "catalog.csv").write_text("1.920mm/0,1.92\n")
    assert run("gs_sdk", tmp_path, "--pixel-pitch-um", 10, "--encoding", "srgb") == 2
    assert "catalog.csv: has no column experiment_reldir, diameter(mm): correct its" in capsys.readouterr().err
