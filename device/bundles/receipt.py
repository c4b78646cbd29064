"""The receipt: a workstation states that it stored a bundle, read it back and found every byte as promised.

Only a receipt allows a device to delete a scan, and only when it names the kind, the id and the very manifest that the
device holds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from device.bundles.layout import BundleKind
from device.bundles.record import (
    MAX_MANIFEST_BYTES,
    BundleId,
    Record,
    Sha256,
    ShortText,
    Time,
    decode_record,
    sha256_bytes,
)
from device.errors import RecordError
from device.io.folder import Folder

RECEIPT_SCHEMA: Final = "retrograph.receipt/1"
RECEIPTS: Final = "receipts"
_SUFFIX: Final = ".json"


class Receipt(Record, frozen=True, tag_field="schema", tag=RECEIPT_SCHEMA):
    """A workstation's statement about one bundle.

    manifest_sha256 : hash of the manifest, which holds the hash of every file
    host : the workstation's name, for people
    verified : by the workstation's clock; an annotation
    """

    kind: BundleKind
    bundle_id: BundleId
    manifest_sha256: Sha256
    host: ShortText
    verified: Time


def receipt_name(bundle_id: str) -> str:
    """Name of the file that holds a bundle's receipt."""
    return bundle_id + _SUFFIX


def bundle_of(receipt_file: str) -> str | None:
    """Return the id of the bundle that a receipt's file name states; None for any other file.

    The name alone proves nothing.
    """
    return receipt_file.removesuffix(_SUFFIX) if receipt_file.endswith(_SUFFIX) else None


def is_receipted(root: Path, kind: BundleKind, bundle_id: str, manifest: bytes) -> bool:
    """Return whether a receipt in a store names this kind, id and manifest; an unreadable receipt counts as absent.

    The folder of receipts is writable for workstations: nothing in it is trusted.
    """
    try:
        with Folder(root) as folder:
            data = folder.read(f"{RECEIPTS}/{receipt_name(bundle_id)}", MAX_MANIFEST_BYTES)
        receipt = decode_record(data, Receipt, receipt_name(bundle_id))
    except (OSError, RecordError):
        return False
    return (receipt.kind, receipt.bundle_id, receipt.manifest_sha256) == (kind, bundle_id, sha256_bytes(manifest))
