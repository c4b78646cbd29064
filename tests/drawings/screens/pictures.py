"""The pictures of docs/screens.md: the screens of the twin, driven by key presses at the size of the 800 x 480 panel.

usage: python -m tests.drawings.screens.pictures --out docs/pictures
"""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from device.acquisition.calibrate import calibrate
from device.bundles.scan import Annotations
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from device.tui.drawing.cells import ColourDepth
from device.tui.screens.app import RetroscanApp
from device.tui.screens.panels import ProgramInfo
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.factory import open_hardware
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware
from tests.device.tui.test_way_back import AT_START
from tests.drawings.screens.terminal_picture import terminal_picture

SIZE = (100, 30)
BALL_RADIUS_MM = 3.0
UNTOUCHED_STEPS = 30
"""Live frames of untouched skin before a press, in which the lights are measured."""

STILL_STEPS = 40

AREA_MM = ("40", "20")
PRESSES_MM = (-11.0, -1.0)
"""An area and where its first presses are, of an object that reaches beyond it."""

TOUCH_MM = (14.0, 2.0)
"""Where the object is under the touch whose way back to the first press is shown."""


@dataclass
class Player:
    """The app and the instrument behind it."""

    app: RetroscanApp
    instrument: Instrument
    out: Path

    async def live(self, steps: int) -> None:
        """Let the instrument take some steps and show what became of them."""
        for _ in range(steps):
            self.instrument.step()
        await self.app.show_state()
        self.app.show_live()

    def save(self, name: str) -> None:
        """Save a picture of the current screen."""
        strips = self.app.screen._compositor.render_strips()
        picture = terminal_picture([list(strip) for strip in strips], SIZE[0])
        picture.save(self.out / f"{name}.png", optimize=True)
        sys.stdout.write(f"{self.out / name}.png\n")


async def play(instrument: Instrument, root: Path, depth: ColourDepth, out: Path) -> None:
    """Scan a coin, look at its profile; then start a calibration and take its first presses."""
    sensor = load_board_profile("twin").sensor
    program = ProgramInfo("0.1.0", root)
    app = RetroscanApp(instrument, program, depth, sensor, is_twin=True, updates_per_s=None)
    async with app.run_test(size=SIZE) as pilot:
        player = Player(app, instrument, out)
        instrument.set_sticky(Annotations(job="J-7", part="coin", operator="Mia"))
        await player.live(UNTOUCHED_STEPS)
        await pilot.press("d")  # the operator presses a coin, pushes the button and lifts
        await player.live(STILL_STEPS)
        await player.live(UNTOUCHED_STEPS)
        await pilot.pause()
        player.save("screen-scan" if depth == "full" else f"screen-scan-{depth}")
        if depth != "full":
            return
        await pilot.press("3")
        await app.workers.wait_for_complete()
        await pilot.press("p", "up", "up", "up")
        await player.live(1)
        await pilot.pause()
        player.save("screen-scans")
        await pilot.press("2", "space")
        await player.live(2)
        for _ in range(6):
            await pilot.press("space")
            await player.live(3)
        await pilot.pause()
        player.save("screen-calibrate")


async def cover(instrument: Instrument, root: Path, bench: SimulatedScene, out: Path) -> None:
    """Cover an area larger than the field with two presses; then look for the way back to the first."""
    app = RetroscanApp(instrument, ProgramInfo("0.1.0", root), "full", bench.profile.sensor, True, updates_per_s=None)
    async with app.run_test(size=SIZE) as pilot:
        player = Player(app, instrument, out)
        await player.live(UNTOUCHED_STEPS)
        await pilot.press("w", *AREA_MM[0], "enter", *AREA_MM[1], "enter")
        await player.live(2)
        for right_mm in PRESSES_MM:
            bench.place(replace(AT_START, centre_mm=(-right_mm, 0.0)))
            await player.live(3)
            await pilot.press("space")
            await player.live(2)
            bench.place(None)
            bench.clock.sleep(1.0)
            await player.live(UNTOUCHED_STEPS)
        await pilot.pause()
        player.save("screen-cover-area")
        await pilot.press("escape", "3")
        await app.workers.wait_for_complete()
        await pilot.press("end", "w")
        await app.workers.wait_for_complete()
        bench.place(replace(AT_START, centre_mm=TOUCH_MM, turn_rad=math.radians(4.0)))
        await player.live(3)
        await pilot.press("space")
        await player.live(2)
        await pilot.pause()
        player.save("screen-way-back")


def main() -> None:
    """Write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    out = parser.parse_args().out
    os.environ.pop("NO_COLOR", None)
    clock = VirtualClock(start_ns=5_000_000_000, wall_start_s=1_790_000_000.0)
    profile = load_board_profile("twin")
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "store"
        with open_hardware(profile, clock) as hardware:
            calibrate(hardware, BundleStore(root, clock), BALL_RADIUS_MM, lambda _: None)
        for depth in ("full", "sixteen"):
            with Instrument(open_hardware(profile, clock), BundleStore(root, clock)) as instrument:
                asyncio.run(play(instrument, root, depth, out))
        bench = build(profile, clock)
        covered = Path(folder) / "covered"
        shutil.copytree(root, covered, ignore=shutil.ignore_patterns("scans"))
        with Instrument(twin_hardware(bench), BundleStore(covered, clock)) as instrument:
            asyncio.run(cover(instrument, covered, bench, out))


if __name__ == "__main__":
    main()
