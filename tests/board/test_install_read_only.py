"""install.sh --read-only: no swap file in memory, and nothing before cloud-init has set the card up."""

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

pytestmark = pytest.mark.skipif(
    shutil.which("systemctl") is None or shutil.which("systemd-sysusers") is None, reason="systemd is not installed"
)
BOARD = ("--board", "pi5-imx296", "--no-app", "--read-only")
NO_FILE = "etc/systemd/system/dphys-swapfile.service.d/retrograph.conf"
IN_MEMORY = "etc/rpi/swap.conf.d/90-retrograph.conf"
CONFIGURATION = "etc/rpi/swap.conf"


def install(run: Run, fresh: Path, *arguments: str) -> list[str]:
    """What it said it did."""
    ran = run("board/install.sh", "--root", fresh, *arguments)
    assert ran.returncode == 0, ran.stderr
    return [line.strip() for line in ran.stdout.splitlines() if line.startswith("  ") and "(" not in line]


def executable(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)


@pytest.fixture
def swapping(fresh: Path) -> Path:
    """A card with the swap of both systems."""
    executable(fresh / "usr/sbin/dphys-swapfile")
    executable(fresh / "usr/lib/systemd/system-generators/rpi-swap-generator")
    (fresh / "etc/rpi").mkdir()
    (fresh / CONFIGURATION).write_text("[Main]\n#Mechanism=auto\n")
    return fresh


def test_a_swap_file_is_never_kept_in_memory(swapping: Path, run: Run) -> None:
    promised = install(run, swapping, *BOARD, "--dry-run")
    assert install(run, swapping, *BOARD) == promised
    assert {f"write /{NO_FILE}", f"write /{IN_MEMORY}"} <= set(promised)
    assert "[Unit]\nConditionKernelCommandLine=!overlayroot\n" in (swapping / NO_FILE).read_text()
    assert "overlayroot=" in (swapping / "boot/firmware/cmdline.txt").read_text(), "what that condition looks for"
    assert "[Main]\nMechanism=zram\n" in (swapping / IN_MEMORY).read_text()
    assert install(run, swapping, *BOARD) == []


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@pytest.mark.parametrize(("added", "starts"), [(" overlayroot=tmpfs:recurse=0", False), ("", True)])
def test_systemd_skips_bookworms_swap_file_at_a_boot_with_an_overlay_alone(added: str, starts: bool) -> None:
    text = (Path(__file__).parents[2] / "systemd/dphys-swapfile-retrograph.conf").read_text(encoding="utf-8")
    ran = subprocess.run(
        ["systemd-analyze", "condition", text.splitlines()[-1]],
        env={**os.environ, "SYSTEMD_PROC_CMDLINE": f"console=tty1 root=PARTUUID=deadbeef-02{added}"},
        capture_output=True,
        check=False,
    )
    assert (ran.returncode == 0) == starts


def test_a_writable_root_swaps_as_before(swapping: Path, run: Run) -> None:
    assert not any("swap" in line for line in install(run, swapping, *BOARD[:-1]))
    install(run, swapping, *BOARD)
    assert f"remove /{IN_MEMORY}" in install(run, swapping, "--writable")
    assert not (swapping / IN_MEMORY).exists()
    install(run, swapping, *BOARD)
    install(run, swapping, "--uninstall")
    assert not (swapping / NO_FILE).parent.exists()
    assert [path.name for path in (swapping / "etc/rpi").iterdir()] == ["swap.conf"]


def test_who_chose_no_swap_gets_none(swapping: Path, run: Run) -> None:
    (swapping / CONFIGURATION).write_text("[Main]\nMechanism=none\n")
    assert f"write /{IN_MEMORY}" not in install(run, swapping, *BOARD)


def test_a_system_without_swap_is_left_alone(fresh: Path, run: Run) -> None:
    assert not any("swap" in line for line in install(run, fresh, *BOARD))
    assert not (fresh / "etc/rpi").exists()


def test_a_card_that_cloud_init_has_not_set_up_is_not_made_read_only(fresh: Path, run: Run) -> None:
    """It would be set up anew at every boot, and forget it."""
    executable(fresh / "usr/bin/cloud-init")
    (fresh / "etc/cloud").mkdir()
    line = (fresh / "boot/firmware/cmdline.txt").read_text()
    ran = run("board/install.sh", "--root", fresh, *BOARD)
    assert (ran.returncode, ran.stderr.count("\n")) == (2, 1)
    assert "cloud-init has not set this card up yet: let it boot to the end" in ran.stderr
    assert (fresh / "boot/firmware/cmdline.txt").read_text() == line
    assert not (fresh / "data").exists()
    assert "--read-only waits for it" in run("board/install.sh", "--root", fresh, *BOARD, "--dry-run").stdout
    assert install(run, fresh, *BOARD[:-1]), "a writable root is none of its business"
    (fresh / "var/lib/cloud/instances/rpi").mkdir(parents=True)
    (fresh / "var/lib/cloud/instances/rpi/boot-finished").touch()
    assert "write /etc/cloud/cloud-init.disabled" in install(run, fresh, *BOARD)


@pytest.mark.parametrize("off", ["etc/cloud/cloud-init.disabled", "run/cloud-init/disabled"])
def test_a_cloud_init_that_is_switched_off_is_not_waited_for(fresh: Path, run: Run, off: str) -> None:
    executable(fresh / "usr/bin/cloud-init")
    (fresh / off).parent.mkdir(parents=True)
    (fresh / off).touch()
    assert install(run, fresh, *BOARD)
