"""A calibration as it is kept: the models, their report, and what it was made from, in one file.

The file is a zip archive of named members with a digest of them all; nothing in it is compressed, so that none unpacks
to more.
"""

from __future__ import annotations

import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from device.bundles.calibration import CalibrationBundle
from device.bundles.fingerprint import Fingerprint
from device.errors import RecordError
from device.io.atomic import atomic_directory, check_output, write_output
from hal.frame import BayerOrder
from hal.validation import decode_json
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_file.soundness import check_sound
from host_sync.calibration_report.report import (
    BALL_PICTURES,
    PAPER_PICTURES,
    REPORT_FILE,
    calibration_lines,
    report_files,
)
from host_sync.errors import CalibrationFileError
from host_sync.frames.frame_set_file import Encoding
from host_sync.results.files import OVERVIEW_FILE
from host_sync.results.typed_members import READ_ERRORS, as_members, from_members

SCHEMA: Final = "retrograph.workstation-calibration/1"
FACTS_FILE: Final = "calibration.json"
MAX_BYTES: Final = 4 << 30
"""A calibration at 12 MP takes 160 MB; a larger file than this is not read."""

MAX_MEMBERS: Final = 2000
MAX_FACTS_BYTES: Final = 1 << 20
_EARLIEST: Final = (1980, 1, 1, 0, 0, 0)
"""The time that members bear, so that the same content is the same file."""

_READ_ERRORS: Final = (OSError, ValueError, LookupError, EOFError, RuntimeError, struct.error, zlib.error)


class Facts(msgspec.Struct, frozen=True, kw_only=True, tag_field="schema", tag=SCHEMA):
    """Description of a calibration file.

    calibration_id : of the calibration in it
    program : that made it
    made_utc : when
    made_from : name of the frame set, or id of the calibration bundle
    bundle_id, gel_id, fingerprint : of the calibration bundle, None where it was made from a frame set
    channel_order : Bayer order of that bundle's frames, which its fingerprint may leave open
    encoding : of light in the frame set's values, None where frames were raw
    full_scale, pixel_shape, marks_px : of that set's frames, as of `FrameSpec`
    key : digest of everything it was made from, empty where nobody asked
    content : digest of all other members
    """

    calibration_id: str
    program: str
    made_utc: str
    made_from: str
    bundle_id: str | None = None
    gel_id: str | None = None
    fingerprint: Fingerprint | None = None
    channel_order: BayerOrder | None = None
    encoding: Encoding | None = None
    full_scale: int | None = None
    pixel_shape: float = 1.0
    marks_px: float = 0.0
    key: str = ""
    content: str = ""


def is_archive(path: Path) -> bool:
    """Return whether a file begins as a calibration file does."""
    try:
        with path.open("rb") as stream:
            return stream.read(4) == b"PK\x03\x04"
    except OSError:
        return False


def write_archive(stream: BinaryIO, facts: Facts, members: Mapping[str, bytes]) -> Facts:
    """Write the members and what they are; returns the facts with their digest."""
    facts = msgspec.structs.replace(facts, content=_digest(members))
    record = msgspec.json.format(msgspec.json.encode(facts), indent=2)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {FACTS_FILE: record, **members}.items():
            archive.writestr(zipfile.ZipInfo(name, _EARLIEST), data)
    return facts


def read_archive(source: Path | bytes, name: str) -> tuple[Facts, dict[str, bytes]]:
    """Return what `write_archive` wrote to a file, or the bytes of one; `name` stands for it in messages.

    Raises
    ------
    CalibrationFileError
        It cannot be read, is damaged, too large, or something else.
    """
    try:
        with zipfile.ZipFile(source if isinstance(source, Path) else BytesIO(source)) as archive:
            _check_sizes(archive, name)
            facts = _facts(archive, name)
            members = {one.filename: archive.read(one) for one in archive.infolist() if one.filename != FACTS_FILE}
    except (*_READ_ERRORS, zipfile.BadZipFile, NotImplementedError) as error:
        if isinstance(error, CalibrationFileError):
            raise
        words = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise CalibrationFileError(f"{name}: is no readable calibration ({words}): calibrate again") from error
    if _digest(members) != facts.content:
        raise CalibrationFileError(f"{name}: is damaged, its digest is not that of its content: calibrate again")
    return facts, members


def _check_sizes(archive: zipfile.ZipFile, name: str) -> None:
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS or sum(one.file_size for one in entries) > MAX_BYTES:
        raise CalibrationFileError(f"{name}: is larger than any calibration: calibrate again")
    packed = [one for one in entries if one.compress_type != zipfile.ZIP_STORED or one.file_size != one.compress_size]
    if packed or len({one.filename for one in entries}) < len(entries):
        raise CalibrationFileError(f"{name}: was not written by retrosync: calibrate again")


def _facts(archive: zipfile.ZipFile, name: str) -> Facts:
    entry = archive.getinfo(FACTS_FILE)
    if entry.file_size > MAX_FACTS_BYTES:
        raise CalibrationFileError(f"{name}: is no calibration file: calibrate again")
    try:
        return decode_json(archive.read(entry), Facts)
    except msgspec.MsgspecError as error:
        raise CalibrationFileError(
            f"{name}: is no calibration of this version of retrograph ({error}): calibrate again"
        ) from error


def _digest(members: Mapping[str, bytes]) -> str:
    digest = blake2b(digest_size=16)
    for name, data in sorted(members.items()):
        digest.update(f"{name}\0{len(data)}\0".encode())
        digest.update(data)
    return digest.hexdigest()


REPORT_MEMBERS: Final = "report/"
REPORT_NAMES: Final = frozenset({REPORT_FILE, *BALL_PICTURES})
PAPER_REPORT_NAMES: Final = frozenset(PAPER_PICTURES)
"""Of a report whose calibration holds the paper's model, too. No other member of a file is written to a folder of
reports."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class KeptCalibration:
    """A calibration with its report and its origin.

    report : files of the report by name
    """

    calibration: Calibration
    report: dict[str, bytes]
    facts: Facts

    def __repr__(self) -> str:
        return f"<KeptCalibration {self.facts.calibration_id} of {self.facts.made_from}: {self.summary[0]}>"

    @property
    def summary(self) -> tuple[str, ...]:
        """Verdict and key values; then what to press next, and notes, one sentence each."""
        return calibration_lines(self.calibration)

    def write_report(self, target: Path) -> None:
        """Write the report to the directory `target`, replacing its contents.

        Raises
        ------
        OutputError
            The directory cannot be written.
        """
        with atomic_directory(target, REPORT_FILE) as folder:
            for name, data in self.report.items():
                (folder / name).write_bytes(data)

    def as_file(self) -> bytes:
        """Return contents of its file."""
        members = as_members(self.calibration)
        members |= {f"{REPORT_MEMBERS}{name}": data for name, data in self.report.items()}
        stream = BytesIO()
        write_archive(stream, self.facts, members)
        return stream.getvalue()

    def write(self, path: str | Path) -> None:
        """Write its file.

        Raises
        ------
        OutputError
            The place cannot be written; an old file stays.
        """
        check_output(Path(path))
        write_output(Path(path), self.as_file())


def make_calibration(
    frames: CalibrationFrames,
    facts: Callable[[Calibration], Facts],
    report_progress: Callable[[str], None] = lambda _: None,
) -> KeptCalibration:
    """Return the calibration that frames carry, with its report; errors as for `calibrate`."""
    calibration = calibrate_frames(frames, report_progress)
    report_progress("drawing the calibration's report")
    report = report_files(calibration)
    return KeptCalibration(from_members(as_members(calibration), Calibration), report, facts(calibration))


def facts_of(
    calibration: Calibration,
    made_from: str,
    key: str = "",
    *,
    encoding: Encoding | None = None,
    full_scale: int | None = None,
    pixel_shape: float = 1.0,
    marks_px: float = 0.0,
    bundle: CalibrationBundle | None = None,
) -> Facts:
    """Return what the file of a calibration that is made now says of itself."""
    record = None if bundle is None else bundle.record
    return Facts(
        calibration_id=calibration.calibration_id,
        program=f"retrograph {version('retrograph')}",
        made_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        made_from=made_from,
        key=key,
        encoding=encoding,
        full_scale=full_scale,
        pixel_shape=pixel_shape,
        marks_px=marks_px,
        bundle_id=None if record is None else record.calibration_id,
        gel_id=None if record is None else record.gel_id,
        fingerprint=None if record is None else record.fingerprint,
        channel_order=None if bundle is None else bundle.reference().bayer_order,
    )


def read_calibration_file(source: Path | bytes, name: str | None = None) -> KeptCalibration:
    """Return the calibration in a file, or in the bytes of one that is called `name`.

    Raises
    ------
    CalibrationFileError
        It is missing, damaged, of another version of the program, or no calibration.
    """
    called = name or str(source)
    facts, members = read_archive(source, called)
    report = {
        file.removeprefix(REPORT_MEMBERS): data for file, data in members.items() if file.startswith(REPORT_MEMBERS)
    }
    try:
        calibration = from_members(members, Calibration)
        check_sound(calibration, called)
    except (*READ_ERRORS, RecordError) as error:
        raise CalibrationFileError(
            f"{called}: is no calibration of this version of retrograph ({error}): calibrate again"
        ) from error
    pictures = REPORT_NAMES if calibration.paper is None else REPORT_NAMES | PAPER_REPORT_NAMES
    if set(report) - {OVERVIEW_FILE} != pictures or facts.calibration_id != calibration.calibration_id:
        raise CalibrationFileError(f"{called}: its report is not that of its calibration: calibrate again")
    return KeptCalibration(calibration, report, facts)
