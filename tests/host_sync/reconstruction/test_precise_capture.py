"""A scan with frames under no light and under each light alone: ambient light is taken out, and shadows are seen."""

import shutil
from pathlib import Path

import numpy as np

from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations, ScanBundle
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from hal.simulator.surfaces import Sphere
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.library.library import Library
from host_sync.reconstruction.pipeline import Reconstruction
from host_sync.reconstruction.scans import SINGLE_LIGHTS, LibraryReconstructor

AMBIENT = 0.04


def test_ambient_light_is_taken_out_where_the_scan_holds_a_dark_frame(
    calibrated_root: Path, calibrator: Calibrator, small_twin: BoardProfile, tmp_path: Path
) -> None:
    root = tmp_path / "library"
    shutil.copytree(calibrated_root, root)
    bench = build(small_twin, VirtualClock())
    shown = specimen("coin")
    scans: dict[str, ScanBundle] = {}
    with twin_hardware(bench) as hardware:
        scanner = Scanner(hardware, BundleStore(root, hardware.clock, boot_id="b0075e21"))
        bench.place(Press(shown.surface, (0.0, 0.0), 0.0, shown.indentation_mm))
        scans["in the dark"] = scanner.publish(scanner.assess(scanner.capture()), Annotations()).bundle
        bench.faults.ambient = AMBIENT
        scans["in daylight"] = scanner.publish(scanner.assess(scanner.capture()), Annotations()).bundle
        precise = scanner.publish(scanner.assess(scanner.capture(mode="lights")), Annotations())
        scans["each light"] = precise.bundle
    job = LibraryReconstructor(Library(root), force=True, calibrator=calibrator)
    results = {name: job.run(scan)[0] for name, scan in scans.items()}
    true_um = results["in the dark"].height.z_um
    off_um = {name: float(np.nanstd(found.height.z_um - true_um)) for name, found in results.items()}
    print(off_um)  # noqa: T201
    assert off_um["each light"] < 0.2 * off_um["in daylight"]
    checks = {check.name: check.value for check in results["each light"].frame_checks}
    assert abs((checks["ambient light taken out"] or 0.0) - AMBIENT) < 0.004
    assert "ambient light taken out" not in {check.name for check in results["in daylight"].frame_checks}
    assert results["in daylight"].warnings
    assert not results["each light"].warnings


def test_single_lights_show_where_a_light_is_hidden(
    calibrated_root: Path, calibrator: Calibrator, small_twin: BoardProfile, tmp_path: Path
) -> None:
    root = tmp_path / "library"
    shutil.copytree(calibrated_root, root)
    bench = build(small_twin, VirtualClock())
    with twin_hardware(bench) as hardware:
        scanner = Scanner(hardware, BundleStore(root, hardware.clock, boot_id="b0075e21"))
        bench.place(Press(Sphere(3.0), (2.5, 1.5), 0.0, 0.9))
        precise = scanner.publish(scanner.assess(scanner.capture(mode="lights")), Annotations())
        truth = bench.truth()
    job = LibraryReconstructor(Library(root), force=True, calibrator=calibrator)
    with_lights = job.run(precise.bundle)[0]
    exposures = precise.bundle.record.exposures
    torn = precise.bundle.path(next(iter(exposures.alone_files.values())))
    torn.chmod(0o644)
    torn.write_bytes(torn.read_bytes()[:1000])
    again = job.run(precise.bundle)[0]
    beside = ~truth.contact & (np.hypot(truth.p, truth.q) > 0.05)

    def slopes_off(found: Reconstruction) -> float:
        return float(np.sqrt(np.nanmean(np.hypot(found.p - truth.p, found.q - truth.q)[beside] ** 2)))

    print(slopes_off(with_lights), slopes_off(again))  # noqa: T201
    assert slopes_off(with_lights) < 0.0095, "0.0104 where a lamp that a ray grazes was counted on"
    assert slopes_off(with_lights) < 1.03 * slopes_off(again), "rays say nearly the same"
    assert {check.name: check.outcome for check in with_lights.frame_checks}[SINGLE_LIGHTS] == "passed"
    said = {check.name: check.words for check in again.frame_checks}
    assert "cannot be read" in said[SINGLE_LIGHTS]
