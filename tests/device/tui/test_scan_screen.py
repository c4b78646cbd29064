"""The scan screen by key presses: cue, scan, verdict, profile, sticky fields, and every way in which a press fails."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import device.store.store

Stage = Any


def _cursor_mm(stage: Stage) -> tuple[float, float]:
    x_mm, y_mm = re.search(r"x ([0-9.]+) mm y ([0-9.]+) mm z -?[0-9.]+ µm", stage.text()).groups()
    return float(x_mm), float(y_mm)


def test_a_scan_shows_cue_verdict_relief_and_its_scale(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        assert "The relief of a scan appears here." in stage.text()
        assert "Press the object into the gel." in stage.text()
        await stage.object_pressed()
        await stage.live(27)
        assert "> Ready: push the button." in stage.text()
        shown = stage.text()
        assert "GOOD #1 exposure" in shown
        assert "µm" in shown
        assert "├" in shown
        assert "5 mm" in shown
        assert "contact ■" in shown
        assert stage.instrument.state.last.scan_id.endswith("000001")

    play(scenario, root)


def test_space_scans_like_the_button(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("space")
        await stage.live(3)
        assert stage.instrument.state.scans_stored == 1
        assert "#1" in stage.text()
        await stage.push()
        assert stage.instrument.state.scans_stored == 2

    play(scenario, root)


def test_the_profile_follows_the_arrow_keys_and_a_touch(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.object_pressed()
        await stage.press("p")
        assert "▲" in stage.text()
        x_mm, y_mm = _cursor_mm(stage)
        await stage.press("right", "down")
        right_mm, down_mm = _cursor_mm(stage)
        assert (right_mm > x_mm, down_mm > y_mm) == (True, True)
        await stage.press("t", "up")
        assert _cursor_mm(stage) == (right_mm, y_mm)
        await stage.pilot.click("HeightView", offset=(0, 0))
        await stage.show()
        assert _cursor_mm(stage) == (0.0, 0.0)
        await stage.press("p")
        assert "▲" not in stage.text()

    play(scenario, root)


def test_job_part_and_operator_stick_to_the_next_scan(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("j")
        await stage.press(*"J-7", "enter", *"lid", "enter", *"Mia q1", "enter")
        assert "Job J-7 · Part lid · Operator Mia q1" in stage.text()
        await stage.press("space")
        await stage.live(3)
        (entry,) = stage.instrument.history().scans
        assert (entry.annotations.job, entry.annotations.part, entry.annotations.operator) == ("J-7", "lid", "Mia q1")
        await stage.press("j")
        await stage.press(*"gone", "escape")
        assert "Job J-7 · Part lid" in stage.text()

    play(scenario, root)


def test_without_a_calibration_the_way_is_shown_and_a_press_is_refused(
    play: Callable[..., None], empty_root: Path
) -> None:
    async def scenario(stage: Stage) -> None:
        assert "Not calibrated: open Calibrate" in stage.text()
        await stage.press("space")
        await stage.live()
        assert "! Not scanned: no calibration is active" in stage.text()
        assert stage.instrument.state.scans_stored == 0

    play(scenario, empty_root)


def test_a_full_disk_refuses_and_says_what_to_do(
    play: Callable[..., None], root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario(stage: Stage) -> None:
        monkeypatch.setattr(device.store.store, "RESERVE_BYTES", 1 << 62)
        await stage.press("space")
        await stage.live()
        assert "! Not scanned:" in stage.text()
        assert "offload scans or free space" in stage.text()

    play(scenario, root)


def test_a_camera_that_fell_out_is_named_and_comes_back(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        stage.bench.faults.camera_missing = True
        await stage.live(3)
        assert "Out of order" in stage.text()
        assert "! camera twin/IMX296 is not there: check its cable" in stage.text()
        stage.bench.faults.camera_missing = False
        await stage.live(4)
        assert "Press the object into the gel." in stage.text()

    play(scenario, root)


def test_a_frame_that_is_not_confirmed_is_no_scan(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        stage.bench.faults.lights_silent = True
        await stage.press("space")
        await stage.live()
        assert "! " in stage.text()
        assert stage.instrument.state.scans_stored == 0

    play(scenario, root)


def test_the_auto_shutter_is_switched_and_seen(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("a")
        assert "auto-shutter on" in stage.text()
        await stage.press("a")
        assert "auto-shutter on" not in stage.text()

    play(scenario, root)


def test_the_zero_check_says_how_flat_the_skin_reads(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("z")
        await stage.live(2)
        assert stage.instrument.state.health.flat_residual_um is not None
        assert "µm" in stage.text()
        assert stage.instrument.state.scans_stored == 0

    play(scenario, root)


def test_a_long_push_leads_on_and_short_ones_never_scan_elsewhere(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        for place in ("calibrate", "scans", "set-up"):
            await stage.push(held_s=2.5)
            assert stage.app.current_mode == place
        await stage.push()
        assert stage.instrument.state.scans_stored == 0
        assert "> This instrument" in stage.text()

    play(scenario, root)


def test_presets_numbers_and_retakes_by_key(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("j", *"lids", "enter", *"A-09", "enter", *"Kim", "enter")
        await stage.press("o", "enter")
        assert "Stored: o lists it." in stage.text()
        await stage.press("j", *["backspace"] * 4, *"nuts", "enter", "enter", "enter")
        assert "Job nuts" in stage.text()
        await stage.press("i")
        assert "Part A-09 (numbered)" in stage.text()
        await stage.object_pressed()
        assert "Part A-10 (numbered)" in stage.text()
        await stage.press("r")
        assert "next: retake of #1" in stage.text()
        await stage.press("r", "o")
        assert "Store: Job nuts" in stage.text()
        await stage.press("enter")
        assert "Job lids · Part A-09 (numbered) · Operator Kim" in stage.text()

    play(scenario, root)
