"""The files for a board house, read by others: gerbonara for Gerber and drills, KiCad's own design rule check."""

import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from tests.drawings.pcb.designs import carrier, light
from tests.drawings.pcb.fabrication import files
from tests.drawings.pcb.kicad import JUDGE, kicad_board
from tests.drawings.pcb.layout import LAYERS, Board

BOARDS = [carrier(), light()]
PYTHONS = ("/usr/bin/python3", "/usr/local/bin/python3")


def python_with_kicad() -> str | None:
    for python in PYTHONS:
        if (
            Path(python).exists()
            and not subprocess.run([python, "-c", "import pcbnew"], capture_output=True, check=False).returncode
        ):
            return python
    return None


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.name)
def test_gerber_and_drills_read_back_are_the_board(board: Board, tmp_path: Path) -> None:
    gerbonara = pytest.importorskip("gerbonara", reason="gerbonara is not installed: make board-test")
    for name, text in files(board).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    for layer in LAYERS:
        read = gerbonara.GerberFile.open(tmp_path / f"{board.name}-{layer}.gbr")
        flashed = Counter((round(one.x, 4), round(one.y, 4)) for one in read.objects if type(one).__name__ == "Flash")
        pads = [pad.at for _, pad in board.pads() if layer in pad.layers] + [via.at for via in board.vias]
        assert flashed == Counter((round(x, 4), round(y, 4)) for x, y in pads)
        drawn = Counter(
            (round(one.x1, 4), round(one.y1, 4), round(one.x2, 4), round(one.y2, 4), round(one.aperture.diameter, 3))
            for one in read.objects
            if type(one).__name__ == "Line"
        )
        tracks = [track for track in board.tracks if track.layer == layer]
        assert drawn == Counter(
            (*(round(one, 4) for one in (*track.start, *track.end)), round(track.width, 3)) for track in tracks
        )
    for kind, holes in (
        (
            "plated",
            [(pad.drill, pad.at) for _, pad in board.pads() if pad.drill] + [(v.drill, v.at) for v in board.vias],
        ),
        ("unplated", [(hole.drill, hole.at) for hole in board.holes]),
    ):
        bored = gerbonara.ExcellonFile.open(tmp_path / f"{board.name}-{kind}.drl")
        assert Counter(
            (round(one.tool.diameter, 3), round(one.x, 3), round(one.y, 3)) for one in bored.objects
        ) == Counter((round(size, 3), round(x, 3), round(y, 3)) for size, (x, y) in holes)


def judged(text: str, folder: Path) -> str:
    python = python_with_kicad()
    if python is None:
        pytest.skip("KiCad's Python module is not installed (Debian: apt install kicad)")
    (folder / "board.kicad_pcb").write_text(text, encoding="utf-8")
    ran = subprocess.run(
        [python, "-c", JUDGE, folder / "board.kicad_pcb", folder / "report"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return (folder / "report").read_text(encoding="utf-8")


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.name)
def test_kicad_finds_nothing_to_complain_of(board: Board, tmp_path: Path) -> None:
    report = judged(kicad_board(board), tmp_path)
    assert re.findall(r"Found (\d+)", report) == ["0", "0", "0"], report


def test_kicad_would_have_found_it(tmp_path: Path) -> None:
    lines = kicad_board(BOARDS[1]).splitlines()
    tracks = [line for line in lines if line.startswith("(segment")]
    assert "unconnected" in judged("\n".join(line for line in lines if line != tracks[-1]), tmp_path)
    nearer = "\n".join(lines).replace("(width 0.4)", "(width 2.4)")
    assert "Severity: error" in judged(nearer, tmp_path)
