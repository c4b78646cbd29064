"""Common part of scan and calibration bundles: a directory, its record, and access to the files that it lists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

from device.bundles.raw_frame import read_bundle_frame
from device.bundles.record import FileEntry, Identity, check_folder_name, read_manifest, verify_files
from device.errors import RecordError
from device.io.tiff import check_pixel_count
from hal.frame import RawFrame

RAW_OVERHEAD_BYTES: Final = 1 << 20
"""What a raw file may need beside its counts: header and tables."""


class Manifest(Protocol):
    """Common fields of the records of both kinds of bundle."""

    @property
    def identity(self) -> Identity:
        """Identity of the bundle."""
        ...

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of every raw frame, sensor pixels."""
        ...

    @property
    def files(self) -> dict[str, FileEntry]:
        """Hash and size of every file beside the manifest."""
        ...

    @property
    def raw_files(self) -> tuple[str, ...]:
        """Names of the raw frames."""
        ...

    @property
    def named_files(self) -> tuple[str, ...]:
        """Every file that the record refers to."""
        ...


ManifestT = TypeVar("ManifestT", bound=Manifest)


@dataclass(frozen=True, slots=True)
class Bundle(Generic[ManifestT]):
    """A published bundle: its directory and its record; frames are read when they are used."""

    directory: Path
    record: ManifestT

    @property
    def bundle_id(self) -> str:
        """Id of the bundle, also the name of its directory."""
        return self.record.identity.id

    def path(self, name: str) -> Path:
        """Return the path of a file of the bundle.

        Raises
        ------
        RecordError
            The manifest lists no such file.
        """
        if name not in self.record.files:
            raise RecordError(f"{self.directory}: holds no file {name!r}: its files are {', '.join(self.record.files)}")
        return self.directory / name

    def verify(self) -> None:
        """Hash every file and compare.

        Raises
        ------
        RecordError
            Names every file that is missing or differs.
        """
        verify_files(self.directory, self.record.files)

    def _frame(self, name: str) -> RawFrame:
        """Return a raw frame of the bundle, read from disk.

        Raises
        ------
        RecordError
            The file is missing or damaged, or of another size than the record states.
        """
        return read_bundle_frame(self.path(name), self.record.shape)


def check_files(record: Manifest, source: str | Path) -> None:
    """Refuse a record that refers to files it does not list, or states sizes that no honest device writes.

    Raises
    ------
    RecordError
        Names `source` and the files.
    """
    unlisted = [name for name in record.named_files if name not in record.files]
    if unlisted:
        raise RecordError(f"{source}: files: {', '.join(unlisted)} is not listed there: fetch it again")
    try:
        check_pixel_count(record.shape)
    except ValueError as error:
        raise RecordError(f"{source}: shape: {error}: fetch it again") from error
    rows, columns = record.shape
    limit = 2 * rows * columns * 9 // 8 + RAW_OVERHEAD_BYTES
    for name in record.raw_files:
        size = record.files[name].size
        if size > limit:
            raise RecordError(
                f"{source}: {name} states {size} bytes, too many for {columns}x{rows} pixels: fetch it again"
            )


def read_record(directory: Path, manifest: str, decode: Callable[[bytes, Path], ManifestT]) -> ManifestT:
    """Return the record of the bundle in a directory; its manifest is checked, its other files are not read.

    Raises
    ------
    RecordError
        No such bundle there, an unknown version, a damaged manifest, or a folder not named by the bundle's id.
    """
    record = decode(read_manifest(directory, manifest), directory / manifest)
    check_folder_name(directory, record.identity)
    return record
