"""The device's door as its configuration has it: inside a chroot there is the store and nothing else."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from device.bundles.bundle import RECEIPTS
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.errors import SourceError
from host_sync.library.library import Library
from host_sync.offload.ingest import ReceiptWriter
from host_sync.offload.pull import pull
from host_sync.offload.sftp import SftpSource

RUN = Path("/run")

pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or RUN.stat().st_mode & 0o022 != 0, reason="a chroot wants root, and a path of root's alone"
)


@pytest.fixture
def jail() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(dir=RUN, prefix="retrograph-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture
def store(jail: Path) -> BundleStore:
    return BundleStore(jail / "store", VirtualClock(), boot_id="b0071d00")


@pytest.fixture
def confinement(jail: Path) -> Callable[[Path], str]:
    return lambda root: f"ChrootDirectory {jail}\nForceCommand internal-sftp -d /{root.name} -u 0007\n"


def test_the_store_is_all_there_is(server: Any, store: BundleStore, publish_scan: Any, tmp_path: Path) -> None:
    scan = publish_scan(store)
    (store.root / "scans" / "way-out").symlink_to("/etc")
    library = Library(tmp_path / "library")
    with server.link() as link:
        source = SftpSource(link)
        report = pull(source, library, receipts=ReceiptWriter("bench", lambda: datetime(2026, 11, 21, tzinfo=UTC)))
        assert report.copied == [scan.scan_id]
        assert [failure.bundle_id for failure in report.failed] == ["way-out"]
        assert source.names("/etc") == []
        assert source.names("../../../../etc") == []
        with pytest.raises(SourceError):
            list(source.blocks("/etc/passwd"))
    receipt = store.root / RECEIPTS / f"{scan.scan_id}.json"
    assert receipt.stat().st_mode & 0o777 == 0o660
    assert store.make_room(1 << 62) == [scan.scan_id]


def test_there_is_no_shell(server: Any, store: BundleStore) -> None:
    command = [
        "ssh", "-T", "-oBatchMode=yes", "-oStrictHostKeyChecking=no", "-oUserKnownHostsFile=/dev/null",
        "-oLogLevel=ERROR",
        f"-p{server.port}", f"-i{server.private_key}", f"{server.device().user}@127.0.0.1", "id; cat /etc/passwd",
    ]  # fmt: skip
    ran = subprocess.run(command, input=b"", capture_output=True, check=False, timeout=30)
    assert b"root" not in ran.stdout
    assert b"uid" not in ran.stdout
