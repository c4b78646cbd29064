"""Offload over the real OpenSSH server on loopback: in the end everything is there, bit by bit, whatever happens."""

from __future__ import annotations

import asyncio
import getpass
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import asyncssh
import msgspec
import numpy as np
import pytest
from limits import running

from device.bundles.record import sha256_bytes
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.cli.main import main
from host_sync.errors import HostError, SourceError, SourceLost, SourceRefused
from host_sync.library.library import Library
from host_sync.library.verification import verify_library
from host_sync.offload.ingest import PullReport, ReceiptWriter
from host_sync.offload.mirror import SftpPlace, mirror_to_sftp
from host_sync.offload.paired_devices import PairedDevice, PairedDevices
from host_sync.offload.pull import pull, sync
from host_sync.offload.sftp import REQUEST_BYTES, SftpSource
from host_sync.offload.sftp_link import Timeouts
from host_sync.offload.source import DirectorySource

HANDSHAKE_BYTES = 16_384


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path / "library")


def vouch() -> ReceiptWriter:
    return ReceiptWriter("bench", lambda: datetime(2026, 11, 21, tzinfo=UTC))


def contents(root: Path, kind: str) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes() for path in sorted((root / kind).rglob("*")) if path.is_file()
    }


def assert_identical(store: BundleStore, library: Library) -> None:
    for kind in ("scans", "calibrations"):
        assert contents(library.root, kind) == contents(store.root, kind)


def pull_over(server: Any, library: Library, port: int | None = None, **named: Any) -> PullReport:
    with server.link(port, **named) as link:
        return pull(SftpSource(link), library, receipts=vouch())


def test_network_and_card_give_the_same(
    server: Any, store: BundleStore, library: Library, publish_scan: Any, publish_calibration: Any, tmp_path: Path
) -> None:
    calibration = publish_calibration(store)
    scan = publish_scan(store, calibration.calibration_id)
    report = pull_over(server, library)
    assert report.copied == [calibration.calibration_id, scan.scan_id]
    assert report.unreceipted is None
    assert_identical(store, library)
    card = Library(tmp_path / "from-card")
    assert pull(DirectorySource(store.root), card).copied == report.copied
    assert contents(card.root, "scans") == contents(library.root, "scans")
    again = pull_over(server, library)
    assert (again.copied, again.copied_bytes, len(again.already_there)) == ([], 0, 2)


def test_a_receipt_follows_what_was_read_back_and_lets_the_device_free_it(
    server: Any, store: BundleStore, library: Library, publish_scan: Any
) -> None:
    scan = publish_scan(store)
    assert store.make_room(1 << 62) == []
    pull_over(server, library)
    receipt = json.loads((store.root / "receipts" / f"{scan.scan_id}.json").read_bytes())
    assert receipt["manifest_sha256"] == sha256_bytes((scan.directory / "scan.json").read_bytes())
    assert store.make_room(1 << 62) == [scan.scan_id]
    library.find(scan.scan_id).verify()


def test_a_copy_that_has_rotted_in_the_library_is_not_receipted(
    server: Any, store: BundleStore, library: Library, publish_scan: Any
) -> None:
    scan = publish_scan(store)
    pull(DirectorySource(store.root), library)
    raw = library.root / "scans" / scan.scan_id / "raw.tif"
    raw.write_bytes(raw.read_bytes()[:-1] + b"?")
    report = pull_over(server, library)
    assert [failure.bundle_id for failure in report.failed] == [scan.scan_id]
    assert "raw.tif" in report.failed[0].reason
    assert store.make_room(1 << 62) == []


def harmed_pull(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object], cuts: int
) -> None:
    publish_large(3 << 20)
    publish_large(700_001)
    rng = np.random.default_rng(7)
    positions = np.concatenate([rng.integers(0, 5_000, cuts // 4), rng.integers(0, 900_000, cuts - cuts // 4)])
    proxy.harms.extend(("cut", int(at)) for at in rng.permutation(positions))
    report = pull_over(server, library, proxy.port)
    while proxy.harms:  # what is already whole is not fetched again: begin anew until every cut has been made
        assert report.complete
        for bundle in library.scans().bundles:
            for path in (*bundle.directory.iterdir(),):
                path.unlink()
            bundle.directory.rmdir()
        for receipt in (store.root / "receipts").iterdir():
            receipt.unlink()
        proxy.served_bytes = proxy.connections = 0
        report = pull_over(server, library, proxy.port)
    assert report.complete
    assert_identical(store, library)
    assert report.copied_bytes == sum(path.stat().st_size for path in (store.root / "scans").glob("*/raw.tif"))
    repeated = proxy.served_bytes - report.copied_bytes
    assert repeated <= proxy.connections * (REQUEST_BYTES + HANDSHAKE_BYTES)
    assert list((library.root / "scans").glob(".*")) == []


def test_a_transfer_that_is_cut_goes_on_where_it_stopped(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    harmed_pull(server, proxy, store, library, publish_large, 8)


@pytest.mark.slow
def test_two_hundred_cuts(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    harmed_pull(server, proxy, store, library, publish_large, 200)


def test_flipped_bits_never_arrive(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(1 << 20)
    rng = np.random.default_rng(3)
    proxy.harms.extend(("flip", int(at)) for at in (*rng.integers(5_000, 400_000, 6), 30, 900))
    assert pull_over(server, library, proxy.port).complete
    assert_identical(store, library)


def test_silence_ends_in_a_sentence_and_the_next_pull_goes_on(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(3 << 20)
    proxy.harms.extend([("silence", 2_000_000), *[("silence", 0)] * 50])
    hasty = Timeouts(keepalive_s=0.5, unanswered=3, give_up_s=3.0, retry_s=0.01)
    report = pull_over(server, library, proxy.port, timeouts=hasty)
    assert report.lost is not None
    assert "what arrived is kept" in report.lost
    (part,) = (library.root / "scans").glob(".*/raw.tif.part")
    kept = part.stat().st_size
    assert kept > 500_000
    proxy.harms.clear()
    report = pull_over(server, library, proxy.port)
    assert report.complete
    assert report.copied_bytes == (3 << 20) - kept
    assert_identical(store, library)


def test_a_line_that_always_breaks_before_a_byte_comes_ends_too(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(3 << 20)
    proxy.harms.extend([("cut", 300_000), *[("cut", 6_000)] * 500])
    report = pull_over(server, library, proxy.port, timeouts=Timeouts(give_up_s=3.0, retry_s=0.01))
    assert report.lost is not None
    assert proxy.connections > 2


def test_a_slow_line_only_takes_longer(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(400_000)
    proxy.bytes_per_s = 32e6 / 8
    assert pull_over(server, library, proxy.port).complete
    assert_identical(store, library)


def test_a_server_killed_and_back_again_is_picked_up(
    server: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(4 << 20)
    killed = False

    def kill_once(_: object) -> None:
        nonlocal killed
        if not killed:
            killed = True
            server.kill()
            server.start()

    with server.link() as link:
        report = pull(SftpSource(link), library, kill_once)
    assert killed
    assert report.complete
    assert_identical(store, library)


def test_a_client_killed_in_the_middle_leaves_what_the_next_one_needs(
    server: Any,
    proxy: Any,
    store: BundleStore,
    library: Library,
    publish_large: Callable[[int], object],
    tmp_path: Path,
) -> None:
    publish_large(6 << 20)
    settings = PairedDevices(tmp_path / "config" / "retrograph")
    settings.private_key(server.private_key.read_bytes)
    settings.save(server.device(proxy.port))
    proxy.bytes_per_s, proxy.milestone_bytes = 8e6, 3 << 20
    command = [sys.executable, "-m", "host_sync", "pull", "rg00c0ffee", "--library", str(library.root)]
    environment = os.environ | {"XDG_CONFIG_HOME": str(tmp_path / "config")}
    with running(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as client:
        assert proxy.passed_milestone.wait(60.0)
        client.kill()
    (part,) = (library.root / "scans").glob(".*/raw.tif.part")
    kept = part.stat().st_size
    assert kept > 1 << 20
    proxy.bytes_per_s = None
    report = pull_over(server, library, proxy.port)
    assert report.copied_bytes == (6 << 20) - kept
    assert_identical(store, library)


@pytest.mark.slow
def test_silence_is_borne_for_less_than_ten_seconds(
    server: Any, proxy: Any, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(3 << 20)
    proxy.harms.extend([("silence", 1_000_000), *[("silence", 0)] * 100])
    proxy.milestone_bytes = 950_000
    with server.link(proxy.port, Timeouts()) as link, ThreadPoolExecutor(1) as pulling:
        pulled = pulling.submit(pull, SftpSource(link), library, receipts=vouch())
        assert proxy.passed_milestone.wait(60.0)
        assert pulled.result(timeout=10.0).lost


def test_a_slow_line_upwards_is_no_silence(server: Any, proxy: Any, store: BundleStore, tmp_path: Path) -> None:
    content = os.urandom(600_000)
    (tmp_path / "content").write_bytes(content)
    proxy.upward_bytes_per_s = 300_000.0
    hasty = Timeouts(keepalive_s=5.0, unanswered=2, give_up_s=1.2, retry_s=0.01)
    with server.link(proxy.port, hasty) as link:
        SftpSource(link).write("inbox/content", tmp_path / "content")
    assert (store.root / "inbox" / "content").read_bytes() == content
    assert proxy.connections == 1


def test_a_file_of_ours_that_cannot_be_read_is_not_taken_for_a_broken_line(
    server: Any, proxy: Any, store: BundleStore, tmp_path: Path
) -> None:
    with server.link(proxy.port) as link, pytest.raises(HostError, match=r"gone: cannot be read"):
        SftpSource(link).write("inbox/content", tmp_path / "gone")
    assert proxy.connections == 1


@pytest.mark.slow
def test_a_line_that_breaks_at_every_try_to_write_ends_too(server: Any, proxy: Any, store: BundleStore) -> None:
    proxy.harms.extend([("cut", 6_000)] * 100)
    with server.link(proxy.port) as link, pytest.raises(SourceLost):
        SftpSource(link).write("inbox/content", b"x" * (6 << 20))
    assert proxy.connections <= 40


def test_threads_that_share_a_link_find_it_mended_by_one_of_them(server: Any, proxy: Any, store: BundleStore) -> None:
    proxy.harms.extend([("cut", 9_000), ("cut", 9_000)])
    with server.link(proxy.port) as link, ThreadPoolExecutor(4) as threads:
        source = SftpSource(link)
        list(threads.map(lambda i: source.write(f"receipts/{i}", b"x" * 100), range(60)))
        assert source.names("receipts") == sorted(str(i) for i in range(60))
    assert proxy.connections == 3


def test_a_device_set_up_anew_is_explained_and_never_waved_through(server: Any, library: Library) -> None:
    foreign = server.host_key[:-6] + ("AAAAAA" if not server.host_key.endswith("AAAAAA") else "BBBBBB")
    with pytest.raises(SourceRefused, match=r"presents another host key.*pair it again"):
        pull_over(server, library, host_key=foreign)
    (server.folder / "authorized_keys").write_text("")
    with pytest.raises(SourceRefused, match="does not accept this workstation's key"):
        pull_over(server, library)


def test_nobody_there_is_reported(server: Any, library: Library) -> None:
    server.kill()
    hasty = Timeouts(give_up_s=0.2, retry_s=0.01)
    with pytest.raises(SourceLost, match=r"cannot be reached at 127\.0\.0\.1"):
        pull_over(server, library, timeouts=hasty)


def test_the_devices_clock_is_compared(server: Any) -> None:
    with server.link() as link:
        offset_s = SftpSource(link).clock_offset_s()
    assert offset_s is not None
    assert abs(offset_s) <= 2.0


def test_sync_status_and_push_by_the_devices_name(
    server: Any,
    store: BundleStore,
    publish_scan: Any,
    publish_calibration: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    settings = PairedDevices(tmp_path / "config" / "retrograph")
    settings.private_key(server.private_key.read_bytes)
    settings.save(server.device())
    publish_scan(store)
    library = ["--library", str(tmp_path / "library")]
    assert main(["pull", *library]) == 0
    assert main(["pull", "c0ffee", *library]) == 0
    assert "1 of 1 verified" in capsys.readouterr().out
    assert main(["status"]) == 0
    said = capsys.readouterr().out
    assert "rg00c0ffee" in said
    assert "1 in the library, 0 failed; its clock was" in said
    other = BundleStore(tmp_path / "other", VirtualClock(), boot_id="b0071d01")
    calibration = publish_calibration(other)
    assert main(["pull", str(other.root), *library]) == 0
    assert main(["push-calibration", "c0ffee", calibration.calibration_id, *library]) == 0
    assert main(["push-calibration", "c0ffee", calibration.calibration_id, *library]) == 3
    assert "in its inbox already" in capsys.readouterr().err
    assert [delivery.refusal for delivery in store.import_inbox()] == [None]
    assert store.activate(calibration.calibration_id).record == calibration.record


def test_several_devices_fill_one_library_side_by_side(
    server: Any, store: BundleStore, library: Library, publish_scan: Any, tmp_path: Path
) -> None:
    publish_scan(store)
    other = BundleStore(tmp_path / "other", VirtualClock(), boot_id="b0071d01")
    publish_scan(other)
    settings = PairedDevices(tmp_path / "settings")
    near, far, gone = (msgspec.structs.replace(server.device(), device_id=f"rg{i}") for i in range(3))

    @contextmanager
    def opener(device: PairedDevice) -> Iterator[Any]:
        if device == gone:
            raise SourceLost("gone: cannot be reached")
        if device == far:
            yield DirectorySource(other.root)
            return
        with server.link() as link:
            yield SftpSource(link)

    outcomes = sync([near, gone, far], library, settings, opener, lambda *_: None)
    assert [getattr(outcome, "complete", False) for outcome in outcomes] == [True, False, True]
    assert len(library.scans().bundles) == 2
    assert settings.sync_state("rg1") is not None
    assert settings.sync_state("rg1").clock_offset_s is None  # type: ignore[union-attr]


def test_a_name_that_is_not_utf_8_and_receipts_that_are_a_file_stop_nothing(
    server: Any, library: Library, publish_large: Callable[[int], Any]
) -> None:
    scan = publish_large(100_000)
    os.mkdir(os.fsencode(server.root / "scans") + b"/caf\xe9")  # noqa: PTH102
    shutil.rmtree(server.root / "receipts")
    (server.root / "receipts").touch()
    (server.root / "scans" / "pipe-1").mkdir()
    os.mkfifo(server.root / "scans" / "pipe-1" / "scan.json")
    report = pull_over(server, library)
    assert report.copied == [scan.scan_id]
    assert sorted(failure.bundle_id for failure in report.failed) == sorted(["caf\udce9", "pipe-1", "receipts"])


def test_a_mirror_over_sftp_is_read_back_and_copies_only_what_is_missing(
    server: Any, library: Library, publish_large: Callable[[int], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scans = [publish_large(50_000) for _ in range(2)]
    assert pull_over(server, library).complete
    home = tmp_path / "home"
    (home / ".ssh").mkdir(parents=True)
    shutil.copy(server.private_key, home / ".ssh" / "id_ed25519")
    (home / ".ssh" / "known_hosts").write_text(f"[127.0.0.1]:{server.port} {server.host_key}\n")
    monkeypatch.setenv("HOME", str(home))
    place = SftpPlace(getpass.getuser(), "127.0.0.1", server.port, str(tmp_path / "mirror"))
    first = mirror_to_sftp(library, place, lambda _: None)
    assert set(first.copied) == {scan.scan_id for scan in scans}
    again = mirror_to_sftp(library, place, lambda _: None)
    assert (again.copied, len(again.already_there), again.failed) == ((), 2, ())
    assert verify_library(Library(tmp_path / "mirror")).sound == 2
    rotten = tmp_path / "mirror" / "scans" / scans[0].scan_id / "raw.tif"
    rotten.write_bytes(bytes(50_000))
    assert mirror_to_sftp(library, place, lambda _: None).failed == ()
    found = mirror_to_sftp(library, place, lambda _: None, verify=True)
    assert [failure.bundle_id for failure in found.failed] == [scans[0].scan_id]
    with pytest.raises(SourceError, match="check address and key"):
        mirror_to_sftp(library, SftpPlace(None, "127.0.0.1", 9, "/x"), lambda _: None)


@pytest.mark.parametrize("answer_bytes", [0, 1], ids=["that answers no request", "that drips"])
def test_a_server_is_given_up(server: Any, answer_bytes: int) -> None:
    class Slow(asyncssh.SFTPServer):
        def stat(self, path: bytes) -> asyncssh.SFTPAttrs:  # noqa: ARG002
            return asyncssh.SFTPAttrs(permissions=0o100644, size=1 << 20)

        lstat = stat

        def open(self, path: bytes, pflags: int, attrs: asyncssh.SFTPAttrs) -> object:  # noqa: ARG002
            return object()

        def close(self, file_obj: object) -> None:
            pass

        async def read(self, file_obj: object, offset: int, size: int) -> bytes:  # noqa: ARG002
            if not answer_bytes:
                await asyncio.Event().wait()
            return b"x" * answer_bytes

    ready: Future[tuple[int, Callable[[], None]]] = Future()

    async def serve() -> None:
        ended = asyncio.Event()
        key, users = server.folder / "host_key", str(server.folder / "authorized_keys")
        async with await asyncssh.listen(
            "127.0.0.1", 0, server_host_keys=[key], authorized_client_keys=users, sftp_factory=Slow
        ) as listening:
            end = partial(asyncio.get_running_loop().call_soon_threadsafe, ended.set)
            ready.set_result((listening.get_port(), end))
            await ended.wait()

    with ThreadPoolExecutor(1) as serving:
        serving.submit(asyncio.run, serve())
        port, end = ready.result(timeout=60.0)
        hasty = Timeouts(keepalive_s=0.2, unanswered=2, give_up_s=0.5, retry_s=0.1)
        try:
            with server.link(port, hasty) as link, pytest.raises(SourceLost, match="what arrived is kept"):
                for _ in SftpSource(link).blocks("scans/x/raw.tif"):
                    pass
        finally:
            end()


def test_a_device_that_connects_every_time_and_sends_nothing_ends_too(
    server: Any, proxy: Any, store: BundleStore, library: Library, publish_large: Callable[[int], object]
) -> None:
    publish_large(3 << 20)
    proxy.harms.extend([("cut", 300_000), *[("cut", 6_000)] * 30])
    report = pull_over(server, library, proxy.port, timeouts=Timeouts(give_up_s=0.05, retry_s=10.0))
    assert report.lost is not None
    assert "keeps breaking" in report.lost
    assert proxy.connections <= 4
