"""Calibrations that were made before, by a digest of everything they were made from.

The digest covers the contents of the frames, what the frame set or bundle says of them, the state of the package's own
source files, and the versions of the libraries that compute. So nothing in the cache is ever out of date; what nobody
used for a month goes, and the least recently used go when there are too many.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from device.io.atomic import replace_file
from host_sync.calibration_file.kept_calibration import KeptCalibration, read_calibration_file
from host_sync.errors import CalibrationFileError
from host_sync.kernels.cache import KEPT_S, PACKAGES, state_of, user_cache

LIBRARIES: Final = ("numpy", "scipy", "opencv-contrib-python-headless", "numba")
SUFFIX: Final = ".calibration"
MAX_BYTES: Final = 4 << 30
CHUNK_BYTES: Final = 1 << 22


class CalibrationCache:
    """Calibrations in a folder; a folder that cannot be read or written is one that keeps nothing.

    Parameters
    ----------
    folder : where they lie, None for nowhere
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    @classmethod
    def of_user(cls, environment: Mapping[str, str] = os.environ) -> CalibrationCache:
        """Return the user's cache."""
        home = user_cache(environment)
        return cls(home and home / "calibrations")

    def find(self, key: str) -> KeptCalibration | None:
        """Return the calibration with this key, None where there is none that can be read."""
        if self._folder is None:
            return None
        path = self._path(key)
        try:
            if not path.is_file():
                return None
            kept = read_calibration_file(path)
            os.utime(path)
        except CalibrationFileError:
            with suppress(OSError):
                path.unlink()
            return None
        except OSError:
            return None
        return kept if kept.facts.key == key else None

    def keep(self, kept: KeptCalibration) -> bool:
        """Keep a calibration under its key; returns whether it was possible."""
        if self._folder is None or not kept.facts.key:
            return False
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            replace_file(self._path(kept.facts.key), kept.as_file())
            self._prune(kept.facts.key)
        except OSError:
            return False
        return True

    def _path(self, key: str) -> Path:
        assert self._folder is not None  # noqa: S101 - asked only where there is one
        return self._folder / f"{key}{SUFFIX}"

    def _prune(self, own: str) -> None:
        """Remove what nobody used for a month, and the least recently used while there is more than `MAX_BYTES`."""
        assert self._folder is not None  # noqa: S101 - asked only where there is one
        found = sorted(
            ((one.stat(), one) for one in self._folder.glob(f"*{SUFFIX}")), key=lambda pair: pair[0].st_mtime
        )
        newest_s = max(facts.st_mtime for facts, _ in found)
        total = sum(facts.st_size for facts, _ in found)
        for facts, path in found:
            if path != self._path(own) and (facts.st_mtime < newest_s - KEPT_S or total > MAX_BYTES):
                path.unlink(missing_ok=True)
                total -= facts.st_size


def key_of(settings: object, files: Iterable[Path]) -> str:
    """Return the digest of settings, files' contents, the package's own state and the libraries' versions.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    digest = blake2b(digest_size=16)
    digest.update(state_of(*PACKAGES).encode())
    digest.update(" ".join(f"{name} {version(name)}" for name in LIBRARIES).encode())
    digest.update(msgspec.msgpack.encode(settings))
    for path in files:
        digest.update(f"\0{path.stat().st_size}\0".encode())
        with path.open("rb") as stream:
            while chunk := stream.read(CHUNK_BYTES):
                digest.update(chunk)
    return digest.hexdigest()
