"""Publishing a bundle whole: it grows in a temporary directory and appears under its name in one step.

A writer holds the lock of its temporary directory, so that a start clears away what a power cut left and nothing that
is being written.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from device.bundle_layout import MANIFESTS, PARTIAL_SUFFIX, BundleKind, is_bundle_id, partial_name
from device.durable import discard, publish_directory
from device.errors import RecordError, StoreError
from device.records import FileEntry, describe_file, seal_name, seal_of
from device.store_access import close_to_others

Write = Callable[[Path], None]
Manifest = Callable[[dict[str, FileEntry]], bytes]


@contextmanager
def locked_directory(directory: Path, *, wait: bool = True) -> Iterator[None]:
    """Holds the lock of a directory, which ends with the process at the latest.

    Raises
    ------
    BlockingIOError
        Somebody else holds it and `wait` is False.
    """
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def publish_bundle(root: Path, kind: BundleKind, bundle_id: str, write: Write, manifest: Manifest) -> Path:
    """The published directory. `write` puts files into a directory, `manifest` turns their hashes into the manifest.

    Raises
    ------
    RecordError
        The id is not fit to name a directory.
    StoreError
        The id is taken.
    OSError
        The disk refused; nothing is left behind.
    """
    if not is_bundle_id(bundle_id):
        raise RecordError(f"{bundle_id!r} is no bundle id: it consists of lower-case letters, digits and hyphens")
    final = root / kind / bundle_id
    partial = root / kind / partial_name(bundle_id)
    with ExitStack() as stack:
        with locked_directory(root):
            if final.exists() or partial.exists():
                raise StoreError(f"{final}: exists already, and a bundle is never overwritten: start the program again")
            stack.callback(discard, partial)
            partial.mkdir()
            stack.enter_context(locked_directory(partial))
        write(partial)
        name = MANIFESTS[kind]
        data = manifest({path.name: describe_file(path) for path in sorted(partial.iterdir())})
        (partial / name).write_bytes(data)
        (partial / seal_name(name)).write_bytes(seal_of(name, data))
        close_to_others(partial)
        with locked_directory(root):
            publish_directory(partial, final)
    return final


def clear_unpublished(root: Path) -> None:
    """Remove temporary directories that no running program is writing."""
    for kind in MANIFESTS:
        for partial in (root / kind).glob(f".*{PARTIAL_SUFFIX}"):
            # One that is locked is being written; one that cannot be opened is never listed, and so harmless.
            with suppress(OSError), locked_directory(partial, wait=False):
                discard(partial)
