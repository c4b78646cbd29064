"""Memory of the device's program with a scan in flight, at the frame size of the board with the least memory."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from device.acquisition.calibrate import calibrate
from device.acquisition.capture import capture
from device.acquisition.scanner import Scanner
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.interfaces import PressObject
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware

ROOT = Path(__file__).parents[3]
MAX_MB = 180.0
"""Of the 512 MB of a Zero 2 W, the camera's contiguous memory takes 256 and the system some 60."""

SCAN_ALONE = """
import re, sys
from pathlib import Path
import numpy as np
import device.instrument.instrument, hal.drivers.board_hardware
from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.frame import CameraSettings, RawFrame
from hal.hardware import Hardware
from hal.interfaces import PowerReading

class Part:
    def __enter__(self): return self
    def __exit__(self, *exc): pass
    def show(self, cue): pass
    def off(self): pass
    def ask(self, request): pass
    def read(self): return PowerReading()
    def faults(self): return ()

class Lights(Part):
    names, max_ma = ("red", "green", "blue"), 57.0
    def granted_ma(self, currents_ma): return dict(currents_ma)
    def switch_on(self, currents_ma): pass

class Camera(Part):
    camera_id = "a frame from a file"
    def __init__(self, path, clock):
        self.path, self.clock = path, clock
        self.shape = tuple(np.load(path)["shape"].tolist())
    def apply(self, settings): pass
    def next_frame(self, timeout_s):
        with np.load(self.path) as kept:
            settings = CameraSettings(*kept["granted"].tolist())
            self.clock.sleep(0.1)
            levels = kept["levels"].tolist()
            return RawFrame(kept["mosaic"], "RGGB", levels[0], levels[1], settings, self.clock.monotonic_ns())

board, root, frame, scans = sys.argv[1:]
clock = VirtualClock(start_ns=10**9)
part = Part()
hardware = Hardware(load_board_profile(board), Camera(frame, clock), Lights(), part, part, part, part, clock)
scanner = Scanner(hardware, BundleStore(Path(root), clock, boot_id="b0075e22"))
for _ in range(int(scans)):
    scanner.scan(Annotations())
status = Path("/proc/self/status").read_text()
print(*(int(re.search(rf"{name}:\\s+(\\d+)", status)[1]) / 1e3 for name in ("VmHWM", "VmRSS")))
assert not {"numba", "textual", "hal.simulator"} & set(sys.modules), "more is imported than the device needs"
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the peak of memory is read from /proc")
def test_a_scan_in_flight_leaves_a_zero_2_w_its_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sensor = load_board_profile("zero2w-imx708").sensor
    text = (ROOT / "board" / "twin.toml").read_text(encoding="utf-8")
    sizes = (("columns", sensor.columns), ("rows", sensor.rows), ("pixel_pitch_um", 17.5e3 / sensor.columns))
    for key, value in sizes:
        text = re.sub(rf"^{key} = \S+", f"{key} = {value}", text, count=1, flags=re.MULTILINE)
    board = tmp_path / "board.toml"
    board.write_text(text, encoding="utf-8")
    with twin_hardware(build(load_board_profile(str(board)), VirtualClock(start_ns=5_000_000_000))) as hardware:
        store = BundleStore(tmp_path / "store", hardware.clock, boot_id="b0075e1f")
        calibrate(hardware, store, 3.0, lambda _: None)
        hardware.operator.ask(PressObject("coin"))
        hardware.button.wait_for_press(None)
        frame = capture(hardware, Scanner(hardware, store).plan)
    granted = (frame.granted.exposure_us, frame.granted.analogue_gain)
    levels = (frame.black_level_dn, frame.white_level_dn)
    np.savez(tmp_path / "frame.npz", mosaic=frame.mosaic, granted=granted, levels=levels, shape=frame.shape)
    ran = subprocess.run(
        [sys.executable, "-c", SCAN_ALONE, board, tmp_path / "store", tmp_path / "frame.npz", "3"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert ran.returncode == 0, ran.stderr
    peak_mb, resident_mb = (float(word) for word in ran.stdout.split())
    with capsys.disabled():
        size = f"{frame.shape[1]} x {frame.shape[0]}"
        sys.stdout.write(f"\nthree scans of {size}: at most {peak_mb:.0f} MB resident, {resident_mb:.0f} after\n")
    assert peak_mb <= MAX_MB
