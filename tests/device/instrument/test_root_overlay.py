"""A root that is writable although an overlay was asked for is an alarm in status, journal and self-test."""

from pathlib import Path

import pytest

from device.acquisition import selftest as self_test
from device.acquisition.selftest import selftest
from device.cli.service import status_line
from device.instrument.events import Failed
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.hardware import Hardware

ASKED = "console=tty1 root=PARTUUID=deadbeef-02 rootwait overlayroot=tmpfs:recurse=0\n"
EXT4 = "/dev/mmcblk0p2 / ext4 rw,noatime 0 0\n/dev/mmcblk0p3 /data ext4 rw 0 0\n"
OVERLAY = "sysfs /sys sysfs rw 0 0\noverlayroot / overlay rw,lowerdir=/media/root-ro 0 0\n"


@pytest.fixture(autouse=True)
def proc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "self").mkdir()
    monkeypatch.setattr(self_test, "PROC", tmp_path)
    return tmp_path


def boot(proc: Path, command_line: str, mounts: str) -> str | None:
    (proc / "cmdline").write_text(command_line)
    (proc / "self/mounts").write_text(mounts)
    return self_test.root_fault()


@pytest.mark.parametrize(
    ("command_line", "mounts"),
    [
        (ASKED, OVERLAY),
        (ASKED, "rootfs / rootfs rw 0 0\n" + OVERLAY),
        ("console=tty1 rootwait\n", EXT4),
        ("rootwait overlayroot=disabled\n", EXT4),
    ],
)
def test_a_root_that_is_what_was_asked_for_is_no_fault(proc: Path, command_line: str, mounts: str) -> None:
    assert boot(proc, command_line, mounts) is None


def test_a_writable_root_is_named_by_status_journal_and_selftest(
    proc: Path, hardware: Hardware, calibrated: BundleStore
) -> None:
    assert "root file system" not in [finding.part for finding in selftest(hardware)]
    fault = boot(proc, ASKED, EXT4)
    assert fault == self_test.WRITABLE
    with Instrument(hardware, calibrated) as instrument:
        instrument.step()
        assert status_line(instrument.state).endswith(f"; {fault}")
        assert [event for event in instrument.take_events() if event == Failed(fault)], "which the journal prints"
    (found,) = [finding for finding in selftest(hardware) if finding.part == "root file system"]
    assert (found.state, found.sentence) == ("warning", fault)


def test_what_is_no_linux_has_no_such_root() -> None:
    assert self_test.root_fault() is None
