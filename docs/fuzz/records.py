"""Coverage-guided fuzzing of everything that reads what others wrote: manifests, raw frames, models, pairing's records.

usage: python docs/fuzz/records.py SECONDS

Wants atheris (x86-64, the extra `fuzz`). It begins with the golden bundles and ends with 0 when every input was read or
refused with a typed error.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["device", "host_sync", "tifffile", "numpy.lib"]):
    from device.active_calibration import ActiveCalibration
    from device.calibration_bundle import decode_calibration
    from device.device_identity import DeviceState
    from device.errors import DeviceError
    from device.model_file import read_model
    from device.pairing_exchange import DeviceCard, Element, HostCard
    from device.raw_file import read_raw
    from device.receipts import Receipt
    from device.records import decode_record
    from device.scan_bundle import decode_scan
    from host_sync.errors import HostError
    from host_sync.offload.paired_devices import PairedDevice, SyncState

GOLDEN = Path(__file__).parent.parent.parent / "tests" / "golden"
SMALL = (ActiveCalibration, DeviceState, Receipt, Element, HostCard, DeviceCard, PairedDevice, SyncState)
SHAPE = (90, 120)
SEEDED = {0: "scan.json", 1: "calibration.json", 2: "*.tif", 3: "*.npz", 4: "*.json"}
"""Which golden files each reader begins with; an input's first byte says which reader gets the rest."""


def readers(folder: Path) -> tuple[Callable[[bytes], object], ...]:
    """What is tried, by number."""
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
    )


def write_seeds(corpus: Path) -> None:
    """The golden files as inputs to begin with."""
    for number, pattern in SEEDED.items():
        for index, path in enumerate(sorted(GOLDEN.rglob(pattern))):
            (corpus / f"{number}-{index}").write_bytes(bytes([number]) + path.read_bytes())


def main(seconds: int) -> None:
    """Fuzz for so long; a crash is an error that is not typed."""
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
