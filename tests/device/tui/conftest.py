"""The screens over a twin in virtual time: tests step the instrument, press keys, and read what is shown."""

from __future__ import annotations

import asyncio
import base64
import os
import re
import shutil
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock
from xml.etree import ElementTree

import pytest
from textual.pilot import Pilot

from device.instrument.demo_faults import DemoDisk, DemoFaults
from device.instrument.instrument import Instrument
from device.machine.interfaces import Machine
from device.pairing_service import PairingSetup
from device.store.store import BundleStore
from device.tui.drawing.cells import ColourDepth
from device.tui.screens.app import RetroscanApp
from device.tui.screens.panels import ProgramInfo
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import ButtonPress
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware

SVG = "{http://www.w3.org/2000/svg}"
SVG_COLUMN = 12.2
"""Width of a cell in an exported picture."""

ROW_OF_RUN = re.compile(r"-line-(\d+)\)$")
OBJECTS = ("coin", "texture", "sphere-grid", "sinusoid", "step", "groove")
PROGRAM = ProgramInfo("0.1.0", Path("/var/lib/retroscan"))


@dataclass
class Stage:
    """The running app, and the world behind it."""

    app: RetroscanApp
    pilot: Pilot[str]
    instrument: Instrument
    bench: SimulatedScene
    store: BundleStore
    shown: int = 0

    async def live(self, steps: int = 1) -> None:
        """Let the instrument take some steps (about 17 ms each) and show the result."""
        for _ in range(steps):
            self.instrument.step()
        await self.show()

    async def show(self) -> None:
        """Show the present state."""
        await self.app.show_state()
        self.app.show_live()
        await self.settle()

    async def settle(self) -> None:
        """Wait for workers and messages."""
        await self.pilot.pause()
        while list(self.app.workers):
            await self.app.workers.wait_for_complete()
            await self.pilot.pause()

    async def press(self, *keys: str) -> None:
        """Press keys and show the result."""
        await self.pilot.press(*keys)
        await self.settle()
        await self.show()

    async def push(self, held_s: float = 0.1) -> None:
        """Push the instrument's button for `held_s` and show the result."""
        self.bench.schedule_button(ButtonPress(self.bench.clock.monotonic_ns(), held_s))
        self.bench.clock.sleep(held_s + 0.01)
        await self.live(2)

    async def object_pressed(self) -> None:
        """Have the twin's operator scan its next object, until the verdict is shown, and press it once more."""
        for _ in range(24):  # untouched skin, for the lights
            self.instrument.step()
        self.instrument.demonstrate(OBJECTS[self.shown % len(OBJECTS)])  # key d leaves the push to the user
        self.shown += 1
        await self.live()
        pressed = self.bench.pressed
        self.bench.clock.sleep(1.0)
        for _ in range(30):  # the operator lifts, and the lights are checked
            self.instrument.step()
        self.bench.place(pressed)
        await self.live(3)

    def lines(self) -> list[str]:
        """What the screen shows, row by row, read from the picture that textual exports."""
        columns, rows = self.app.size
        shown = [[" "] * columns for _ in range(rows)]
        for run in ElementTree.fromstring(self.app.export_screenshot()).iter(f"{SVG}text"):  # noqa: S314 (our own)
            if row := ROW_OF_RUN.search(run.get("clip-path", "")):
                first = round(float(run.get("x", "0")) / SVG_COLUMN)
                text = (run.text or "").replace("\N{NO-BREAK SPACE}", " ")
                shown[int(row[1])][first : first + len(text)] = text
        return ["".join(row).rstrip() for row in shown]

    def text(self) -> str:
        """The screen as one text with runs of blanks shortened."""
        return " ".join(" ".join(self.lines()).split())


Scenario = Callable[[Stage], Awaitable[None]]


@pytest.fixture
def bench(small_twin: BoardProfile) -> SimulatedScene:
    return build(small_twin, VirtualClock(start_ns=5_000_000_000, wall_start_s=2_000.0))


@pytest.fixture
def empty_root(tmp_path: Path) -> Path:
    return tmp_path / "store"


@pytest.fixture
def root(calibrated_root: Path, empty_root: Path) -> Path:
    shutil.copytree(calibrated_root, empty_root)
    return empty_root


@pytest.fixture
def host_key(tmp_path: Path) -> Path:
    """The public key of an SSH server."""
    path = tmp_path / "ssh_host_ed25519_key.pub"
    key = b"\0\0\0\x0bssh-ed25519\0\0\0 " + bytes(range(32))
    path.write_text(f"ssh-ed25519 {base64.b64encode(key).decode()} root@retroscan\n")
    return path


@pytest.fixture
def no_ambient_colour_wishes() -> Iterator[None]:
    """No colour settings of the tester's own terminal."""
    kept = {name: value for name, value in os.environ.items() if name not in {"NO_COLOR", "TEXTUAL_COLOR_SYSTEM"}}
    with mock.patch.dict(os.environ, kept, clear=True):
        yield


@pytest.fixture
def play(bench: SimulatedScene, no_ambient_colour_wishes: None) -> Callable[..., None]:
    """Plays a scenario on a store: `play(scenario, root, size=(80, 24), depth="full")`."""

    def run(
        scenario: Scenario,
        root: Path,
        size: tuple[int, int] = (80, 24),
        depth: ColourDepth = "full",
        host_key: Path = Path("absent.pub"),
        is_demo: bool = False,
        machine: Machine | None = None,
    ) -> None:
        async def on_stage() -> None:
            disk = DemoDisk(root)
            store = BundleStore(root, bench.clock, boot_id="b0075e1f", statvfs=disk)
            pairing = PairingSetup(port=0, host_key=host_key, keys=root.parent)
            with Instrument(twin_hardware(bench), store, pairing=pairing, machine=machine) as instrument:
                faults = DemoFaults(instrument, disk) if is_demo else None
                sensor = bench.profile.sensor
                app = RetroscanApp(instrument, PROGRAM, depth, sensor, is_twin=True, updates_per_s=None, faults=faults)
                async with app.run_test(size=size) as pilot:
                    stage = Stage(app, pilot, instrument, bench, store)
                    await stage.live(5)
                    await scenario(stage)

        wishes = {"NO_COLOR": "1"} if depth == "mono" else {}
        with mock.patch.dict(os.environ, wishes):
            asyncio.run(on_stage())

    return run
