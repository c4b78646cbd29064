"""Re-hashing a whole library: every bundle is either as it was published, or named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.bundle_layout import MANIFESTS, PARTIAL_SUFFIX, DamagedBundle
from device.calibration_bundle import CalibrationBundle
from device.errors import RecordError
from device.records import seal_name
from device.scan_bundle import ScanBundle
from host_sync.library import RESULTS, Library

_MANIFESTS: Final = frozenset({*MANIFESTS.values(), *(seal_name(name) for name in MANIFESTS.values())})


@dataclass(frozen=True, slots=True)
class Verification:
    """What re-hashing found.

    sound : how many bundles are whole
    damaged : those that are not, and why
    strangers : files inside bundles that no manifest lists; they are nobody's proof and nobody's fault
    unfinished : transfers that wait to go on
    """

    sound: int
    damaged: tuple[DamagedBundle, ...]
    strangers: tuple[Path, ...]
    unfinished: tuple[Path, ...]


def verify_library(library: Library, tell: Callable[[str], None] = lambda _: None) -> Verification:
    """The outcome of hashing every file of every scan and calibration.

    Raises
    ------
    LibraryError
        There is no library, or its folders cannot be read.
    """
    calibrations, scans = library.calibrations(), library.scans()
    damaged = [*calibrations.damaged, *scans.damaged]
    strangers: list[Path] = []
    sound = 0
    bundles: list[ScanBundle | CalibrationBundle] = [*calibrations.bundles, *scans.bundles]
    for bundle in bundles:
        tell(bundle.directory.name)
        try:
            bundle.verify()
            sound += 1
        except RecordError as error:
            damaged.append(DamagedBundle(bundle.directory, str(error)))
        with library.translating("read"):
            strangers += _strangers(bundle)
    with library.translating("read"):
        unfinished = [path for kind in MANIFESTS for path in (library.root / kind).glob(f".*{PARTIAL_SUFFIX}")]
    return Verification(sound, tuple(damaged), tuple(strangers), tuple(sorted(unfinished)))


def _strangers(bundle: ScanBundle | CalibrationBundle) -> list[Path]:
    expected = {RESULTS, *_MANIFESTS, *bundle.record.files}
    return sorted(path for path in bundle.directory.iterdir() if path.name not in expected)
