"""Two programs never hold one folder, also where the file system has no locks."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from limits import running

from device.bundles.scan import ScanBundle
from device.io.lock import LEASE_S, FolderLocked, locked_directory
from device.store.store import BundleStore
from host_sync.errors import LibraryError
from host_sync.library.library import Library
from host_sync.library.verification import verify_library
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource

LEASE = ".retrograph.lease"


@pytest.fixture
def no_locks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system without locks, as an NFS mount with `nolock`."""

    def refuse(_: int, __: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)


def test_the_systems_lock_keeps_others_out(tmp_path: Path) -> None:
    with locked_directory(tmp_path):
        with pytest.raises(FolderLocked), locked_directory(tmp_path, wait=False):
            pass
        assert list(tmp_path.iterdir()) == []
    with locked_directory(tmp_path, wait=False):
        pass


def test_a_lease_keeps_others_out_and_names_its_owner(tmp_path: Path, no_locks: None) -> None:
    with locked_directory(tmp_path):
        with (
            pytest.raises(FolderLocked, match=rf"program {os.getpid()} on {socket.gethostname()}"),
            locked_directory(tmp_path, wait=False),
        ):
            pass
        assert (tmp_path / LEASE).is_file()
    assert list(tmp_path.iterdir()) == []


def test_who_waits_gets_the_lease_when_it_is_given_back(tmp_path: Path, no_locks: None) -> None:
    (tmp_path / LEASE).write_text(json.dumps({"host": "elsewhere", "pid": 1}))
    naps = []

    def nap(length_s: float) -> None:
        naps.append(length_s)
        if len(naps) == 3:
            (tmp_path / LEASE).unlink()

    with locked_directory(tmp_path, sleep=nap):
        assert len(naps) == 3


def test_a_lease_without_its_program_is_taken_over(tmp_path: Path, no_locks: None) -> None:
    with running([sys.executable, "-c", ""]) as ended:
        pass
    for content, age_s in (
        ({"host": socket.gethostname(), "pid": ended.pid}, 0.0),
        ({"host": "elsewhere", "pid": 1}, LEASE_S + 60.0),
    ):
        path = tmp_path / LEASE
        path.write_text(json.dumps(content))
        then = path.stat().st_mtime - age_s
        os.utime(path, (then, then))
        with locked_directory(tmp_path, wait=False):
            assert json.loads(path.read_text())["pid"] == os.getpid()


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"[]", b'{"host": 1, "pid": "x"}', b"\xff", b'{"host": "a", "pid": 1}']
)
def test_a_lease_that_may_be_somebodys_is_respected(tmp_path: Path, no_locks: None, content: bytes) -> None:
    (tmp_path / LEASE).write_bytes(content)
    with pytest.raises(FolderLocked), locked_directory(tmp_path, wait=False):
        pass
    assert (tmp_path / LEASE).read_bytes() == content


def test_a_library_without_locks_is_filled_by_one_program_at_a_time(
    store: BundleStore, publish_scan: Callable[..., ScanBundle], tmp_path: Path, no_locks: None
) -> None:
    publish_scan(store)
    library = Library(tmp_path / "library")
    with library.writing(), pytest.raises(LibraryError, match="another program is filling this library"):
        pull(DirectorySource(store.root), Library(library.root))
    assert pull(DirectorySource(store.root), library).complete
    assert verify_library(Library(library.root)).sound == 1
    assert sorted(path.name for path in library.root.rglob("*lease*")) == []
