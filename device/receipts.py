"""The receipt: a workstation states that it has stored a bundle, read it back and found every byte as promised.

Receipts are the only thing that allows a device to free a scan. One counts only when it names the very manifest that
the device holds: another bundle under the same id is not covered.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from device.errors import RecordError
from device.records import BundleId, Record, Sha256, decode_record, read_small, sha256_bytes

RECEIPT_SCHEMA: Final = "retrograph.receipt/1"
RECEIPTS: Final = "receipts"
_SUFFIX: Final = ".json"


class Receipt(Record, frozen=True, tag_field="schema", tag=RECEIPT_SCHEMA):
    """What a workstation vouches for.

    manifest_sha256 : of the manifest, which holds the hash of every file
    host : the workstation's own name, for people
    verified : as the workstation believed the time; an annotation
    """

    kind: Literal["scans", "calibrations"]
    bundle_id: BundleId
    manifest_sha256: Sha256
    host: Annotated[str, msgspec.Meta(max_length=200)]
    verified: Annotated[datetime, msgspec.Meta(tz=True)]


def receipt_name(bundle_id: str) -> str:
    """Name of the file that holds a bundle's receipt."""
    return bundle_id + _SUFFIX


def bundle_of(receipt_file: str) -> str | None:
    """Id of the bundle that a file of that name vouches for; None for any other file."""
    return receipt_file.removesuffix(_SUFFIX) if receipt_file.endswith(_SUFFIX) else None


def is_receipted(root: Path, bundle_id: str, manifest: bytes) -> bool:
    """Whether a workstation vouches for the bundle with this very manifest; a receipt that cannot be read is none."""
    path = root / RECEIPTS / receipt_name(bundle_id)
    if not path.exists():
        return False
    try:
        receipt = decode_record(read_small(path), Receipt, path)
    except RecordError:
        return False
    return (receipt.bundle_id, receipt.manifest_sha256) == (bundle_id, sha256_bytes(manifest))
