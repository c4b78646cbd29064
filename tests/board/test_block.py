"""The drawing of the block shows the body that the housing's source makes, with tolerances that focus and fit allow."""

import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hal.board_profile import load_board_profile
from tests.drawings.board.aperture import BOARDS, blur
from tests.drawings.board.block import HEIGHT_TOLERANCE_MM, RADIUS_TOLERANCE_MM, SOURCE, Block, block_drawing

DRAWING = SOURCE.parent / "block.svg"


def parameter(name: str) -> float:
    found = re.search(rf"^{name} = ([-\d.]+);", SOURCE.read_text(encoding="utf-8"), re.MULTILINE)
    assert found, name
    return float(found[1])


@pytest.mark.skipif(shutil.which("openscad") is None, reason="openscad is not installed")
def test_the_body_has_the_dimensions_of_the_drawing(tmp_path: Path) -> None:
    out, block = tmp_path / "block.stl", Block.of_source()
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "QT_QPA_PLATFORM": "offscreen"}
    command = ["openscad", "-q", "-D", 'part="block"', "-o", out, SOURCE]
    subprocess.run(command, check=True, env=environment)
    corners = np.array(re.findall(r"vertex (\S+) (\S+) (\S+)", out.read_text(encoding="utf-8")), np.float64)
    low, high = corners[:, 2].min(), corners[:, 2].max()
    assert (low, high - low) == (pytest.approx(block.skin), pytest.approx(block.height))
    assert np.hypot(corners[:, 0], corners[:, 1]).max() == pytest.approx(block.radius, abs=0.01)
    for azimuth in np.radians(block.azimuths_deg):
        out_mm = corners[:, 0] * math.cos(azimuth) + corners[:, 1] * math.sin(azimuth)
        assert out_mm[np.isclose(corners[:, 2], low)].max() == pytest.approx(block.lower, abs=0.01)
        assert out_mm[np.isclose(corners[:, 2], high)].max() == pytest.approx(block.upper, abs=0.01)
    lean_deg = math.degrees(math.atan2(block.lower - block.upper, block.height))
    assert lean_deg == pytest.approx(block.lean_deg, abs=0.01)


def test_the_drawing_states_every_dimension() -> None:
    block, words = Block.of_source(), block_drawing()
    for stated in (f"{2 * block.radius:.1f}", f"{block.height:.1f} ±", f"{block.upper:.2f} ±", f"{block.lower:.2f} ±"):
        assert stated in words
    assert f"{block.lean_deg:.1f}° ±" in words
    assert DRAWING.read_text(encoding="utf-8") == words


@pytest.mark.parametrize("board", BOARDS)
def test_the_tolerances_keep_the_skin_in_focus_and_the_block_in_its_seat(board: str) -> None:
    profile = load_board_profile(board)
    assert profile.lens is not None
    moved_mm = HEIGHT_TOLERANCE_MM * (1.0 - 1.0 / parameter("n_block"))
    assert moved_mm < 0.25 * blur(board, profile.lens.f_number).depth_mm
    assert 0.0 < RADIUS_TOLERANCE_MM <= 0.5 * parameter("gap")
