"""Housing, bill of materials, wiring and profiles describe the same instrument."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

from hal.board_profile import BoardProfile, load_board_profile
from hal.drivers.lights_pca9955b import Pca9955b
from hal.drivers.lights_tlc59116 import Tlc59116
from tests.drawings.board.beam import (
    Sleeve,
    brightest_to_darkest,
    centre_to_darkest,
    half_field_mm,
    light_over_field,
)
from tests.drawings.board.wiring import wired_boards, wiring

BOARD = Path(__file__).parents[2] / "board"
BILL = (BOARD / "bill-of-materials.md").read_text(encoding="utf-8")
HOUSING = (BOARD / "enclosure" / "retrograph.scad").read_text(encoding="utf-8")
HOUSED = ("pi5-imx296", "pi4-imx477", "pi4-imx477-binned")
BENCH = "zero2w-imx708"
MAX_UNEVENNESS = 6.0


def parameter(name: str) -> float:
    found = re.search(rf"^{name} = ([-\d.]+);", HOUSING, re.MULTILINE)
    assert found, name
    return float(found[1])


def row(what: str) -> str:
    """The bill's row of a part."""
    found = re.search(rf"^\| {re.escape(what)} \|.*$", BILL, re.MULTILINE)
    assert found, what
    return found[0]


def led_width_deg() -> float:
    found = re.search(r"any: 5 mm, (\d+)° wide", row("LEDs, red (2)"))
    assert found
    return float(found[1])


def sleeve() -> Sleeve:
    """A light of the housing as its source and the bill have it."""
    leds, pitch = int(parameter("leds")), parameter("led") + 0.1
    offsets = tuple((i - (leds - 1) / 2) * pitch for i in range(leds))
    bore = parameter("led") - 2 * parameter("led_lip")
    return Sleeve(led_width_deg(), offsets, parameter("distance") - parameter("facet_at"), bore)


@pytest.fixture(params=[*HOUSED, BENCH])
def profile(request: pytest.FixtureRequest) -> BoardProfile:
    return load_board_profile(request.param)


def test_every_wired_board_is_meant() -> None:
    assert set(wired_boards()) == {*HOUSED, BENCH}


def test_a_light_has_as_many_leds_everywhere(profile: BoardProfile) -> None:
    leds = int(parameter("leds"))
    drawn = {led.light: led for led in wiring(profile.name).leds}
    for light in profile.lights:
        assert len(light.channels) == len(drawn[light.name].channels) == leds
        assert f"| LEDs, {light.name} ({leds}) |" in BILL
    assert len({channel for light in profile.lights for channel in light.channels}) == 3 * leds


def test_no_led_gets_more_than_the_bill_says_it_stands(profile: BoardProfile) -> None:
    found = re.search(r"(\d+) mA continuous", row("LEDs, red (2)"))
    assert found
    assert profile.light_driver is not None
    resistor = f"{profile.light_driver.reference_ohm / 1e3:.2f} kΩ"
    (rows,) = [one for one in BILL.splitlines() if resistor in one]
    assert profile.name.removesuffix("-binned") in rows
    stated = re.search(r"([\d.]+) mA at most", rows)
    assert stated
    chip = {"PCA9955B": Pca9955b, "TLC59116": Tlc59116}[profile.light_driver.chip]
    unused: Any = None
    assert float(stated[1]) == pytest.approx(chip(unused, profile.light_driver.reference_ohm).max_ma, rel=0.01)
    for light in profile.lights:
        assert light.current_ma <= float(stated[1]) <= float(found[1]) == light.max_ma


@pytest.mark.parametrize("board", HOUSED)
def test_light_over_the_field_is_within_six_to_one(board: str) -> None:
    profile = load_board_profile(board)
    for light in profile.lights:
        lit = light_over_field(light.position_mm, sleeve(), half_field_mm(profile))
        assert centre_to_darkest(lit) <= brightest_to_darkest(lit) <= MAX_UNEVENNESS, light.name


def test_on_the_bench_no_place_has_less_than_a_sixth_of_the_centres_light() -> None:
    profile = load_board_profile(BENCH)
    for light in profile.lights:
        lit = light_over_field(light.position_mm, led_width_deg(), half_field_mm(profile))
        assert centre_to_darkest(lit) <= MAX_UNEVENNESS, light.name


@pytest.mark.parametrize("narrow", [Sleeve(30.0, (0.0,), 5.0, 4.0), Sleeve(30.0, (-2.65, 2.65), 1.0, 4.4)])
def test_narrow_leds_and_long_bores_are_found_out(narrow: Sleeve) -> None:
    profile = load_board_profile("pi5-imx296")
    ratios = [
        centre_to_darkest(light_over_field(light.position_mm, narrow, half_field_mm(profile)))
        for light in profile.lights
    ]
    assert max(ratios) > MAX_UNEVENNESS


def test_a_far_wide_light_is_even_and_a_near_one_falls_with_the_cube_of_its_distance() -> None:
    even = light_over_field((0.0, 0.0, 5000.0), 120.0, (8.0, 6.0))
    assert brightest_to_darkest(even) == pytest.approx(1.0, abs=1e-4)
    lambertian = light_over_field((0.0, 0.0, 10.0), 120.0, (10.0, 10.0))
    assert lambertian[10, 10] / lambertian[10, 0] == pytest.approx(2.0**2)  # cos⁴ of 45 degrees


def test_the_block_is_cut_from_what_the_bill_lists() -> None:
    found = re.search(r"PMMA, (\d+) × (\d+) × (\d+) mm", row("block"))
    assert found
    width, depth, height = (float(one) for one in found.groups())
    assert parameter("block_top") - parameter("gel_thickness") <= height
    assert 2 * (parameter("inner_r") - parameter("wall") - parameter("gap")) <= min(width, depth)


def test_the_leds_fit_the_facet() -> None:
    elevation = math.acos(math.cos(math.radians(parameter("elevation"))) * parameter("n_gel") / parameter("n_block"))
    highest = parameter("facet_at") * math.sin(elevation) + parameter("led") / 2 * math.cos(elevation)
    assert highest <= parameter("block_top")


def test_the_f_number_is_the_same_where_the_lens_is_bought_and_where_it_is_explained() -> None:
    geometry = (BOARD / "light-geometry.md").read_text(encoding="utf-8")
    assert "* `pi5-imx296`: **f/4 to f/5.6**" in geometry
    assert "* `pi4-imx477-binned`: **f/4**" in geometry
    assert "[f/4 (pi4-imx477) or f/4 to f/5.6 (pi5-imx296)]" in row("lens")
