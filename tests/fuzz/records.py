"""Coverage-guided fuzzing of all readers of foreign data: manifests, raw frames, models, pairing records.

usage: python -m tests.fuzz.records SECONDS

Needs atheris (x86-64, the extra `fuzz`). It starts with the golden bundles and exits with 0 when every input was read
or refused with a typed error.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["device", "host_sync", "tifffile", "numpy.lib"]):
    from device.bundles.bundle import Receipt
    from device.bundles.calibration import decode_calibration
    from device.bundles.raw_frame import read_raw
    from device.bundles.record import decode_record
    from device.bundles.scan import decode_scan
    from device.errors import DeviceError
    from device.inverse_map.model import read_model
    from device.pairing import Answer, Call, DeviceCard, HostCard, Opening
    from device.quick_look.solver import read_rest
    from device.store.device_id import DeviceState
    from device.store.registry_file import ActiveCalibration
    from host_sync.errors import HostError
    from host_sync.offload.paired_devices import PairedDevice, SyncState

GOLDEN = Path(__file__).parent.parent.parent / "tests" / "golden"
SMALL = (ActiveCalibration, DeviceState, Receipt, Call, Answer, Opening, HostCard, DeviceCard, PairedDevice, SyncState)
SHAPE = (90, 120)
SEEDED = {0: "scan.json", 1: "calibration.json", 2: "*.tif", 3: "*.npz", 4: "*.json"}
"""Golden files with which each reader starts; the first byte of an input selects the reader."""


def readers(folder: Path) -> tuple[Callable[[bytes], object], ...]:
    """The readers, by number."""
    path = folder / "input"

    def from_file(read: Callable[[Path], object]) -> Callable[[bytes], object]:
        def write_and_read(data: bytes) -> object:
            path.write_bytes(data)
            return read(path)

        return write_and_read

    return (
        lambda data: decode_scan(data, "scan.json"),
        lambda data: decode_calibration(data, "calibration.json"),
        from_file(lambda path: read_raw(path, SHAPE)),
        from_file(read_model),
        lambda data: decode_record(data, SMALL[len(data) % len(SMALL)], "record"),
        from_file(read_rest),
    )


def write_seeds(corpus: Path) -> None:
    """Write the golden files as initial inputs."""
    for number, pattern in SEEDED.items():
        for index, path in enumerate(sorted(GOLDEN.rglob(pattern))):
            (corpus / f"{number}-{index}").write_bytes(bytes([number]) + path.read_bytes())


def main(seconds: int) -> None:
    """Fuzz for this long; a crash is an untyped error."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    corpus = folder / "corpus"
    corpus.mkdir()
    write_seeds(corpus)
    tried = readers(folder)

    def try_one(data: bytes) -> None:
        if not data:
            return
        try:
            tried[data[0] % len(tried)](data[1:])
        except (DeviceError, HostError):
            return

    limits = [f"-max_total_time={seconds}", "-timeout=10", "-rss_limit_mb=2048", "-max_len=40000"]
    atheris.Setup([sys.argv[0], *limits, f"-artifact_prefix={folder}/", str(corpus)], try_one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(int(sys.argv[1]))
