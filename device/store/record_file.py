"""A small record of the store as a file that is replaced in one step."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from device.bundles.record import Record, decode_record, encode_record, read_small
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error

Kept = TypeVar("Kept", bound=Record)


@dataclass(frozen=True, slots=True)
class RecordFile(Generic[Kept]):
    """One record in a store, or one for each name.

    kind : type of the record
    place : its path below the store, where {} is the name
    remedy : what a person does about a damaged file
    """

    kind: type[Kept]
    place: str
    remedy: str

    def path(self, root: Path, name: str = "") -> Path:
        """Path of the file, there or not."""
        return root / self.place.format(name)

    def read(self, root: Path, name: str = "") -> Kept | None:
        """The record; None when there is none.

        Raises
        ------
        RecordError
            The file is damaged.
        """
        return self._decoded(path) if (path := self.path(root, name)).exists() else None

    def read_sound(self, root: Path, name: str = "") -> Kept | None:
        """The record; None when there is none or its file is damaged."""
        try:
            return self.read(root, name)
        except RecordError:
            return None

    def all_sound(self, root: Path) -> list[Kept]:
        """The records of all names, by name; damaged ones are left out."""
        pattern = self.path(root, "*")
        names = sorted(path.stem for path in pattern.parent.glob(pattern.name))
        return [record for name in names if (record := self.read_sound(root, name)) is not None]

    def write(self, root: Path, record: Kept, name: str = "") -> None:
        """Store a record durably.

        Raises
        ------
        StoreError
            The disk refused; the one before is kept.
        """
        path = self.path(root, name)
        try:
            path.parent.mkdir(exist_ok=True)
            replace_file(path, encode_record(record))
        except OSError as error:
            raise StoreError(f"{path}: cannot be stored {explain_os_error(error)}") from error

    def remove(self, root: Path) -> None:
        """Remove the file.

        Raises
        ------
        StoreError
            The disk refused.
        """
        path = self.path(root)
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise StoreError(f"{path}: cannot be removed {explain_os_error(error)}") from error

    def _decoded(self, path: Path) -> Kept:
        return decode_record(read_small(path, self.remedy), self.kind, path, self.remedy)
