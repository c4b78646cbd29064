"""Publishing a bundle: it grows in a temporary directory and appears under its name in one step.

A writer locks its temporary directory. So a start removes what a power cut left, and nothing that is being written.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

from device.bundles.layout import MANIFESTS, PARTIAL_SUFFIX, BundleKind, is_bundle_id, partial_name
from device.bundles.record import FileEntry, checksum_name, describe_file, manifest_checksum
from device.errors import RecordError, StoreError
from device.io.atomic import publish_directory, remove_tree_quietly
from device.io.lock import locked_directory
from device.io.permissions import set_store_modes

FileWriter = Callable[[Path], None]
ManifestBuilder = Callable[[dict[str, FileEntry]], bytes]


def publish_bundle(root: Path, kind: BundleKind, bundle_id: str, write: FileWriter, manifest: ManifestBuilder) -> Path:
    """Write a bundle into a temporary directory, publish it, and return the published directory.

    write : puts the bundle's files into a directory
    manifest : turns the files' hashes into the manifest

    Raises
    ------
    RecordError
        The id cannot name a directory.
    StoreError
        The id is taken.
    OSError
        The disk refused; nothing is left behind.
    """
    if not is_bundle_id(bundle_id):
        raise RecordError(f"{bundle_id!r} is no bundle id: an id consists of lower-case letters, digits and hyphens")
    final = root / kind / bundle_id
    partial = root / kind / partial_name(bundle_id)
    with ExitStack() as stack:
        with locked_directory(root):
            if final.exists() or partial.exists():
                raise StoreError(f"{final}: exists already, and a bundle is never overwritten: start the program again")
            stack.callback(remove_tree_quietly, partial)
            partial.mkdir()
            stack.enter_context(locked_directory(partial))
        write(partial)
        name = MANIFESTS[kind]
        data = manifest({path.name: describe_file(path) for path in sorted(partial.iterdir())})
        (partial / name).write_bytes(data)
        (partial / checksum_name(name)).write_bytes(manifest_checksum(name, data))
        set_store_modes(partial)
        with locked_directory(root):
            publish_directory(partial, final)
    return final


def clear_unpublished(root: Path) -> None:
    """Remove temporary directories that no running program writes."""
    for kind in MANIFESTS:
        for partial in (root / kind).glob(f".*{PARTIAL_SUFFIX}"):
            # A locked one is being written; one that cannot be opened is never listed, and so harmless.
            with suppress(OSError), locked_directory(partial, wait=False):
                remove_tree_quietly(partial)
