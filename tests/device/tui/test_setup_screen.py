"""Set-up by key presses: facts, pairing, self-test, zero check, gels, calibrations, power off."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device.instrument.state import PairingState
from device.tui.screens.panels import pairing_panel

Stage = Any

ACTIONS = (
    "back",
    "facts",
    "pair",
    "test",
    "focus",
    "exposure",
    "zero",
    "check",
    "gel",
    "calibrations",
    "stick",
    "display",
    "brightness",
    "clock",
    "wifi",
    "off",
)

LIST_COLUMNS = 21


async def _choose(stage: Stage, action: str) -> None:
    await stage.press("4", *["down"] * ACTIONS.index(action))


def _panel(stage: Stage) -> str:
    """The words right of the list of actions, without line breaks."""
    return " ".join(" ".join(line[LIST_COLUMNS:] for line in stage.lines()[1:]).split())


def test_facts_name_device_network_key_gel_lights_and_storage(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "facts")
        shown = stage.text()
        words = ("Device", "Name", "Address", "Key", "Gel", "Calibration", "Brightness", "Lights", "Storage", "0.1.0")
        assert [word for word in words if word not in shown] == []

    play(scenario, root, size=(100, 30))


def test_the_exposure_is_shown_balanced_and_given_up(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "exposure")
        await stage.live(10)
        shown = _panel(stage)
        for words in ("Light on the skin", "red ■", "saturated pixels: 0.0%", "Next calibration, board profile:"):
            assert words in shown
        await stage.press("enter", "enter")
        await stage.live(2)
        shown = _panel(stage)
        for words in ("presses", "0 of 3", "Press the ball as close to light red as possible", "x stop"):
            assert words in shown
        await stage.press("enter")
        await stage.live()
        assert "1 of 3" in _panel(stage)
        await stage.press("x")
        await stage.live(2)
        assert "Exposure balance stopped: nothing has changed." in stage.text()
        await stage.live(20)  # the twin's operator pushes no more
        assert "Next calibration, board profile:" in _panel(stage)
        await stage.press("enter", "enter")
        await stage.live(2)
        while stage.instrument.state.activity == "balancing":
            stage.instrument.step()
        await stage.live(3)
        shown = _panel(stage)
        for words in ("before after", "exposure", "ball, red", "84%", "The active calibration keeps its own light"):
            assert words in shown
        assert all(len(line) <= 80 for line in stage.lines())
        await stage.press("enter", "down", "enter")
        await stage.live(3)
        assert "Next calibration, board profile:" in _panel(stage)

    play(scenario, root)


def test_pairing_without_an_ssh_server_says_what_to_install(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "pair")
        assert "Enter opens a window for two minutes;" in stage.text()
        await stage.press("enter")
        await stage.live()
        assert "openssh-server" in stage.text()

    play(scenario, root)


def test_pairing_shows_the_command_for_the_workstation(play: Callable[..., None], root: Path, host_key: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "pair")
        await stage.press("enter")
        await stage.live()
        assert "Code" not in _panel(stage)
        assert f"retrosync pair {os.uname().nodename}.local" in " ".join(stage.text().split())
        assert "SHA256:" in stage.text()

    play(scenario, root, host_key=host_key)


def test_the_code_of_a_calling_workstation_is_drawn_in_large() -> None:
    text = pairing_panel(PairingState("042 917", 60 * 10**9, "", is_open=True), None, 0, 60)
    assert "Code    0 4 2   9 1 7" in text
    assert "Enter, or the button held for 2 s, lets the workstation in" in " ".join(text.split())
    assert "60 s left" in text


def test_the_self_test_lists_findings_and_blames_the_right_part(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        stage.bench.faults.open_lights.add("green")
        await _choose(stage, "test")
        await stage.press("enter")
        await stage.live(2)
        shown = stage.text()
        assert "ok power: the supply is good" in shown
        assert "FAIL light green: not visible to the camera" in shown
        assert "1 of 9 failed." in shown
        stage.bench.faults.open_lights.clear()
        await stage.press("enter")
        await stage.live(2)
        assert "No part failed." in stage.text()
        assert "FAIL" not in stage.text()

    play(scenario, root)


def test_the_zero_check_is_reported(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "zero")
        await stage.press("enter")
        await stage.live(2)
        assert stage.instrument.state.health.flat_residual_um is not None
        assert "µm" in stage.text()

    play(scenario, root)


def test_an_unknown_gel_is_refused_scans_until_it_is_calibrated_and_the_old_one_comes_back(
    play: Callable[..., None], root: Path
) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "gel")
        await stage.press("enter")
        assert "Which gel is mounted?" in stage.text()
        await stage.press("down", "enter")
        assert "New gel" in stage.text()
        await stage.press(*"gel-2", "enter", "enter")
        await stage.live(2)
        assert "! " in stage.text()
        assert stage.instrument.state.gel.gel_id == "gel-2"
        await stage.press("1", "space")
        await stage.live()
        assert "! Not scanned:" in stage.text()
        await stage.press("4", "enter")
        await stage.press("down", "enter")
        await stage.live(2)
        assert stage.instrument.state.gel.gel_id == "twin-gel"
        assert stage.instrument.state.calibration.calibration_id is not None

    play(scenario, root)


def test_a_thickness_that_is_no_number_is_refused(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "gel")
        await stage.press("enter")
        await stage.press("down", "enter")
        await stage.press(*"gel-2", "enter", "end", *"thick", "enter")
        assert "is not a thickness in mm" in stage.text()
        assert stage.instrument.state.gel.gel_id == "twin-gel"

    play(scenario, root)


def test_calibrations_are_listed_with_the_active_one(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "calibrations")
        await stage.press("enter")
        assert re.search(r"> twin-gel user v1 time not known active", stage.text())
        await stage.press("escape")
        assert stage.instrument.state.calibration.calibration_id is not None

    play(scenario, root)


def test_powering_off_asks_and_then_ends_the_screens(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "off")
        await stage.press("enter")
        assert "Power off?" in stage.text()
        await stage.press("enter")  # the focus is on No
        assert stage.instrument.state.activity == "ready"
        await stage.press("enter")
        await stage.press("y")
        stage.instrument.step()
        await stage.app.show_state()
        assert stage.instrument.state.activity == "off"
        assert stage.app.return_value == "off"
        assert stage.bench.currents_ma == {}

    play(scenario, root)


def test_one_button_walks_through_the_list_and_does_what_is_chosen(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("4")
        for _ in range(ACTIONS.index("off")):
            await stage.push()
        await stage.push(held_s=2.5)
        assert "Power off?" in stage.text()
        await stage.push(held_s=2.5)  # the focus is on No
        assert "Power off?" not in stage.text()
        await stage.push()
        assert "> Back to Scan" in stage.text()
        await stage.push(held_s=2.5)
        assert stage.app.current_mode == "scan"

    play(scenario, root)


def test_the_display_turns_light_and_stays_so(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "display")
        before = stage.app.theme
        await stage.press("enter")
        assert stage.app.theme != before
        assert stage.instrument.state.settings.display == "light"

    async def later(stage: Stage) -> None:
        assert not stage.app.current_theme.dark
        await _choose(stage, "display")
        await stage.press("enter")
        assert stage.app.current_theme.dark

    play(scenario, root)
    play(later, root)
    play(scenario, root, depth="sixteen")


def test_an_export_without_a_stick_says_so_and_the_clock_is_shown(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "facts")
        assert "the clock was never set" in stage.text()
        await stage.press("home")
        await _choose(stage, "stick")
        await stage.press("enter")
        assert "no USB stick is mounted" in stage.text()

    play(scenario, root, size=(100, 30))


@pytest.mark.parametrize("size", [(40, 16), (80, 24)])
def test_the_focus_is_read_while_its_panel_is_shown(
    play: Callable[..., None], root: Path, size: tuple[int, int]
) -> None:
    async def scenario(stage: Stage) -> None:
        await _choose(stage, "focus")
        assert "turn its focus ring" in _panel(stage)
        await stage.press("enter")
        await stage.live(8)
        shown = _panel(stage)
        assert "sharpness" in shown
        assert f"best {stage.instrument.state.focus.best:.2f}" in shown
        assert "Turn the focus ring slowly" in shown
        await stage.press("enter")
        await stage.live(1)
        assert stage.instrument.state.focus is None
        await stage.press("enter")
        await stage.live(2)
        assert stage.instrument.state.focus is not None
        await stage.press("1")
        await stage.live(1)
        assert stage.instrument.state.focus is None

    play(scenario, root, size=size)
