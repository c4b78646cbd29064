"""Housing, bill of materials, wiring and profiles describe the same instrument."""

import math
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hal.board_profile import BoardProfile, load_board_profile
from hal.drivers.lights_pca9955b import Pca9955b
from hal.drivers.lights_tlc59116 import Tlc59116
from hal.profile_tables import BeamConfig
from hal.simulator.lens import Lens
from hal.simulator.scene import ACRYLIC, render, twin_of
from tests.drawings.board.beam import (
    brightest_to_darkest,
    centre_to_darkest,
    half_field_mm,
    light_over_field,
)
from tests.drawings.board.block import Block
from tests.drawings.board.power import SUPPLIES, live_ma, peak_ma
from tests.drawings.board.totals import euros, part_numbers, rows_of
from tests.drawings.board.weights import CARRIED_G, block_g, handheld_g
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


def sleeve() -> BeamConfig:
    """A light of the housing as its source and the bill have it."""
    leds, pitch = int(parameter("leds")), parameter("led") + 0.1
    return BeamConfig(
        led_angle_deg=led_width_deg(),
        led_offsets_mm=tuple((i - (leds - 1) / 2) * pitch for i in range(leds)),
        behind_mm=parameter("distance") - parameter("facet_at"),
        bore_mm=parameter("led") - 2 * parameter("led_lip"),
    )


def narrow_sleeve(led_offsets_mm: tuple[float, ...], behind_mm: float, bore_mm: float) -> BeamConfig:
    return BeamConfig(led_angle_deg=30.0, led_offsets_mm=led_offsets_mm, behind_mm=behind_mm, bore_mm=bore_mm)


def free(led_angle_deg: float) -> BeamConfig:
    return BeamConfig(led_angle_deg=led_angle_deg, facet=False)


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
def test_the_profiles_beam_is_the_housings_sleeve(board: str) -> None:
    beam, built = load_board_profile(board).beam, sleeve()
    assert beam is not None
    assert beam.facet
    assert beam.led_angle_deg == built.led_angle_deg
    assert beam.led_offsets_mm == pytest.approx(built.led_offsets_mm)
    assert (beam.behind_mm, beam.bore_mm) == pytest.approx((built.behind_mm, built.bore_mm))
    assert parameter("n_block") == ACRYLIC


def test_on_the_bench_the_leds_stand_free_and_aim_as_the_page_says() -> None:
    beam = load_board_profile(BENCH).beam
    assert beam is not None
    assert not beam.facet
    assert beam.led_angle_deg == led_width_deg()
    assert len(beam.led_offsets_mm) == int(parameter("leds"))
    geometry = (BOARD / "light-geometry.md").read_text(encoding="utf-8")
    assert f"aim {beam.aim_past_mm:g} mm beyond" in geometry


def test_light_over_the_field_is_within_six_to_one(profile: BoardProfile) -> None:
    assert profile.beam is not None
    for light in profile.lights:
        lit = light_over_field(light.position_mm, profile.beam, half_field_mm(profile))
        assert centre_to_darkest(lit) <= brightest_to_darkest(lit) <= MAX_UNEVENNESS, light.name


def test_so_is_the_light_that_the_twin_of_a_board_renders(profile: BoardProfile) -> None:
    """Light on the skin: what the lens darkens at its corners is taken off."""
    small = in_small(twin_of(profile))
    lens = Lens.of(small)
    one = np.ones((small.sensor.rows, small.sensor.columns), np.float32)
    passed = lens.transmit(one, np.zeros_like(one))
    for light, charge_e in zip(small.lights, render(small, None).charge_e, strict=True):
        lit = (charge_e / passed)[::2, ::2]
        assert brightest_to_darkest(lit) <= MAX_UNEVENNESS, light.name
        assert brightest_to_darkest(lit) > 2.0, "a near light is never even: was there a beam?"


def in_small(profile: BoardProfile) -> BoardProfile:
    """The same field in an eighth of the pixels."""
    sensor, lens = profile.sensor, profile.lens
    assert lens is not None
    small = msgspec.structs.replace(
        sensor,
        columns=sensor.columns // 16 * 2,
        rows=sensor.rows // 16 * 2,
        pixel_pitch_um=sensor.pixel_pitch_um * 8,
    )
    return msgspec.structs.replace(
        profile, sensor=small, lens=msgspec.structs.replace(lens, pixel_um=lens.pixel_um * 8)
    )


@pytest.mark.parametrize("narrow", [narrow_sleeve((0.0,), 5.0, 4.0), narrow_sleeve((-2.65, 2.65), 1.0, 4.4)])
def test_narrow_leds_and_long_bores_are_found_out(narrow: BeamConfig) -> None:
    profile = load_board_profile("pi5-imx296")
    ratios = [
        centre_to_darkest(light_over_field(light.position_mm, narrow, half_field_mm(profile)))
        for light in profile.lights
    ]
    assert max(ratios) > MAX_UNEVENNESS


def test_a_far_wide_light_is_even_and_a_near_one_falls_with_the_cube_of_its_distance() -> None:
    even = light_over_field((0.001, 0.0, 5000.0), free(120.0), (8.0, 6.0))
    assert brightest_to_darkest(even) == pytest.approx(1.0, abs=1e-4)
    lambertian = light_over_field((1e-6, 0.0, 10.0), free(120.0), (10.0, 10.0))
    assert lambertian[10, 10] / lambertian[10, 0] == pytest.approx(2.0**2)  # cos⁴ of 45 degrees


def test_the_block_is_cut_from_what_the_bill_lists() -> None:
    found = re.search(r"PMMA, (\d+) × (\d+) × (\d+) mm", row("block"))
    assert found
    width, depth, height = (float(one) for one in found.groups())
    assert parameter("block_top") - parameter("gel_thickness") <= height
    assert 2 * (parameter("inner_r") - parameter("wall") - parameter("gap")) <= min(width, depth)


@pytest.mark.parametrize("board", [*HOUSED, BENCH])
def test_the_total_holds_every_part_that_a_board_cannot_do_without(board: str) -> None:
    bought = [what for what, _ in rows_of(board, BILL)]
    for what in ("computer", "camera", "card", "mains adapter", "light driver", "reference resistor", "button"):
        assert bought.count(what) == 1, what
    for housed in ("lens", "block", "housing", "extension rings", "carrier"):
        assert bought.count(housed) == (board in HOUSED), housed
    least, most = euros(board, BILL)
    assert f"| {board.removesuffix('-binned')} | {len(bought)} | {least} to {most} € | " in BILL
    assert 0 < least < most


def test_every_row_has_a_number_to_order_or_says_why_not() -> None:
    """A maker's number, perhaps not verified (?), or `any` with the specification, or who makes it."""
    numbers = part_numbers(BILL)
    assert len(numbers) > 55
    for row_name, number in numbers.items():
        is_makers = re.search(r"[A-Z0-9][A-Z0-9/-]{2,}|[A-Z]\w+ [A-Z]\w+", number)
        is_specified = number.startswith("any") and len(number) > len("any: ")
        assert is_makers or is_specified or number.startswith(("comes with", "made by")), row_name


@pytest.mark.parametrize("board", sorted(SUPPLIES))
def test_a_supply_gives_what_its_board_draws_with_everything_at_work(board: str) -> None:
    supply = SUPPLIES[board]
    assert live_ma(board) < peak_ma(board) <= supply.limit_ma
    assert f"{supply.limit_ma * 1e-3:.0f} A" in row("power bank" if supply.takes_panel else "battery supply")


def test_the_pins_that_the_pages_name_are_those_of_the_wiring() -> None:
    pins = {(wire.part, wire.terminal): wire.pin for board in wired_boards() for wire in wiring(board).wires}
    panel, supply = ((pins[part, "+5V"], pins[part, "ground"]) for part in ("panel", "supply"))
    assert "5 V and ground to header pins {} and {}, or the carrier's J11".format(*panel) in BILL
    assert "PowerBoost at header pins {} and {}".format(*supply) in BILL
    fail = f"header pin {pins['power-fail', 'signal']} (GPIO 22) and ground at pin {pins['power-fail', 'ground']}"
    assert fail in BILL
    latch = f"header pins {pins['power-off', 'OFF']} (OFF) and {pins['power-off', 'ground']}"
    assert latch in BILL
    named = re.findall(r"header pins? (\d+)(?: \([^)]*\))?(?: and (\d+))?", BILL)
    assert {int(pin) for pair in named for pin in pair if pin} <= set(pins.values())


def test_camera_and_panel_of_a_pi_5_have_a_connector_each() -> None:
    """A camera's overlay without an option means CAM/DISP 1."""
    assert "CAM/DISP 1" in row("camera cable")
    assert "CAM/DISP 0" in row("panel")
    (panel,) = (ties for part, ties in wiring("pi5-imx296").parts if part == "panel")
    assert "CAM/DISP 0" in panel[0]


def test_what_the_pages_measure_and_work_with_is_on_the_list_of_tools() -> None:
    tools = re.search(r"^\*\*Tools\*\*:.*?\n\n", BILL, re.MULTILINE | re.DOTALL)
    assert tools
    names = "multimeter|oscilloscope|USB meter|feeler|stage micrometer|airbrush|vacuum|serial|10 Ω|file|drill"
    for place in ("bench-checklist.md", "calibration-cap.md", "gel.md", "enclosure/README.md"):
        page = (BOARD / place).read_text(encoding="utf-8")
        for used in set(re.findall(rf"\b({names})\b", page, re.IGNORECASE)):
            assert used.lower() in tools[0].lower(), f"{place}: {used}"


@pytest.mark.parametrize("board", ["pi5-imx296", "pi4-imx477"])
def test_what_a_handheld_weighs_is_of_rows_of_its_bill(board: str) -> None:
    bought = [what for what, _ in rows_of(board, BILL)]
    weighed = {what for what, grams in CARRIED_G.items() if board in grams}
    assert weighed <= set(bought)
    for heavy in ("computer", "camera", "lens", "housing", "power bank"):
        assert heavy in weighed
    grams = handheld_g(board)
    assert grams is not None
    assert f"| about {round(grams, -1):.0f} g |" in BILL
    # Acrylic of the drawing: a disc less what three facets take.
    assert 0.5 < block_g() / (math.pi * Block.of_source().radius ** 2 * Block.of_source().height * 1.19e-3) < 1.0
    assert handheld_g(BENCH) is None


def test_a_domed_led_would_reach_the_facet_and_the_bill_asks_for_flat_tops() -> None:
    radius_mm, lip_mm = 2.5, parameter("distance") - parameter("facet_at")
    bore_mm = sleeve().bore_mm
    assert bore_mm is not None
    dome_mm = radius_mm - math.sqrt(radius_mm**2 - (bore_mm / 2) ** 2)
    assert dome_mm > lip_mm, "else any LED fits"
    for colour in ("red", "green", "blue"):
        assert "flat top" in row(f"LEDs, {colour} (2)")
    assert "flat top" in HOUSING
    assert "120 degrees" not in HOUSING


def test_the_leds_fit_the_facet() -> None:
    elevation = math.acos(math.cos(math.radians(parameter("elevation"))) * parameter("n_gel") / parameter("n_block"))
    highest = parameter("facet_at") * math.sin(elevation) + parameter("led") / 2 * math.cos(elevation)
    assert highest <= parameter("block_top")


def test_the_f_number_is_the_same_where_the_lens_is_bought_and_where_it_is_explained() -> None:
    stated = {board: load_board_profile(board).lens for board in HOUSED}
    assert {board: lens.f_number for board, lens in stated.items() if lens} == dict.fromkeys(HOUSED, 4.0)
    assert all(lens.focal_mm == parameter("focal") for lens in stated.values() if lens)
    geometry = (BOARD / "light-geometry.md").read_text(encoding="utf-8")
    assert "* `pi5-imx296`: **f/4 to f/5.6**" in geometry
    assert "* `pi4-imx477-binned`: **f/4**" in geometry
    assert "[f/4 (pi4-imx477) or f/4 to f/5.6 (pi5-imx296)]" in row("lens")
