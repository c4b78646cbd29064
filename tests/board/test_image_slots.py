"""The system's two slots on a card of `make image`: written, tried, kept or gone back from. On a scratch root."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from image_layout import autoboot, command_line, disk_id

Run = Callable[..., subprocess.CompletedProcess[str]]
SCRIPT = "board/image/retrograph-root"
NAME = "retrograph-test"

pytestmark = pytest.mark.skipif(shutil.which("zstd") is None, reason="zstd is not installed")


@pytest.fixture
def card(fresh: Path) -> Path:
    """A scratch root, booted from slot a, whose partitions are files."""
    boots(fresh, "a")
    for number in (2, 3, 5, 6):
        part = fresh / f"dev/disk/by-partuuid/{disk_id(NAME):08x}-0{number}"
        part.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(f"partition {number} as it was")
    for number in (1, 2, 3):
        (fresh / f"run/retrograph-root/{number}").mkdir(parents=True)
    (fresh / "run/retrograph-root/1/autoboot.txt").write_text(autoboot("a"))
    (fresh / "run/retrograph-root/3/cmdline.txt").write_text(command_line("another-card", "a"))
    (fresh / "data").mkdir()
    slot = Path(__file__).parents[2] / "board/retrograph-slot"
    (fresh / "usr/local/sbin/retrograph-slot").write_text(slot.read_text())
    return fresh


@pytest.fixture
def update(tmp_path: Path) -> Path:
    folder = tmp_path / "an update"
    folder.mkdir()
    for part in ("boot", "root"):
        subprocess.run(
            ["zstd", "-q", "-o", folder / f"{part}.img.zst"],
            input=f"new {part}, longer than before",
            text=True,
            check=True,
        )
    return folder


def boots(card: Path, slot: str) -> None:
    """The card is booted from this slot."""
    (card / "proc").mkdir(exist_ok=True)
    (card / "proc/cmdline").write_text(command_line(NAME, slot))


def default_of(card: Path) -> str:
    text = (card / "run/retrograph-root/1/autoboot.txt").read_text()
    (slot,) = (slot for slot in "ab" if autoboot(slot) == text)
    return slot


def partition(card: Path, number: int) -> str:
    return (card / f"dev/disk/by-partuuid/{disk_id(NAME):08x}-0{number}").read_text()


def mailbox(card: Path) -> None:
    """Raspberry Pi's own kernel."""
    (card / "dev/vcio").touch()


def test_status_says_which_slot_is_booted_and_which_is_the_default(card: Path, run: Run) -> None:
    said = run(SCRIPT, "status").stdout
    assert "slot a: partitions 2 and 5, booted, default\n" in said
    assert "slot b: partitions 3 and 6, not filled by this tool\n" in said


def test_an_update_goes_into_the_other_slot_alone(card: Path, run: Run, update: Path) -> None:
    ran = run(SCRIPT, "install", update)
    assert ran.returncode == 0, ran.stderr
    assert partition(card, 3) == "new boot, longer than before"
    assert partition(card, 6) == "new root, longer than before"
    assert (partition(card, 2), partition(card, 5)) == ("partition 2 as it was", "partition 5 as it was")
    assert (card / "run/retrograph-root/3/cmdline.txt").read_text() == command_line(NAME, "b")
    assert default_of(card) == "a"


def test_an_update_of_which_a_byte_is_wrong_is_not_written(card: Path, run: Run, update: Path) -> None:
    (update / "SHA256SUMS").write_text(f"{'0' * 64}  boot.img.zst\n{'0' * 64}  root.img.zst\n")
    ran = run(SCRIPT, "install", update)
    assert ran.returncode == 2
    assert "is not what its SHA256SUMS says" in ran.stderr
    assert partition(card, 6) == "partition 6 as it was"


def test_nothing_is_tried_that_was_not_written(card: Path, run: Run) -> None:
    ran = run(SCRIPT, "try")
    assert (ran.returncode, "slot b holds no whole system" in ran.stderr) == (2, True)
    assert run(SCRIPT, "rollback").returncode == 2
    assert default_of(card) == "a"


def test_a_system_that_runs_is_kept_and_the_one_before_can_be_gone_back_to(card: Path, run: Run, update: Path) -> None:
    mailbox(card)
    run(SCRIPT, "install", update)
    assert "reboot 0 tryboot" in run(SCRIPT, "try").stdout
    assert default_of(card) == "a", "a crash within the trial boots the system before"
    boots(card, "b")
    assert "on trial" in run(SCRIPT, "status").stdout
    assert "the instrument runs in slot b: it stays" in run(SCRIPT, "check").stdout
    assert default_of(card) == "b"
    assert run(SCRIPT, "check").stdout == ""
    assert run(SCRIPT, "rollback").returncode == 0
    assert default_of(card) == "a"


def test_a_system_without_its_instrument_goes_back(card: Path, run: Run, update: Path) -> None:
    mailbox(card)
    run(SCRIPT, "install", update)
    run(SCRIPT, "try")
    boots(card, "b")
    (card / "broken").touch()
    said = run(SCRIPT, "check").stdout
    assert "back to slot a" in said
    assert said.splitlines()[-1].strip() == "retrograph: reboot"
    assert default_of(card) == "a"
    assert not (card / "data/root-trial").exists()
    assert run(SCRIPT, "try").returncode == 2


def test_a_system_that_never_came_up_is_reported_by_the_one_before(card: Path, run: Run, update: Path) -> None:
    mailbox(card)
    run(SCRIPT, "install", update)
    run(SCRIPT, "try")
    assert "slot b did not come up: slot a stays" in run(SCRIPT, "check").stdout
    assert default_of(card) == "a"
    assert not (card / "data/root-trial").exists()


def test_debians_kernel_has_no_single_try_and_says_how_to_go_back(card: Path, run: Run, update: Path) -> None:
    run(SCRIPT, "install", update)
    said = run(SCRIPT, "try").stdout
    assert "boot_partition=2 into autoboot.txt" in said
    assert default_of(card) == "b"
    boots(card, "b")
    (card / "broken").touch()
    run(SCRIPT, "check")
    assert default_of(card) == "a"


def test_another_card_is_refused(fresh: Path, run: Run) -> None:
    (fresh / "proc").mkdir()
    (fresh / "proc/cmdline").write_text("root=/dev/mmcblk0p2 rootwait\n")
    ran = run(SCRIPT, "status")
    assert (ran.returncode, "is not one of `make image`" in ran.stderr) == (2, True)
