"""The history by key presses: choose, mark, note, profile; scans that are offloaded, damaged, or not there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device.bundles.bundle import RECEIPTS, Receipt, receipt_name
from device.bundles.record import encode_record, sha256_bytes
from device.io.atomic import replace_file

Stage = Any


async def _scan(stage: Stage, times: int) -> None:
    for _ in range(times):
        stage.instrument.press()
        await stage.live(2)


def test_scans_are_listed_newest_first_and_chosen_by_keys_touch_and_button(
    play: Callable[..., None], root: Path
) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 3)
        await stage.press("3")
        rows = [line for line in stage.lines()[2:20] if " doubtful" in line[:20] or " good " in line[:20]]
        assert [row.split()[1 if row.strip().startswith(">") else 0] for row in rows] == ["3", "2", "1"]
        assert rows[0].lstrip().startswith(">")
        await stage.press("down")
        assert stage.lines()[3].lstrip().startswith("> ")
        await stage.push()
        assert stage.lines()[4].lstrip().startswith("> ")
        await stage.push()
        assert stage.lines()[2].lstrip().startswith("> ")
        await stage.pilot.click("#history", offset=(3, 1))
        await stage.show()
        assert stage.lines()[3].lstrip().startswith("> ")
        assert "not offloaded" in stage.text()

    play(scenario, root)


def test_marks_and_notes_are_kept(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 1)
        await stage.press("3", "b")
        assert " bad " in stage.lines()[2]
        await stage.press("n")
        await stage.press(*"hair on it", "enter")
        assert "Note: hair on it" in stage.text()
        await stage.press("g")
        (entry,) = stage.instrument.history().scans
        assert (entry.mark.opinion, entry.mark.note) == ("good", "hair on it")
        await stage.press("u")
        (entry,) = stage.instrument.history().scans
        assert (entry.mark.opinion, entry.mark.note) == (None, "hair on it")

    play(scenario, root)


def test_an_offloaded_scan_is_labelled(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 1)
        (scan,) = stage.store.scans().bundles
        manifest = (scan.directory / "scan.json").read_bytes()
        receipt = Receipt(
            kind="scans",
            bundle_id=scan.scan_id,
            manifest_sha256=sha256_bytes(manifest),
            host="desk",
            verified=stage.store.wall_time(),
        )
        replace_file(root / RECEIPTS / receipt_name(scan.scan_id), encode_record(receipt))
        await stage.press("3")
        assert " yes" in stage.lines()[2]
        assert "verified on a workstation" in stage.text()

    play(scenario, root)


def test_no_scans_yet(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("3")
        assert "No scans yet." in stage.text()
        await stage.press("g", "n", "p", "down")
        assert stage.app.current_mode == "scans"

    play(scenario, root)


def test_a_damaged_scan_is_named_and_the_others_are_shown(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 2)
        broken = sorted((root / "scans").iterdir())[0]
        (broken / "scan.json").write_text("{")
        await stage.press("3")
        assert "! " in stage.text()
        assert broken.name in stage.text().replace(" ", "")
        assert "> 2 " in stage.text()

    play(scenario, root)


def test_a_quick_look_that_is_gone_is_explained(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 1)
        (scan,) = (root / "scans").iterdir()
        (scan / "quick-look-um.tif").write_bytes(b"no picture")
        await stage.press("3")
        assert "cannot be read" in stage.text()

    play(scenario, root)


def test_a_mark_that_cannot_be_stored_is_not_shown(
    play: Callable[..., None], root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 1)
        await stage.press("3")
        (root / "marks").write_text("in the way")
        await stage.press("g")
        assert "! " in stage.text()
        assert "cannot be stored" in stage.text()

    play(scenario, root)


def test_the_profile_takes_the_arrow_keys_and_gives_them_back(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 2)
        await stage.press("3")  # keys of the relief act once it is read
        await stage.press("p", "down")
        assert "▲" in stage.text()
        assert stage.lines()[2].lstrip().startswith("> ")
        await stage.press("p", "down")
        assert "▲" not in stage.text()
        assert stage.lines()[3].lstrip().startswith("> ")

    play(scenario, root)


def test_a_terminal_without_graphics_is_reported(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 1)
        await stage.press("3")
        await stage.press("v")
        assert "! This terminal has no graphics" in stage.text()

    play(scenario, root)


def test_scans_are_found_and_sorted(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        for part in ("nut", "bolt", "lid"):
            await stage.press("1", "j", "tab", *["backspace"] * 4, *part, "enter", "enter")
            await _scan(stage, 1)
        await stage.press("3", "slash", *"bolt", "enter")
        assert "1 with 'bolt'" in stage.text()
        assert "Part bolt" in stage.text()
        assert "lid" not in "".join(stage.lines()[2:6])
        await stage.press("slash", *" #9", "enter")
        assert "No such scan" in stage.text()
        await stage.press("slash", *["backspace"] * 7, "enter")
        await stage.press("s", "s")
        assert "Sorted by part." in stage.text()
        parts = [word for line in stage.lines()[2:6] for word in line.split() if word in ("nut", "bolt", "lid")]
        assert parts == ["bolt", "lid", "nut"]

    play(scenario, root)


def test_a_scan_is_deleted_and_brought_back(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await _scan(stage, 2)
        await stage.press("3", "x")
        assert "Scan #2 is deleted: z brings it back until power off." in stage.text()
        assert [entry.counter for entry in stage.instrument.history().scans] == [1]
        await stage.press("x")
        assert "No scans yet." in stage.text()
        await stage.press("z", "z")
        assert [entry.counter for entry in stage.instrument.history().scans] == [2, 1]
        await stage.press("z")
        assert "no scan was deleted" in stage.text()

    play(scenario, root)


def test_a_movie_shows_contact_and_depth_over_the_press(play: Callable[..., None], root: Path) -> None:
    async def scenario(stage: Stage) -> None:
        await stage.press("m", "m", "m")
        await stage.object_pressed()
        stage.instrument.press()
        await stage.live(260)
        await stage.press("3")
        (line,) = [line for line in stage.lines() if "Contact " in line]
        assert " %, depth " in line
        assert line.rstrip().endswith("µm")

    play(scenario, root)
