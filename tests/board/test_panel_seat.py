"""The panel's seat: its frame takes the display, stands over the camera plate's screws, and is in nobody's way."""

import math
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hal.board_profile import load_board_profile
from tests.drawings.board.totals import panel_euros, seated_panel
from tests.drawings.board.weights import PANEL_G, PETG_G_CM3, handheld_g

ENCLOSURE = Path(__file__).parents[2] / "board" / "enclosure"
SOURCE = ENCLOSURE / "retrograph.scad"
WORDS = SOURCE.read_text(encoding="utf-8") + (ENCLOSURE / "panel.scad").read_text(encoding="utf-8")
BILL = (ENCLOSURE.parent / "bill-of-materials.md").read_text(encoding="utf-8")

TOUCH_DISPLAY_MM = (192.96, 110.76)
VIEWABLE_MM = (154.08, 85.92)
"""Raspberry Pi's documentation of its first Touch Display: outer dimensions and viewable area."""
CAMERA_BOARD_MM = 38.0
PI_MM = (85.0, 56.0)
M3_HEAD_MM = 5.5
SMALLEST_WALL_MM = 1.2
"""Three lines of a nozzle of 0.4 mm."""
PRINT_BED_MM = 210.0

needs_openscad = pytest.mark.skipif(shutil.which("openscad") is None, reason="openscad is not installed")


def numbers(name: str) -> tuple[float, ...]:
    found = re.search(rf"^{name} = \[?([-\d., ]+)\]?;", WORDS, re.MULTILINE)
    assert found, name
    return tuple(float(word) for word in found[1].split(","))


def number(name: str) -> float:
    (one,) = numbers(name)
    return one


@dataclass(frozen=True)
class Seat:
    """What follows from the sources' lengths, mm, from the body's axis; x towards the tray."""

    post_at: float
    pocket: tuple[float, float]
    outer: tuple[float, float]
    middle: float
    height: float
    tray_face: float

    @property
    def bossed_edge(self) -> float:
        """The frame's edge towards the tray, at what its clips are screwed to."""
        return self.middle + self.outer[0] / 2 + number("panel_boss")


def seat() -> Seat:
    wall, outer_r = number("wall"), number("inner_r") + number("wall")
    pocket = tuple(side + 2 * number("panel_gap") for side in reversed(numbers("panel")))
    outer = tuple(side + 2 * wall for side in pocket)
    tray_face = outer_r + 8
    return Seat(
        post_at=(outer_r + 2) * math.sqrt(0.5),
        pocket=(pocket[0], pocket[1]),
        outer=(outer[0], outer[1]),
        middle=tray_face - 1.5 - number("panel_boss") - outer[0] / 2,
        height=number("panel_floor") + number("screw_head") + number("panel_back") + number("panel_edge"),
        tray_face=tray_face,
    )


def frame_from_mm(board: str) -> float:
    """The frame's lower face above the skin."""
    stated = re.search(rf'\["{board}", ([\d.]+), ([\d.]+),', WORDS)
    assert stated
    focal, magnification = number("focal"), float(stated[1]) / float(stated[2])
    gel, top = number("gel_thickness"), number("block_top")
    nearer = (top - gel) * (1 - 1 / number("n_block")) + gel * (1 - 1 / number("n_gel"))
    sensor = focal * (2 + magnification + 1 / magnification) + nearer + number("hiatus")
    return sensor + number("sensor_over_board") + number("panel_posts")


def made(part: str, out: Path, *definitions: str) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(out.parent), "QT_QPA_PLATFORM": "offscreen"}
    chosen = [word for definition in (f'part="{part}"', *definitions) for word in ("-D", definition)]
    command = ["openscad", *chosen, "-o", out, SOURCE]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def test_the_display_of_the_maker_lies_in_it_and_shows_all_that_it_shows() -> None:
    assert numbers("panel") == TOUCH_DISPLAY_MM
    assert numbers("panel_view") == VIEWABLE_MM
    long_rim, short_rim = ((whole - seen) / 2 for whole, seen in zip(TOUCH_DISPLAY_MM, VIEWABLE_MM, strict=True))
    assert 0.3 <= number("panel_gap") <= 1.0
    # Held by its rim, above and below; what shows may stand off the middle by 2 mm.
    at_short_sides, at_long_sides = numbers("panel_ledge")
    assert 2.0 <= at_short_sides < long_rim - 2.0
    assert 2.0 <= at_long_sides < short_rim - 2.0
    # A panel that is pushed to one side is still on its ledge.
    assert 2 * number("panel_gap") < at_long_sides
    assert 2 * number("panel_gap") < number("panel_clip_over") < short_rim - 2.0


def test_its_posts_stand_over_the_screws_of_the_camera_plate_and_beside_its_board() -> None:
    built = seat()
    assert "rotate(a + 45) translate([outer_r + 2, 0, -1]) cylinder(r = m3 / 2, h = plate_height + 2)" in WORDS
    assert "for (x = [-1, 1], y = [-1, 1]) translate([x * post_at, y * post_at, body_top + plate_height])" in WORDS
    board_corner = CAMERA_BOARD_MM / 2
    post_r = number("panel_post") / 2
    assert math.hypot(built.post_at - board_corner, built.post_at - board_corner) > post_r + 1.0
    # The screw reaches into the body and not down to the bottom of its thread.
    in_thread = number("panel_screw") - number("panel_floor") - number("panel_posts") - number("plate_height")
    assert 6.0 <= in_thread < number("plate_thread")
    # Its head goes down past wall and ledge.
    free = built.middle + built.pocket[0] / 2 - number("panel_gap") - numbers("panel_ledge")[1]
    assert built.post_at + M3_HEAD_MM / 2 < free
    assert number("screw_head") > 3.0


def test_it_can_be_printed() -> None:
    built = seat()
    assert max(built.outer[0] + 2 * number("panel_boss"), built.outer[1]) <= PRINT_BED_MM
    assert number("wall") >= SMALLEST_WALL_MM
    assert (number("panel_post") - number("m3")) / 2 >= SMALLEST_WALL_MM
    assert number("panel_boss") - 2.5 - number("m3_tapped") / 2 >= SMALLEST_WALL_MM
    assert 6.0 - number("m3") / 2 >= SMALLEST_WALL_MM
    # The ledge's slope of 45 degrees ends above the bars.
    assert max(numbers("panel_ledge")) + number("panel_gap") < built.height - number("panel_edge")


@pytest.mark.parametrize("board", ["pi5-imx296", "pi4-imx477"])
def test_tray_sockets_ribbon_and_button_stay_free(board: str) -> None:
    built, lower = seat(), frame_from_mm(board)
    assert lower > number("tray_from") + number("tray_length") + 3.0
    assert built.bossed_edge < built.tray_face
    # A Pi's sockets stand on the tray's far side and look up: what is plugged in passes the frame.
    assert built.middle + built.outer[0] / 2 + 5.0 < built.tray_face + number("boss_height")
    assert number("panel_clips_at") - numbers("panel_clip")[0] / 2 > PI_MM[1] / 2
    assert number("panel_posts") >= 15.0
    assert lower - number("button_z") > 80.0, "a hand"
    strap_to = number("strap_at") + numbers("saddle_size")[0] / 2
    assert lower > strap_to + 20.0


@pytest.mark.parametrize("board", ["pi5-imx296", "pi4-imx477"])
def test_it_does_not_topple_on_its_nose(board: str) -> None:
    """With the UPS on the saddle, on the panel's side, and at worst nothing on the tray but the Pi."""
    assert load_board_profile(board).name == board
    whole = handheld_g(board)
    assert whole is not None
    saddle_and_ups, pi_on_tray = 186.0, 46.0 + 28.0
    moment = PANEL_G * seat().middle - saddle_and_ups * 58.0 + pi_on_tray * 48.0
    assert abs(moment / (whole + PANEL_G)) < 0.75 * (number("inner_r") + number("wall"))


def test_the_bill_lists_what_it_is_held_by() -> None:
    assert f"any M3 × {number('panel_screw'):.0f}" in BILL
    for row in ("panel", "panel seat", "screws of the seat (4)", "foam tape"):
        assert row in seated_panel(BILL)
    least, most = panel_euros(BILL)
    assert f"a panel and its seat add {least} to {most} € and about {round(PANEL_G, -1):.0f} g" in BILL


@needs_openscad
def test_the_parts_have_the_lengths_and_the_weight_of_their_source(tmp_path: Path) -> None:
    built, volume_mm3 = seat(), 0.0
    for part, pieces in (("panel_frame", 1), ("panel_post", 4), ("panel_clip", 4)):
        out = tmp_path / f"{part}.stl"
        ran = made(part, out)
        assert ran.returncode == 0, ran.stderr
        assert "WARNING" not in ran.stderr
        mesh = trimesh.load_mesh(out)
        assert mesh.is_watertight
        assert mesh.body_count == 1
        volume_mm3 += pieces * float(mesh.volume)
        if part == "panel_frame":
            frame = mesh
    low, high = frame.bounds
    assert high - low == pytest.approx(
        (built.outer[0] + 2 * number("panel_boss"), built.outer[1], built.height), abs=0.01
    )
    assert high[0] == pytest.approx(built.bossed_edge, abs=0.01)
    corners = np.asarray(frame.vertices)
    resting = corners[np.isclose(corners[:, 2], built.height - number("panel_edge"), atol=0.01)]
    opening = resting[:, 1][resting[:, 1] > 0.0].min() * 2
    assert opening == pytest.approx(numbers("panel")[0] - 2 * numbers("panel_ledge")[0], abs=0.05)
    printed_g = volume_mm3 * 1e-3 * PETG_G_CM3
    bought = re.search(r"^\| panel seat \| any black PETG or PLA, matt, (\d+) g \|", BILL, re.MULTILINE)
    assert bought
    assert 0.9 * float(bought[1]) < printed_g <= float(bought[1])


@needs_openscad
def test_it_shares_no_room_with_another_part_or_a_plug(tmp_path: Path) -> None:
    ran = made("panel_overlap", tmp_path / "part.stl", "$fn=8")
    assert "Current top level object is empty" in ran.stderr


@needs_openscad
@pytest.mark.parametrize("wrong", ["panel_x=0", "saddle_size=[220,64]"])
def test_what_shares_room_is_found(wrong: str, tmp_path: Path) -> None:
    ran = made("panel_overlap", tmp_path / "part.stl", "$fn=8", wrong)
    assert ran.returncode == 0, ran.stderr
    assert "Current top level object is empty" not in ran.stderr


@needs_openscad
@pytest.mark.parametrize(
    ("definition", "sentence"),
    [
        ("panel_screw=30", "take longer ones"),
        ("panel_posts=20", "take shorter ones"),
        ("panel_posts=10; panel_screw=25", "the camera's ribbon has no room"),
        ("tray_length=160", "the panel's frame lies on the tray's end"),
        ("panel_x=-30", "a post stands below the panel frame's wall"),
        ("panel_ledge=[8, 4]", "the ledge hides a post's screw"),
        ("panel_ledge=[18, 2]", "the ledge reaches below what the panel shows"),
        ("panel_clip_over=12", "the clips hide what the panel shows"),
        ("panel_post=6", "a post's wall is too thin"),
        ("plate_thread=8", "take shorter ones"),
    ],
)
def test_a_seat_that_cannot_work_is_refused(definition: str, sentence: str, tmp_path: Path) -> None:
    ran = made("panel_post", tmp_path / "part.csg", definition)
    assert "ERROR: Assertion" in ran.stderr
    assert sentence in ran.stderr
