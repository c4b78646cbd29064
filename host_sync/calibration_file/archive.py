"""A zip archive of named members with a digest of them all; nothing in it is compressed, so that none unpacks to more.

The first member, `calibration.json`, holds the digest and says what the archive is.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Mapping
from hashlib import blake2b
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from device.bundles.fingerprint import Fingerprint
from hal.frame import BayerOrder
from hal.validation import decode_json
from host_sync.errors import CalibrationFileError
from host_sync.frames.frame_set_file import Encoding

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
