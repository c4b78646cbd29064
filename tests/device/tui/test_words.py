"""The few words that a screen has room for."""

from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from each_case import each_case

from device.calibration.acceptance import Check
from device.guidance.guide import Advice, GuideReading
from device.imaging.frame_light import Brightness
from device.instrument.state import CalibrationState, GelState, HealthState, InstrumentState, LiveView
from device.tui.drawing.cells import colour_depth
from device.tui.drawing.text import age_text, check_lines, coverage_lines, gauge_text, shortened, signed_percent
from device.tui.screens.panels import ProgramInfo, instrument_panel, state_text
from hal.interfaces import PowerReading


def state(**what: object) -> InstrumentState:
    usual = InstrumentState(
        activity="ready",
        board="twin",
        device_id="rg12345678",
        calibration=CalibrationState("cal", "gel", age_s=30.0),
        gel=GelState("gel", 2.5, 3),
        health=HealthState({}),
    )
    return replace(usual, **what)


@pytest.mark.parametrize(
    ("environment", "depth"),
    [
        ({"TERM": "xterm-256color"}, "full"),
        ({"TERM": "foot", "COLORTERM": "truecolor"}, "full"),
        ({"TERM": "xterm-kitty"}, "full"),
        ({"TERM": "linux"}, "sixteen"),
        ({"TERM": "screen"}, "sixteen"),
        ({"TERM": "xterm-256color", "NO_COLOR": "1"}, "mono"),
        ({"TERM": "xterm-256color", "NO_COLOR": ""}, "full"),
        ({"TERM": "vt220"}, "mono"),
        ({}, "mono"),
    ],
)
def test_colours_are_those_that_the_terminal_promises(environment: dict[str, str], depth: str) -> None:
    assert colour_depth(environment) == depth


def test_ages() -> None:
    assert [age_text(age_s) for age_s in (5.0, 90.0, 3 * 3600.0, 5 * 86400.0)] == [
        "just now",
        "1 min ago",
        "3 h ago",
        "5 days ago",
    ]


@each_case(list(product([None, -1.0, 0.0, 0.5, 1.0, 7.0], [0, 5, 17, 18, 40])))
def test_a_gauge_fills_its_columns_whatever_it_shows(case: tuple[float | None, int]) -> None:
    share, columns = case
    assert len(gauge_text("contact", share, columns)) == columns


def test_a_gauge_shows_what_was_not_measured_as_a_dash() -> None:
    assert gauge_text("depth", None, 24).endswith("-")
    assert "■" not in gauge_text("depth", None, 24)


def test_the_state_line_says_first_what_matters_most() -> None:
    warned = HealthState({}, level="doubtful", sentence="light red is 3% weaker")
    text = state_text(state(health=warned, scans_left=12, processing=1, power=PowerReading(battery_share=0.4)), 200)
    assert (
        text == "! light red is 3% weaker · 12 scans left · 1 processing · battery 40% · calibrated just now · gel gel"
    )


@pytest.mark.parametrize(("advice", "is_shown"), [("lights", False), ("ready", True)])
def test_lights_as_last_measured_are_not_shown_while_the_live_view_finds_them_wrong(
    advice: Advice, is_shown: bool
) -> None:
    warned = HealthState({}, level="doubtful", sentence="light red is 3% weaker")
    reading = GuideReading(
        contact_fraction=None, tilt_deg=None, tilt_towards="", motion=0.0, still_s=0.0, clipped_fraction=0.0,
        exposure=0.2, depth_um=None, depth_fraction=None, in_air=False, advice=advice, sentence="", cpu_ms=1.0,
    )  # fmt: skip
    live = LiveView(np.zeros((2, 2, 3), np.uint8), 2, reading, 0)
    assert ("3% weaker" in state_text(state(health=warned, live=live), 200)) is is_shown


@pytest.mark.parametrize(
    ("calibration", "words"),
    [
        (CalibrationState(), "not calibrated"),
        (CalibrationState("cal"), "calibrated, age unknown"),
        (CalibrationState("cal", age_s=60 * 86400.0), "calibrated 60 days ago, check it"),
    ],
)
def test_the_calibrations_age(calibration: CalibrationState, words: str) -> None:
    assert words in state_text(state(calibration=calibration), 200)


def test_a_low_supply_is_named_and_an_unmeasured_one_is_not() -> None:
    assert "! supply too low" in state_text(state(power=PowerReading(under_voltage=True)), 200)
    assert "battery" not in state_text(state(), 200)


def test_acceptance_checks_are_shown_with_their_limits() -> None:
    checks = (
        Check("balls used", 3.0, 4.0, "at least"),
        Check("share of balls rejected", 0.08, 0.35, "at most"),
    )
    assert check_lines(checks) == [
        "FAIL  balls used: 3 (at least 4)",
        "pass  share of balls rejected: 8% (at most 35%)",
    ]


def test_before_the_first_ball_nothing_is_covered() -> None:
    assert "■" not in "".join(coverage_lines(None))


def test_text_that_does_not_fit_ends_in_an_ellipsis() -> None:
    assert [shortened("sphere", columns) for columns in (6, 4, 1)] == ["sphere", "sph…", "…"]


@pytest.mark.parametrize(("change", "text"), [(-0.0004, "+0.0%"), (0.0, "+0.0%"), (-0.0006, "-0.1%"), (0.02, "+2.0%")])
def test_a_change_that_rounds_to_nothing_has_no_minus(change: float, text: str) -> None:
    assert signed_percent(change) == text


def test_the_instruments_facts_count_once_and_name_what_the_screens_can_do(tmp_path: Path) -> None:
    balance = replace(state().calibration, brightness=Brightness((0.5, 0.5, 0.5), (0.95, 0.9, 0.9)))
    known = state(calibration=balance, gel=GelState("gel", 2.5, 1), scans_stored=1, scans_left=1)
    text = instrument_panel(known, ProgramInfo("0.1.0", tmp_path), None, 200, datetime(2026, 11, 23, tzinfo=UTC))
    assert "pressed once" in text
    assert "1 scan, room for 1 more" in text
    assert "balance it (key 4, Exposure)" in text
    assert "retroscan calibrate" not in text
    assert "1 scan left" in state_text(known, 200)
