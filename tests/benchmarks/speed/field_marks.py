"""The handheld's start, answers, processor time at rest and memory on the twin in real time, without the twin's part.

usage: python -m tests.benchmarks.speed.field_marks STORE

STORE holds a calibration of the twin (`retroscan --board twin --store STORE calibrate`). It takes three minutes: the
lights go off after two. Time and processor time of exposing frames, and the memory of the scene, are subtracted.
"""

from __future__ import annotations

import time

BEGAN_S = time.monotonic()

import asyncio  # noqa: E402
import os  # noqa: E402
import statistics  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

from hal.board_profile import load_board_profile  # noqa: E402
from hal.clock import SystemClock  # noqa: E402
from hal.frame import CameraSettings, RawFrame  # noqa: E402
from hal.simulator.bench import SimulatedScene  # noqa: E402
from hal.simulator.hardware import twin_hardware  # noqa: E402

SETTLE_S = 5.0
MEASURED_S = 10.0
ANSWERS = 5


class TimedScene(SimulatedScene):
    """A world that keeps count of what it costs: `spent_s` wall time, `cpu_s` processor time."""

    spent_s = 0.0
    cpu_s = 0.0

    def expose(self, index: int, began_ns: int, settings: CameraSettings) -> RawFrame:
        """The frame, timed."""
        wall_s, cpu_s = time.monotonic(), time.thread_time()
        try:
            return super().expose(index, began_ns, settings)
        finally:
            self.spent_s += time.monotonic() - wall_s
            self.cpu_s += time.thread_time() - cpu_s


def resident_mb() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def answered_s(argument: str) -> tuple[float, float]:
    """Median time and mean processor time (s) of a new process that answers `retroscan` with this argument."""
    program = f"import sys; from device.cli.main import main; sys.exit(main([{argument!r}]))"
    spent_s, before_s = [], children_cpu_s()
    for _ in range(ANSWERS):
        began_s = time.monotonic()
        subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.DEVNULL)
        spent_s.append(time.monotonic() - began_s)
    return statistics.median(spent_s), (children_cpu_s() - before_s) / ANSWERS


def children_cpu_s() -> float:
    """Processor time of ended child processes, s."""
    times = os.times()
    return times.children_user + times.children_system


async def load_of(bench: TimedScene) -> float:
    """Fraction of a core that the instrument and its screens take, without the scene's."""
    began_s, cpu_s, twin_s = time.monotonic(), time.process_time(), bench.cpu_s
    await asyncio.sleep(MEASURED_S)
    used_s = time.process_time() - cpu_s - (bench.cpu_s - twin_s)
    return used_s / (time.monotonic() - began_s)


async def measure(
    bench: TimedScene, store_folder: Path, scene_mb: float, rendered_s: float, rendered_cpu_s: float
) -> str:
    """Start the screens over the instrument, and print every mark; returns why it cannot, or an empty text."""
    from device.cli.screens import InstrumentThread
    from device.cli.service import SdNotify, ServiceReport
    from device.instrument.instrument import Instrument
    from device.store.store import BundleStore
    from device.tui.screens.app import RetroscanApp
    from device.tui.screens.panels import ProgramInfo

    hardware = twin_hardware(bench)
    instrument = Instrument(hardware, BundleStore(store_folder, hardware.clock))
    report = ServiceReport(SdNotify.from_environment({}), hardware.clock)
    with InstrumentThread(instrument, report) as thread:
        program, sensor = ProgramInfo("0", store_folder), bench.profile.sensor
        app = RetroscanApp(instrument, program, "full", sensor, True, lambda: thread.has_ended)
        shown = asyncio.create_task(app.run_async(headless=True, size=(100, 30)))
        while instrument.state.live is None or not app.is_running:
            await asyncio.sleep(0.01)
        if fault := instrument.state.calibration.fault:
            app.exit()
            await shown
            return f"{store_folder}: no calibration to measure with: {fault}"
        started_s = time.monotonic() - BEGAN_S - rendered_s - bench.spent_s
        cpu_s = time.process_time() - rendered_cpu_s - bench.cpu_s
        sys.stdout.write(f"start to live picture: {started_s:.2f} s, {cpu_s:.2f} s of processor time (mark 2.5)\n")
        await asyncio.sleep(SETTLE_S)
        app.simulate_key("4")
        await asyncio.sleep(1.0)
        sys.stdout.write(f"Set-up, lights on: {await load_of(bench):.1%} of a core (mark 5 %)\n")
        sys.stdout.write(f"resident: {resident_mb() - scene_mb:.0f} MB (mark 180)\n")
        sys.stdout.flush()
        while instrument.state.live is not None:
            await asyncio.sleep(1.0)
        sys.stdout.write(f"Set-up, asleep: {await load_of(bench):.1%} of a core (mark 2 %)\n")
        app.exit()
        await shown
    return ""


def main() -> int:
    """Print every mark; 2 where the store is none to measure with."""
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.stderr.write("name a folder that holds a calibration of the twin: field_marks STORE\n")
        return 2
    before_s, before_cpu_s = time.monotonic(), time.process_time()
    profile = load_board_profile("twin")
    before_mb = resident_mb()
    bench = TimedScene(profile, SystemClock(), 1)
    bench.drive(profile.currents_ma)
    bench.expose(0, bench.clock.monotonic_ns(), profile.camera.settings)
    scene_mb = resident_mb() - before_mb
    rendered_s, rendered_cpu_s = time.monotonic() - before_s, time.process_time() - before_cpu_s
    bench.spent_s = bench.cpu_s = 0.0
    fault = asyncio.run(measure(bench, Path(sys.argv[1]), scene_mb, rendered_s, rendered_cpu_s))
    if fault:
        sys.stderr.write(f"{fault}\n")
        return 2
    for argument in ("--version", "--help"):
        spent_s, cpu_s = answered_s(argument)
        sys.stdout.write(f"{argument}: {spent_s:.2f} s, {cpu_s:.2f} s of processor time (mark 0.3)\n")
    sys.stdout.write(f"load of the machine over the last minute: {os.getloadavg()[0]:.1f}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
