"""`retrosync export RESULT`: whole files or none, nothing replaced unasked, hostile names, a sentence on bad input."""

from __future__ import annotations

import json
import re
import resource
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from device.bundles.scan import ScanBundle
from device.store.store import BundleStore
from device.surface import Float32Array
from host_sync.cli.export import ExportFormat
from host_sync.cli.main import main
from host_sync.export.surface_export import FORMATS, file_stem

SURFACE_FORMATS = [form for form in get_args(ExportFormat) if form != "dng"]


def export(source: Path | str, out: Path, *options: str) -> int:
    return main(["export", str(source), "--out", str(out), "--to", *options])


def test_all_formats_at_once_are_named_after_the_result(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert export(result, out, *SURFACE_FORMATS) == 0
    suffixes = {"tif" if form == "tiff" else form for form in SURFACE_FORMATS} | {"png.json"}
    assert {path.name for path in out.iterdir()} == {f"part-7.{suffix}" for suffix in suffixes}
    assert len(capsys.readouterr().out.splitlines()) == len(suffixes)


def test_the_same_surface_gives_the_same_bytes(result: Path, tmp_path: Path) -> None:
    for out in ("a", "b"):
        assert export(result, tmp_path / out, *(form for form in SURFACE_FORMATS if form != "npz")) == 0
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


def test_nothing_is_replaced_unasked_and_nothing_written_beside_it(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "part-7.ply").write_text("mine")
    assert export(result, out, "gsf", "ply") == 2
    said = capsys.readouterr().err
    assert "part-7.ply" in said
    assert "--overwrite" in said
    assert [path.name for path in out.iterdir()] == ["part-7.ply"]
    assert (out / "part-7.ply").read_text() == "mine"
    assert export(result, out, "gsf", "ply", "--overwrite") == 0
    assert (out / "part-7.ply").read_bytes().startswith(b"ply\n")


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("../../etc/passwd", "_.._etc_passwd"),
        ("..", "height"),
        ("", "height"),
        (".hidden", "hidden"),
        ("a\0b\nc\x1b[31m", "a_b_c__31m"),
        ("C:\\x|y?*<>\"'", "C__x_y______"),
        ("nul.txt", "_nul.txt"),
        ("--to", "_--to"),
        ("Nähmaschine 7", "Nähmaschine 7"),
        ("ä" * 300, "ä" * 60),
    ],
)
def test_hostile_names_stay_in_the_folder(name: str, stem: str) -> None:
    assert file_stem(name) == stem


HOSTILE = '../x"\n<Comment>&amp;\r\nXRes = 9\0 ' + "\u202e\ud7ff µ" + "%s{0}" * 60


def test_hostile_names_do_not_change_what_the_files_say(
    write_result: Callable[..., Path], z_um: Float32Array, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    folder = write_result(z_um, None, name=HOSTILE, warnings=[HOSTILE], program=HOSTILE)
    assert export(folder, out, *SURFACE_FORMATS) == 0
    held = {path.suffix: path for path in out.iterdir()}
    assert {path.parent for path in tmp_path.rglob("*.gsf")} == {out}
    header = held[".gsf"].read_bytes().split(b"\0")[0].decode().splitlines()
    assert [line for line in header if line.startswith("XRes")] == ["XRes = 53"]
    with zipfile.ZipFile(held[".x3p"]) as archive:
        root = ET.fromstring(archive.read("main.xml"))  # noqa: S314
    assert len(root.findall(".//Comment")) == 1
    assert root.findtext("Record3/MatrixDimension/SizeX") == "53"
    glb = held[".glb"].read_bytes()
    assert json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])["nodes"][0]["mesh"] == 0
    ply = held[".ply"].read_bytes().split(b"end_header")[0].splitlines()
    assert ply[3] == b"comment unit mm"


def test_hostile_names_open_in_gwyddion(
    write_result: Callable[..., Path], z_um: Float32Array, tmp_path: Path, gwyddion: Callable[[Path], dict]
) -> None:
    out = tmp_path / "out"
    folder = write_result(z_um, None, name=HOSTILE, warnings=[HOSTILE])
    assert export(folder, out, "gsf", "gwy", "x3p", "sur", "sdf", "al3d", "png", "tiff") == 0
    for path in out.iterdir():
        if path.suffix not in {".json", ".txt"}:
            assert gwyddion(path)[0]["values"].shape == z_um.shape, path.suffix


def damage(folder: Path, how: str) -> None:
    record = folder / "result.json"
    said = json.loads(record.read_text())
    height = folder / "height_um.tif"
    match how:
        case "no record":
            record.unlink()
        case "no JSON":
            record.write_bytes(b"\xff{")
        case "another version":
            record.write_text(json.dumps(said | {"schema": "retrograph.result/9"}))
        case "pitch":
            record.write_text(json.dumps(said | {"pixel_pitch_um": -1.0}))
        case "another size":
            record.write_text(json.dumps(said | {"rows": 36}))
        case "no height":
            height.unlink()
        case "short height":
            height.write_bytes(height.read_bytes()[:900])
        case "uncertainty":
            (folder / "height_sigma_um.tif").write_bytes(b"II*\0")


@pytest.mark.parametrize(
    "how",
    ["no record", "no JSON", "another version", "pitch", "another size", "no height", "short height", "uncertainty"],
)
def test_a_damaged_result_is_one_sentence_and_no_file(
    how: str, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(result, how)
    assert export(result, tmp_path / "out", "gsf") == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(result) in said
    assert not (tmp_path / "out").exists()


def test_a_surface_without_a_valid_height_is_refused(
    write_result: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(write_result(np.full((4, 5), np.nan, np.float32)), tmp_path / "out", "png") == 2
    assert "no height is valid" in capsys.readouterr().err


def test_infinity_is_invalid_too(write_result: Callable[..., Path], z_um: Float32Array, tmp_path: Path) -> None:
    z_um[30, 5] = np.inf
    assert export(write_result(z_um), tmp_path / "out", *SURFACE_FORMATS) == 0
    with np.load(tmp_path / "out" / "part-7.npz") as held:
        assert np.isnan(held["z_um"][30, 5])


def test_a_flat_surface_survives_every_format(write_result: Callable[..., Path], tmp_path: Path) -> None:
    assert export(write_result(np.zeros((9, 9), np.float32)), tmp_path / "out", *SURFACE_FORMATS) == 0


def test_what_a_format_cannot_count_leaves_no_file(
    write_result: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(write_result(np.ones((2, 66_000), np.float32)), tmp_path / "out", "sdf") == 2
    assert "use x3p" in capsys.readouterr().err
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("form", SURFACE_FORMATS)
def test_a_disk_that_takes_no_more_leaves_no_file(
    form: str, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (700, hard))
    try:
        code = export(result, tmp_path / "out", form)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 2
    said = capsys.readouterr().err
    assert "cannot be written (" in said
    assert said.count("\n") == 1
    assert list((tmp_path / "out").iterdir()) == []


def test_a_place_in_the_way_is_named(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert export(result, tmp_path / "file", "x3p") == 2
    assert "name a folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line", [("0", "0", "99999", "0"), ("-50", "0", "100", "0"), ("5", "5", "6", "5"), ("nan",) * 4]
)
def test_a_line_off_the_field_is_refused(
    line: tuple[str, ...], result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(result, tmp_path / "out", "gsf", "csv", "--line-um", *line) == 2
    assert "line" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_surface_has_no_raw_frame_and_an_unreconstructed_scan_no_surface(
    result: Path,
    store: BundleStore,
    publish_scan: Callable[..., ScanBundle],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert export(result, tmp_path / "out", "dng") == 2
    assert "raw frame" in capsys.readouterr().err
    scan = publish_scan(store)
    assert export(scan.scan_id, tmp_path / "out", "gsf", "--library", str(store.root)) == 2
    assert "reconstruct" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_two_sources_of_one_name_do_not_replace_one_another(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    twin = tmp_path / "twin" / "result"
    shutil.copytree(result, twin)
    out = tmp_path / "out"
    for choice in ([], ["--overwrite"]):
        assert main(["export", str(result), str(twin), "--to", "npz", "tmd", "--out", str(out), *choice]) == 1
        said = capsys.readouterr()
        assert f"{twin}: {out / 'part-7.npz'}: is already the file of another source" in said.err
        assert sorted(path.name for path in out.iterdir() if path.suffix in (".npz", ".tmd")) == [
            "part-7.npz",
            "part-7.tmd",
        ]


def test_a_scans_newest_result_is_exported(
    result: Path,
    store: BundleStore,
    publish_scan: Callable[..., ScanBundle],
    tmp_path: Path,
    z_um: Float32Array,
) -> None:
    scan = publish_scan(store)
    results = scan.directory / "results"
    results.mkdir()
    result.rename(results / "0.1.0-cal-1")
    assert export(scan.scan_id, tmp_path / "out", "npz", "--library", str(store.root)) == 0
    with np.load(tmp_path / "out" / "part-7.npz") as held:
        assert np.array_equal(held["z_um"], z_um, equal_nan=True)


def test_a_format_that_cannot_hold_a_long_field_leaves_the_others_and_can_be_tried_again(
    write_result: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = write_result(np.zeros((3, 70_000), np.float32))
    monkeypatch.setattr("host_sync.export.surface_formats.LARGEST", 1000)
    out = tmp_path / "out"
    forms = ("gwy", "gsf", "sdf", "x3p", "sur", "al3d", "tmd", "tiff", "png", "npz", "csv", "ply")
    assert export(folder, out, *forms) == 1
    said = capsys.readouterr()
    assert [line.split(": ")[1] for line in said.err.splitlines()] == ["gwy", "sdf"]
    assert len(said.out.splitlines()) == len(list(out.iterdir())) == len(forms) - 2 + 1
    monkeypatch.undo()
    assert export(folder, out, "gwy") == 0
    assert export(folder, out, "sdf") == 2
    assert "retrosync: part-7: SDF ends at 65535" in capsys.readouterr().err


def test_a_file_too_large_for_the_disk_leaves_the_others(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, hard))
    try:
        code = export(result, tmp_path / "out", "obj", "csv", "npz", "png")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    said = capsys.readouterr()
    assert code == 1
    written = [Path(line).name for line in said.out.splitlines()]
    assert "part-7.csv" in written
    assert sorted(written) == sorted(path.name for path in (tmp_path / "out").iterdir())
    assert "retrosync: obj: " in said.err
    assert "cannot be written (" in said.err


def test_a_raw_frame_is_written_where_a_scan_has_no_result(
    store: BundleStore,
    publish_scan: Callable[..., ScanBundle],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scan = publish_scan(store)
    out = tmp_path / "out"
    assert export(scan.scan_id, out, "gsf", "dng", "stl", "--library", str(store.root)) == 1
    said = capsys.readouterr()
    assert [path.suffix for path in out.iterdir()] == [".dng"]
    assert said.err.startswith("retrosync: gsf, stl: ")
    assert "reconstruct" in said.err


def test_the_help_names_every_format_and_those_of_one_layer(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "--help"]) == 0
    words = " ".join(re.findall(r"[^\s│]+", capsys.readouterr().out))
    choices, of_sigma = (
        words.partition("[choices: ")[2],
        words.partition("for formats that hold one surface a file: ")[2],
    )
    assert set(FORMATS) <= set(re.findall(r"\w+", choices.partition("]")[0]))
    assert set(of_sigma.partition(".")[0].split()) == {name for name, form in FORMATS.items() if form.one_layer}
