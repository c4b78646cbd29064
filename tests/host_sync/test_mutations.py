"""Bundles, frame sets and images that were changed at random: each is read, or refused by name, in bounded memory.

The gate tries some; `-m slow` tries a hundred thousand.
"""

from __future__ import annotations

import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import cv2
import numpy as np
import pytest
import tifffile

from device.bundles.bundle import Receipt
from device.bundles.calibration import CalibrationBundle, read_calibration
from device.bundles.raw_frame import read_raw
from device.bundles.record import checksum_name, decode_record, manifest_checksum
from device.bundles.scan import ScanBundle, read_scan
from device.errors import DeviceError
from device.inverse_map.model import InverseMap, read_model
from device.pairing import Answer, Call, DeviceCard, HostCard, Opening
from device.store.device_id import DeviceState
from device.store.registry_file import ActiveCalibration
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.errors import HostError
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.linear_light import read_frame
from host_sync.library.index import Query, search
from host_sync.library.library import Library
from host_sync.offload.paired_devices import PairedDevice, SyncState
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource

Case = Callable[[np.random.Generator], None]
LONGEST_S = 20
MAX_GROWTH_KB = 700_000
TEXTS = (b"null", b"-1", b"1e999", b"18446744073709551616", b'"../../x"', b"[[[[", b'"\\u0000"', b"{}", b"true", b"0.0")
SMALL_RECORDS = (
    ActiveCalibration,
    DeviceState,
    Receipt,
    Call,
    Answer,
    Opening,
    HostCard,
    DeviceCard,
    PairedDevice,
    SyncState,
)


class TookTooLong(BaseException):
    """Not an error that a reader could take for bad input."""


@pytest.fixture(autouse=True)
def alarm() -> Iterator[None]:
    """Each mutation re-arms it; what takes too long ends the test."""

    def ring(_: int, __: FrameType | None) -> None:
        raise TookTooLong

    before = signal.signal(signal.SIGALRM, ring)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The data with one to four changes: bits, bytes, cuts, repetitions, other people's numbers."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at = int(rng.integers(0, max(len(changed), 1)))
        span = int(rng.integers(1, 64))
        match rng.integers(0, 7):
            case 0 | 1:
                changed[at : at + 1] = bytes([changed[at] ^ (1 << int(rng.integers(8)))]) if changed else b"\0"
            case 2:
                changed[at : at + span] = rng.bytes(span)
            case 3:
                del changed[at:]
            case 4:
                changed[at:at] = changed[at : at + span]
            case 5:
                del changed[at : at + span]
            case _:
                numbers = [i for i in range(len(changed)) if changed[i : i + 2] == b": "] or [at]
                at = numbers[int(rng.integers(len(numbers)))]
                changed[at : at + 6] = b": " + TEXTS[int(rng.integers(len(TEXTS)))]
    return bytes(changed)


def refused_or_read(read: Callable[[], object]) -> None:
    signal.alarm(LONGEST_S)
    try:
        read()
    except (DeviceError, HostError) as error:
        assert str(error)  # noqa: PT017


def resealed(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    path.with_name(checksum_name(path.name)).write_bytes(manifest_checksum(path.name, data))


@pytest.fixture
def cases(
    tmp_path: Path,
    store: BundleStore,
    publish_scan: Callable[..., ScanBundle],
    publish_calibration: Callable[[BundleStore], CalibrationBundle],
) -> dict[str, tuple[Case, int]]:
    """Each kind of input, and its share of all tries in percent."""
    calibration, scan = publish_calibration(store), publish_scan(store)
    other = BundleStore(tmp_path / "other", VirtualClock(), boot_id="b0071d01")
    offered = publish_scan(other)
    manifests = {path: path.read_bytes() for path in (scan.directory / "scan.json", offered.directory / "scan.json")}
    calibration_manifest = (calibration.directory / "calibration.json").read_bytes()
    raw = scan.path("raw.tif").read_bytes()
    model = InverseMapFile(tmp_path)
    frames = FrameSetFiles(tmp_path / "frames")
    library = Library(store.root)

    def scan_manifest(rng: np.random.Generator) -> None:
        resealed(scan.directory / "scan.json", mutated(manifests[scan.directory / "scan.json"], rng))
        refused_or_read(lambda: read_scan(scan.directory).verify())

    def calibration_record(rng: np.random.Generator) -> None:
        resealed(calibration.directory / "calibration.json", mutated(calibration_manifest, rng))
        refused_or_read(lambda: read_calibration(calibration.directory).verify())

    def raw_file(rng: np.random.Generator) -> None:
        path = tmp_path / "mutated.tif"
        path.write_bytes(mutated(raw, rng))
        refused_or_read(lambda: read_raw(path, (32, 48)))

    def small_record(rng: np.random.Generator) -> None:
        kind = SMALL_RECORDS[int(rng.integers(len(SMALL_RECORDS)))]
        data = b'{"schema": "' + str(kind.__struct_config__.tag).encode() + b'", "device_id": "rg1", "counter": 3}'
        refused_or_read(lambda: decode_record(mutated(data, rng), kind, "record"))

    def pulled(rng: np.random.Generator) -> None:
        resealed(offered.directory / "scan.json", mutated(manifests[offered.directory / "scan.json"], rng))
        target = tmp_path / "library"
        refused_or_read(lambda: pull(DirectorySource(other.root), Library(target)))
        refused_or_read(lambda: search(Library(target), Query()))
        shutil.rmtree(target, ignore_errors=True)

    def indexed(rng: np.random.Generator) -> None:
        path = library.root / "index.sqlite3"
        search(library, Query())
        path.write_bytes(mutated(path.read_bytes(), rng))
        refused_or_read(lambda: search(library, Query()))

    return {
        "frame set": (frames.try_one, 10),
        "model": (model.try_one, 8),
        "pull": (pulled, 2),
        "index": (indexed, 1),
        "raw file": (raw_file, 14),
        "scan manifest": (scan_manifest, 25),
        "calibration manifest": (calibration_record, 20),
        "small record": (small_record, 20),
    }


class InverseMapFile:
    """A model file and what is tried on it."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "model.npz"
        with self._path.open("wb") as stream:
            np.savez(
                stream, allow_pickle=False, shape=np.array([32, 48]), degrees=np.array([2, 1]), coefficients=np.ones(9)
            )
        self._data = self._path.read_bytes()

    def try_one(self, rng: np.random.Generator) -> None:
        self._path.write_bytes(mutated(self._data, rng))
        refused_or_read(lambda: read_model(self._path))


class FrameSetFiles:
    """A frame set with an image of each kind; its text or one image is changed at a time."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        image = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
        for name in ("a.png", "b.jpg"):
            assert cv2.imwrite(str(folder / name), image)
        tifffile.imwrite(folder / "c.tif", image, photometric="rgb", compression="zlib")
        (folder / "set.toml").write_text(
            'name = "x"\npixel_pitch_um = 10.0\nencoding = "linear"\n[reference]\nimage = "a.png"\n'
            '[[press]]\nimage = "b.jpg"\nball_radius_mm = 0.1\n[[scan]]\nname = "s"\nimage = "c.tif"\n'
        )
        self._files = {path: path.read_bytes() for path in sorted(folder.iterdir())}
        self._set = folder / "set.toml"

    def try_one(self, rng: np.random.Generator) -> None:
        path = list(self._files)[int(rng.integers(len(self._files)))]
        path.write_bytes(mutated(self._files[path], rng))
        refused_or_read(self._read)
        path.write_bytes(self._files[path])

    def _read(self) -> None:
        frame_set = load_frame_set(self._set)
        for frame in (frame_set.reference, *(press.frame for press in frame_set.presses), frame_set.scans[0].frame):
            if frame is not None:
                read_frame(frame)


def try_all(cases: dict[str, tuple[Case, int]], tries: int, seed: int) -> None:
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rng = np.random.default_rng(seed)
    for case, percent in cases.values():
        for _ in range(max(1, tries * percent // 100)):
            case(rng)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < MAX_GROWTH_KB


def test_some_mutations(cases: dict[str, tuple[Case, int]]) -> None:
    try_all(cases, 1000, seed=11)


@pytest.mark.slow
def test_a_hundred_thousand_mutations(cases: dict[str, tuple[Case, int]]) -> None:
    try_all(cases, 100_000, seed=12)


def test_a_model_that_asks_for_absurd_degrees_is_refused(calibrated_root: Path) -> None:
    (path,) = calibrated_root.glob("calibrations/*/inverse-map.npz")
    with np.load(path) as stored:
        arrays = dict(stored)
    InverseMap.from_arrays(arrays, "model")
    with pytest.raises(DeviceError, match="degrees 1000000000"):
        InverseMap.from_arrays(arrays | {"degrees": np.array([10**9, 10**9])}, "model")
