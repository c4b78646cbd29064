"""`retrosync` pull, status, pair from the command line: what it says, and with which code it ends."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from device.bundles.bundle import is_receipted
from device.bundles.scan import ScanBundle
from device.store.store import BundleStore
from host_sync.cli.main import main
from host_sync.offload.paired_devices import PairedDevice, PairedDevices, SyncState


@pytest.fixture(autouse=True)
def own_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def test_a_folder_is_pulled_and_receipted(
    store: BundleStore, publish_scan: Callable[..., object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish_scan(store)
    library = tmp_path / "[red]lib"
    assert main(["pull", str(store.root), "--library", str(library)]) == 0
    said = capsys.readouterr().out
    assert "1 of 1 verified" in said
    assert "[red]lib" in said
    assert len(list((store.root / "receipts").iterdir())) == 1


def test_a_copy_that_rotted_is_not_called_verified_and_its_receipt_is_taken_back(
    store: BundleStore, publish_scan: Callable[..., ScanBundle], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan, library = publish_scan(store), tmp_path / "library"
    pull = ["pull", str(store.root), "--library", str(library)]
    assert main(pull) == 0
    copy = library / "scans" / scan.scan_id
    good = (copy / "raw.tif").read_bytes()
    (copy / "raw.tif").write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    capsys.readouterr()
    assert main(pull) == 0
    assert "0 of 1 verified, 1 by an earlier pull (--rehash hashes them again)" in capsys.readouterr().out
    manifest = (scan.directory / "scan.json").read_bytes()
    assert is_receipted(store.root, "scans", scan.scan_id, manifest)
    for arguments in ([*pull, "--rehash"], pull):  # without its receipt it is looked at again
        assert main(arguments) == 1
        told = capsys.readouterr()
        assert "0 of 1 verified\n" in told.out
        assert "raw.tif is damaged" in told.err
        assert not is_receipted(store.root, "scans", scan.scan_id, manifest)
    copy.rename(tmp_path / "moved-away")
    assert main(pull) == 0
    assert (copy / "raw.tif").read_bytes() == good
    assert is_receipted(store.root, "scans", scan.scan_id, manifest)
    assert main([*pull, "--rehash"]) == 0
    assert capsys.readouterr().out.count("1 of 1 verified\n") == 2


@pytest.mark.parametrize("arguments", [["pull", ""], ["pull", "/absent/card"], ["pull", "absent"], ["pull"]])
def test_what_is_not_there_is_bad_input(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("retrosync: ")
    assert error.count("\n") == 1


def test_patience_must_be_positive(store: BundleStore, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pull", str(store.root), "--patience-s", "0"]) == 2
    assert "--patience-s" in capsys.readouterr().err


def test_an_empty_library_is_no_name(store: BundleStore, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pull", str(store.root), "--library", ""]) == 2
    assert "an empty name is not a folder" in capsys.readouterr().err


def test_status_without_devices_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status"]) == 0
    assert "retrosync pair" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("offset_s", "words"),
    [
        (None, "its clock was not measured"),
        (-1.4, "its clock was right"),
        (90.0, "its clock was 90 s ahead"),
        (-1_795_000_000.0, "its clock was 57 years behind"),
        (7200.0, "its clock was 2 hours ahead"),
    ],
)
def test_the_devices_clock_is_reported_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], offset_s: float | None, words: str
) -> None:
    devices = PairedDevices(tmp_path / "config" / "retrograph")
    key = "ssh-ed25519 " + "A" * 68
    devices.save(PairedDevice(device_id="rg1", host="bench.local", port=22, user="retrosync", host_key=key))
    seen = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)
    devices.save_sync_state(SyncState(device_id="rg1", synced=seen, clock_offset_s=offset_s, verified=41, failed=0))
    assert main(["status"]) == 0
    assert f"synced 2026-11-21 12:00 UTC: 41 in the library, 0 failed; {words}\n" in capsys.readouterr().out


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_output_that_cannot_be_written_is_a_sentence(store: BundleStore, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "host_sync", "pull", str(store.root), "--library", str(tmp_path / "library")]
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert run.returncode == 1
    assert "the output cannot be written (No space left on device)" in run.stderr
    assert "Traceback" not in run.stderr
    assert "Exception ignored" not in run.stderr
