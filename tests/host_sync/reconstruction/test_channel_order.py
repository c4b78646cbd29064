"""Frames in another Bayer order than their calibration's are refused, wherever the calibration comes from."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from emulated_board import emulated_hardware

from device.acquisition.calibrate import calibrate
from device.bundles.raw_frame import write_raw
from device.bundles.scan import ScanBundle, ScanRecord
from device.errors import CalibrationMismatch
from device.store.store import BundleStore
from hal.frame import BayerOrder, RawFrame
from hal.simulator.bench import SimulatedScene, build
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.library.library import Library
from host_sync.reconstruction.scans import LibraryReconstructor


@pytest.mark.slow
def test_frames_that_a_kernel_turned_are_refused_with_a_bundle_and_with_a_file(
    bench: SimulatedScene, store: BundleStore, scan_record: Callable[..., ScanRecord], tmp_path: Path
) -> None:
    sensor = msgspec.structs.replace(bench.profile.sensor, bayer_order="as granted")
    board = emulated_hardware(build(msgspec.structs.replace(bench.profile, sensor=sensor), bench.clock), "PCA9955B")
    with board.hardware as hardware:
        bundle = calibrate(hardware, store, 3.0, lambda _: None).bundle
    calibrator = Calibrator()
    kept = calibrator.of_bundle(bundle)
    assert kept.facts.channel_order == "RGGB"
    file = tmp_path / "gel.calibration"
    kept.write(file)
    library = Library(store.root)

    def scan_in(order: BayerOrder) -> ScanBundle:
        record = msgspec.structs.replace(
            scan_record(store, bundle.calibration_id),
            fingerprint=bundle.record.fingerprint,
            gel_id=bundle.record.gel_id,
            shape=bundle.record.shape,
        )
        frame: RawFrame = replace(bundle.reference(), bayer_order=order)

        def write(directory: Path) -> None:
            write_raw(directory / "raw.tif", frame)
            (directory / "preview.png").write_bytes(b"")

        return store.publish_scan(record, write)

    same, turned = scan_in("RGGB"), scan_in("BGGR")
    for source in (calibrator, Calibrator.of_file(file)):
        job = LibraryReconstructor(library, calibrator=source)
        assert job.calibration_of(same).facts.bundle_id == bundle.calibration_id
        with pytest.raises(CalibrationMismatch, match=r"channel order \(RGGB, not BGGR\)"):
            job.calibration_of(turned)
