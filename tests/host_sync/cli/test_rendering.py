import signal
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import tifffile
from limits import running
from PIL import Image

from host_sync.cli.main import main
from host_sync.render.relief_sheet import STRIP_ROWS
from host_sync.results.field_file import write_field


def result(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True)
    row, column = np.mgrid[:60, :80].astype(np.float32)
    write_field(folder / "height_um.tif", 5.0 * np.sin(row / 5.0) * np.cos(column / 7.0), 10.0, "height, um")
    record = {"schema": "retrograph.result/1", "name": name, "rows": 60, "columns": 80, "pixel_pitch_um": 10.0}
    (folder / "result.json").write_bytes(msgspec.json.encode(record))
    return folder


def test_one_result_becomes_one_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "one.png"
    arguments = ["render", str(result(tmp_path / "r", "one")), "--out", str(out), "--width", "120"]
    assert main([*arguments, "--azimuth", "300", "--elevation", "35", "--shadow", "--occlusion"]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    assert cv2.imread(str(out)).shape[1] == 120
    assert [path.name for path in out.parent.iterdir()] == ["one.png"]


def test_a_field_of_view_from_straight_above_is_in_perspective(tmp_path: Path) -> None:
    folder = result(tmp_path / "r", "one")
    pictures = []
    for field in ("0", "60"):
        out = tmp_path / f"{field}.png"
        assert main(["render", str(folder), "--out", str(out), "--width", "200", "--field", field]) == 0
        pictures.append(cv2.imread(str(out)))
    assert (pictures[0] == 255).all(axis=2).mean() < 0.01  # orthographic: the surface fills the picture
    assert 0.02 < (pictures[1] == 255).all(axis=2).mean() < 0.3  # what is nearer is larger: with a margin


def test_several_become_a_folder_whose_names_are_safe(tmp_path: Path) -> None:
    for number, name in enumerate(("../../evil", "../../evil", "a/b\x00c", "…")):
        result(tmp_path / "results" / str(number), name)
    out = tmp_path / "pictures"
    assert main(["render", str(tmp_path / "results"), "--out", str(out), "--width", "60"]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["a-b-c.png", "evil-2.png", "evil.png", "relief.png"]


def test_a_contact_sheet_and_a_turntable(tmp_path: Path) -> None:
    folder = result(tmp_path / "results" / "a", "a").parent
    result(tmp_path / "results" / "b", "b")
    sheet, film = tmp_path / "sheet.png", tmp_path / "turn.mp4"
    assert main(["render", str(folder), "--out", str(sheet), "--contact-sheet"]) == 0
    drawn = cv2.imread(str(sheet))
    assert drawn.shape[1] > 800
    assert len(np.unique(drawn[-STRIP_ROWS + 12, 50:600], axis=0)) > 100  # the colour bar of both
    command = ["render", str(folder / "a"), "--out", str(film), "--turntable", "--frames", "5", "--width", "160"]
    assert main(command) == 0
    movie = cv2.VideoCapture(str(film))
    assert movie.get(cv2.CAP_PROP_FRAME_COUNT) == 5
    movie.release()
    loop = tmp_path / "turn.webp"
    command[3] = str(loop)
    assert main(command) == 0
    with Image.open(loop) as shown:
        assert shown.is_animated
        assert shown.info["loop"] == 0


def test_a_contact_sheet_has_one_range_of_colours(tmp_path: Path) -> None:
    for name, factor in (("a", 1.0), ("b", 1.0)):
        folder = result(tmp_path / "results" / name, name)
        if name == "b":
            z_um = tifffile.imread(folder / "height_um.tif")
            tifffile.imwrite(folder / "height_um.tif", (0.01 * factor * z_um).astype(np.float32))
    sheets = []
    for number, more in enumerate(([], ["--range-um", "0", "1000"])):
        out = tmp_path / f"{number}.png"
        assert main(["render", str(tmp_path / "results"), "--out", str(out), "--contact-sheet", *more]) == 0
        sheets.append(cv2.imread(str(out))[:-STRIP_ROWS].astype(float))
    flat = sheets[0][60:300, 500:800]
    assert flat.std(axis=(0, 1)).max() < sheets[0][60:300, 60:360].std(axis=(0, 1)).max()
    assert np.abs(sheets[0] - sheets[1]).max() > 20.0
    assert main(["render", str(tmp_path / "results" / "a"), "--out", str(out), "--range-um", "2", "1"]) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "x.png"], "name a result"),
        (["{empty}", "--out", "x.png"], "neither scans nor results"),
        (["{nowhere}", "--out", "x.png"], "no such folder"),
        (["{result}", "--out", "{tmp}/x.doc"], "not a picture format"),
        (["{result}", "--out", "{tmp}/x.png", "--turntable"], ".mp4, .gif or .webp"),
        (["{result}", "--out", "{tmp}/x.png", "--width", "3"], "px wide"),
        (
            ["{result}", "--out", "{tmp}/x.png", "--contact-sheet", "--turntable"],
            "either --contact-sheet or --turntable",
        ),
        (["{result}", "--out", "{tmp}/x.png", "--field", "400"], "a field of at most 120"),
        (["{result}", "--out", "{tmp}/x.png", "--field", "nan"], "a field of at most 120"),
        (["{result}", "--out", "/dev/null/x.png", "--width", "60"], "choose another place"),
    ],
)
def test_what_cannot_be_drawn_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"empty": tmp_path / "empty", "nowhere": tmp_path / "no", "tmp": tmp_path}
    places["result"] = result(tmp_path / "r", "r")
    before = sorted(tmp_path.rglob("*"))
    assert main(["render", *(argument.format(**places) for argument in arguments)]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{nowhere}"], "no such folder"),
        (["{empty}"], "neither scans nor results"),
        (["{result}", "--port", "99999999"], "choose another --port"),
        (["{result}", "--host", "203.0.113.7"], "choose another --port or --host"),
    ],
)
def test_a_viewer_that_cannot_open_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"empty": tmp_path / "empty", "nowhere": tmp_path / "no", "result": result(tmp_path / "r", "r")}
    assert main(["view", "--no-browser", *(argument.format(**places) for argument in arguments)]) == 2
    assert words in capsys.readouterr().err


def test_the_viewer_ends_with_an_interrupt(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "host_sync", "view", str(result(tmp_path / "r", "r")), "--no-browser"]
    with running([*command, "--cache", str(tmp_path / "c")], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        try:
            assert run.stdout is not None
            host = run.stdout.readline().decode().split("/")[2]
            name, _, port = host.rpartition(":")
            assert name.endswith(".localhost")
            asked = urllib.request.Request(f"http://127.0.0.1:{port}/", headers={"Host": host})
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(asked)  # noqa: S310
            run.send_signal(signal.SIGINT)
            _, said = run.communicate(timeout=60)
        finally:
            run.kill()
    assert (run.returncode, said) == (0, b"")
