"""Bundles for every part that reads or writes them: small frames, virtual time, a store in a temporary folder."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from limits import WAIT_S, limited_waits, pytest_runtest_makereport  # noqa: F401
from workers import (  # noqa: F401 (hooks of every test)
    pytest_configure,
    pytest_handlecrashitem,
    pytest_unconfigure,
    pytest_xdist_make_scheduler,
)

from device.acquisition.calibrate import calibrate
from device.bundles.calibration import BallRecord, CalibrationBundle, CalibrationRecord, PressRecord, RejectedRecord
from device.bundles.fingerprint import Fingerprint, SettingsRecord
from device.bundles.raw_frame import write_raw
from device.bundles.scan import Annotations, ScanBundle, ScanRecord, VerdictRecord
from device.store.store import BundleStore
from hal.board_profile import BoardProfile, load_board_profile
from hal.clock import VirtualClock
from hal.frame import CameraSettings, RawFrame
from hal.hardware import Hardware
from hal.simulator.bench import SimulatedScene, build
from hal.simulator.hardware import twin_hardware

SHAPE = (32, 48)
ROOT = Path(__file__).parent
LONG_S = 5.0
FROM_THE_FRONT = ("test_house.py", "host_sync", "device", "board", "", "hal")
"""Folders and files of this folder, in the order in which they run; "" is every other."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the type check, and put what compiles kernels first: one process takes files from the front."""
    items.sort(key=_turn)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that take long and are not marked `slow`."""
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, [])]
    long = [one for one in reports if one.duration > LONG_S and "slow" not in one.keywords]
    if long:
        terminalreporter.section(f"longer than {LONG_S:g} s and not marked slow")
    for one in sorted(long, key=lambda one: -one.duration):
        terminalreporter.write_line(f"{one.duration:6.1f} s {one.when} {one.nodeid}")


def _turn(item: pytest.Item) -> int:
    first = item.path.relative_to(ROOT).parts[0]
    return FROM_THE_FRONT.index(first if first in FROM_THE_FRONT else "")


def _frame(seed: int = 0, shape: tuple[int, int] = SHAPE) -> RawFrame:
    mosaic = np.random.default_rng(seed).integers(250, 4096, shape, dtype=np.uint16)
    return RawFrame(mosaic, "RGGB", 256.0, 4095.0, CameraSettings(1998.4, 1.0), 123_456_789_012)


@pytest.fixture
def raw_frame() -> Callable[..., RawFrame]:
    return _frame


@pytest.fixture
def fingerprint() -> Fingerprint:
    profile = load_board_profile("twin")
    return Fingerprint.of(profile, profile.camera.settings, profile.currents_ma)


@pytest.fixture
def store(tmp_path: Path) -> BundleStore:
    return BundleStore(tmp_path / "store", VirtualClock(start_ns=5_000), boot_id="b0071d00")


@pytest.fixture
def scan_record(fingerprint: Fingerprint) -> Callable[..., ScanRecord]:
    def build(store: BundleStore, calibration_id: str | None = None) -> ScanRecord:
        settings = SettingsRecord(exposure_us=2000.0, analogue_gain=1.0)
        return ScanRecord(
            identity=store.next_identity("scans"),
            wall_time=store.wall_time(),
            board="twin",
            pixel_pitch_um=12.0,
            shape=SHAPE,
            gel_id="twin-gel",
            asked=settings,
            granted=settings,
            currents_ma={"red": 6.4, "green": 4.9, "blue": 4.4},
            fingerprint=fingerprint,
            calibration_id=calibration_id,
            verdict=VerdictRecord(level="good", reason="the object touched", figures={"contact_share": 0.4}),
            annotations=Annotations(job="J-7"),
        )

    return build


@pytest.fixture
def publish_scan(scan_record: Callable[..., ScanRecord]) -> Callable[..., ScanBundle]:
    def publish(store: BundleStore, calibration_id: str | None = None) -> ScanBundle:
        record = scan_record(store, calibration_id)

        def write(directory: Path) -> None:
            write_raw(directory / "raw.tif", _frame(record.identity.counter))
            (directory / "preview.png").write_bytes(bytes(range(256)) * 20)

        return store.publish_scan(record, write)

    return publish


@pytest.fixture
def publish_calibration(fingerprint: Fingerprint) -> Callable[[BundleStore], CalibrationBundle]:
    def publish(store: BundleStore) -> CalibrationBundle:
        ball = BallRecord(column=20.0, row=15.0, contact_radius_px=6.0, radius_px=9.0)
        record = CalibrationRecord(
            identity=store.next_identity("calibrations"),
            created=store.wall_time(),
            board="twin",
            gel_id="twin-gel",
            pixel_pitch_um=12.0,
            shape=SHAPE,
            fingerprint=fingerprint,
            reference_file="reference.tif",
            presses=(
                PressRecord(
                    file="press-00.tif",
                    ball_radius_mm=3.0,
                    balls=(ball,),
                    rejected=(RejectedRecord(column=1.0, row=2.0, reason="cut by the border"),),
                ),
            ),
            model_files=("model.npz",),
            figures={"held_out_deg": 0.9, "spread_deg": float("nan")},
        )

        def write(directory: Path) -> None:
            write_raw(directory / "reference.tif", _frame(100))
            write_raw(directory / "press-00.tif", _frame(101))
            np.savez(directory / "model.npz", coefficients=np.ones(3))

        return store.publish_calibration(record, write)

    return publish


@pytest.fixture(scope="session")
def small_board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference twin with a quarter of its resolution over the same field, as a file."""
    text = (Path(__file__).parents[1] / "board" / "twin.toml").read_text(encoding="utf-8")
    for key, value in (("columns", "364"), ("rows", "272"), ("pixel_pitch_um", "48.0")):
        text = re.sub(rf"^{key} = \S+", f"{key} = {value}", text, count=1, flags=re.MULTILINE)
    path = tmp_path_factory.mktemp("board") / "small-twin.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def small_twin(small_board: Path) -> BoardProfile:
    """The board profile in that file."""
    return load_board_profile(str(small_board))


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all processes of this run of the tests share."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def calibrated_root(shared_folder: Path, small_twin: BoardProfile) -> Path:
    """A store with an active calibration of the small twin, made once; tests work on copies of it."""
    root, unfinished = shared_folder / "calibrated", shared_folder / "being calibrated"
    with FileLock(shared_folder / "calibrated.lock", timeout=WAIT_S):
        if not root.exists():
            hardware = twin_hardware(build(small_twin, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0)))
            with hardware:
                calibrate(hardware, BundleStore(unfinished, hardware.clock, boot_id="b0075e1f"), 3.0, lambda _: None)
            unfinished.rename(root)
    return root


@pytest.fixture
def bench(small_twin: BoardProfile) -> SimulatedScene:
    """A world of the small twin, in virtual time."""
    return build(small_twin, VirtualClock(start_ns=5_000_000_000, wall_start_s=1_000.0))


@pytest.fixture
def hardware(bench: SimulatedScene) -> Hardware:
    """The devices of that world."""
    return twin_hardware(bench)


@pytest.fixture
def calibrated(calibrated_root: Path, tmp_path: Path, hardware: Hardware) -> BundleStore:
    """A store of its own with an active calibration of the small twin."""
    root = tmp_path / "calibrated"
    shutil.copytree(calibrated_root, root)
    return BundleStore(root, hardware.clock, boot_id="b0075e1f")
