"""Each channel under its own light alone, and why a sequence cannot be used."""

import shutil
from pathlib import Path

import numpy as np

from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations
from device.imaging.flat_field import bin_bayer
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.operator import specimen
from hal.simulator.scene import Press
from host_sync.reconstruction.slope_reading import LightSequence, read_light_sequence


def test_channels_show_their_own_light_without_ambient_light_or_other_lights(
    calibrated_root: Path, small_twin: BoardProfile, tmp_path: Path
) -> None:
    root = tmp_path / "library"
    shutil.copytree(calibrated_root, root)
    bench = build(small_twin, VirtualClock())
    shown = specimen("coin")
    with twin_hardware(bench) as hardware:
        scanner = Scanner(hardware, BundleStore(root, hardware.clock, boot_id="b0075e21"))
        bench.place(Press(shown.surface, (0.0, 0.0), 0.0, shown.indentation_mm))
        plain = scanner.publish(scanner.assess(scanner.capture()), Annotations()).bundle
        bench.faults.ambient = 0.04
        scan = scanner.publish(scanner.assess(scanner.capture(mode="lights")), Annotations()).bundle
        bench.faults.wobble_mm = 0.1
        moved = scanner.publish(scanner.assess(scanner.capture(mode="lights")), Annotations()).bundle
    assert read_light_sequence(plain) == ""
    found = read_light_sequence(scan)
    assert isinstance(found, LightSequence)
    assert set(found.lights) == set(hardware.lights.names)
    all_lights = bin_bayer(scan.lit_frame()).rgb
    assert found.alone.shape == all_lights.shape
    crosstalk = (all_lights - found.alone).mean(axis=(0, 1))
    print(f"mean light {all_lights.mean(axis=(0, 1))}, of which other lights {crosstalk}")  # noqa: T201
    assert (crosstalk > -0.002).all()
    assert float(np.max(crosstalk)) > 0.002
    said = read_light_sequence(moved)
    assert isinstance(said, str)
    assert "moved" in said
    torn = scan.path(scan.record.exposures.alone_files[found.lights[1]])
    torn.chmod(0o644)
    torn.write_bytes(torn.read_bytes()[:1000])
    said = read_light_sequence(scan)
    assert isinstance(said, str)
    assert "cannot be read" in said
