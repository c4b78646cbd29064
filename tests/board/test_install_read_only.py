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
BOOT_READ_ONLY = "etc/systemd/system/boot-firmware.mount.d/retrograph.conf"
KERNELS = ("6.12.75+rpt-rpi-v8", "6.12.75+rpt-rpi-2712")
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


def test_the_command_line_is_the_last_thing_that_is_written(fresh: Path, run: Run) -> None:
    """An installation that fails before, for want of a network perhaps, leaves a root that can be written."""
    assert install(run, fresh, *BOARD)[-1] == "write /boot/firmware/cmdline.txt"


def test_a_program_that_cannot_be_installed_leaves_the_root_writable(fresh: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "release").mkdir()
    wishes = (*(word for word in BOARD if word != "--no-app"), "--release", tmp_path / "release")
    assert run("board/install.sh", "--root", fresh, *wishes).returncode != 0
    assert "overlayroot" not in (fresh / "boot/firmware/cmdline.txt").read_text()


@pytest.mark.parametrize("missing", ["config.txt", "cmdline.txt"])
def test_without_a_boot_partition_nothing_is_done(fresh: Path, run: Run, missing: str) -> None:
    (fresh / "boot/firmware" / missing).unlink()
    before = sorted(fresh.rglob("*"))
    ran = run("board/install.sh", "--root", fresh, *BOARD)
    assert (ran.returncode, "mount the boot partition" in ran.stderr) == (2, True), ran.stderr
    assert sorted(fresh.rglob("*")) == before


def test_the_boot_partition_is_read_only_as_long_as_the_root_is(fresh: Path, run: Run) -> None:
    assert f"write /{BOOT_READ_ONLY}" in install(run, fresh, *BOARD)
    assert (fresh / BOOT_READ_ONLY).read_text() == "[Mount]\nOptions=ro\n"
    assert f"remove /{BOOT_READ_ONLY}" in install(run, fresh, "--writable")
    install(run, fresh, *BOARD)
    install(run, fresh, "--uninstall")
    assert not (fresh / BOOT_READ_ONLY).parent.exists()
    assert not list((fresh / "usr/share/initramfs-tools/modules.d").iterdir())
    assert not list((fresh / "etc/initramfs/post-update.d").iterdir())


@pytest.mark.skipif(
    not Path("/usr/lib/systemd/system-generators/systemd-fstab-generator").exists(), reason="systemd is not installed"
)
def test_systemd_mounts_the_boot_partition_of_fstab_as_that_file_has_it(fresh: Path, run: Run, tmp_path: Path) -> None:
    """Its unit is made of fstab; the file beside it is the later word on the options."""
    install(run, fresh, *BOARD)
    fstab, units = tmp_path / "fstab", tmp_path / "units"
    fstab.write_text("PARTUUID=deadbeef-01 /boot/firmware vfat defaults 0 2\n")
    units.mkdir()
    subprocess.run(
        ["/usr/lib/systemd/system-generators/systemd-fstab-generator", units, units, units],
        env={**os.environ, "SYSTEMD_FSTAB": str(fstab), "SYSTEMD_PROC_CMDLINE": "root=PARTUUID=deadbeef-02"},
        check=True,
    )
    assert "Where=/boot/firmware" in (units / "boot-firmware.mount").read_text()
    assert (fresh / BOOT_READ_ONLY).parent.name == "boot-firmware.mount.d"


@pytest.fixture
def live(fresh: Path, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Make the initramfs of a scratch root, with an update-initramfs that makes what `makes` lists."""
    programs = tmp_path / "bin"
    programs.mkdir()
    listing = '#!/bin/bash\ncat "${*: -1}"\n'
    update = '#!/bin/bash\necho "$*" >>"$ROOT/asked"; printf "%s\\n" $MAKES >"$ROOT/boot/initrd.img-$3"\n'
    for name, text in (("lsinitramfs", listing), ("update-initramfs", update)):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    for kernel in KERNELS:
        (fresh / "lib/modules" / kernel).mkdir(parents=True)
        (fresh / "boot" / f"vmlinuz-{kernel}").touch()

    def run(makes: str, dry: str = "no") -> subprocess.CompletedProcess[str]:
        root = Path(__file__).parents[2]
        script = (
            f"set -euo pipefail; here={root}; root=$ROOT; dry={dry}; changes=0; scratch={tmp_path}\n"
            'say() { echo "$*"; }; live() { false; }\n'
            'for part in actions firmware; do . "$here/board/install/$part.sh"; done\n'
            "make_initramfs /boot/firmware"
        )
        environment = {"PATH": f"{programs}:{os.environ['PATH']}", "ROOT": str(fresh), "MAKES": makes}
        return subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True, check=False)

    return run


def test_every_initramfs_is_asked_for_the_overlay_and_checked(fresh: Path, run: Run) -> None:
    install(run, fresh, *BOARD)
    named = (fresh / "usr/share/initramfs-tools/modules.d/retrograph").read_text().splitlines()
    assert [line for line in named if not line.startswith("#")] == ["overlay"]
    assert os.access(fresh / "etc/initramfs/post-update.d/zz-retrograph", os.X_OK)


WHOLE = "scripts/init-bottom/overlayroot usr/lib/modules/6.12/kernel/fs/overlayfs/overlay.ko.xz"


def test_every_kernel_gets_an_initramfs_with_the_overlay_also_where_it_had_none(
    fresh: Path, live: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """Bookworm's overlayroot makes that of the kernel that a Pi 4 boots, and leaves out that of a Pi 5."""
    (fresh / f"boot/initrd.img-{KERNELS[0]}").write_text("\n".join(WHOLE.split()))
    ran = live(WHOLE)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (fresh / "asked").read_text().splitlines() == [f"-c -k {KERNELS[1]}"]
    assert live(WHOLE).stdout == "", "the second run finds everything in place"


@pytest.mark.parametrize(
    ("makes", "lacks"),
    [
        ("scripts/init-bottom/overlayroot usr/lib/modules/6.18.29/kernel/fs/ext4/ext4.ko.xz", "the driver overlay"),
        ("usr/lib/modules/6.12/kernel/fs/overlayfs/overlay.ko", "the script overlayroot"),
        ("init", "the script overlayroot and the driver overlay"),
    ],
)
def test_an_initramfs_without_overlay_is_refused_by_name(
    fresh: Path, live: Callable[..., subprocess.CompletedProcess[str]], makes: str, lacks: str
) -> None:
    """What overlayroot itself passes over in silence."""
    ran = live(makes)
    assert ran.returncode == 1
    images = [f"{fresh}/boot/initrd.img-{kernel}" for kernel in sorted(KERNELS)]
    assert ran.stderr.splitlines() == [
        f"retrograph: {images[0]} lacks {lacks}: the root file system would be writable",
        "install.sh: an initramfs cannot mount an overlay: the root file system stays writable",
    ]


def test_a_long_listing_is_read_to_its_end(live: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    """That of a real initramfs has thousands of lines: none of what reads it may stop early and fail the pipe."""
    modules = (f"usr/lib/modules/6.12/kernel/{number}/{'x' * 60}.ko" for number in range(1200))
    ran = live(" ".join([*modules, WHOLE]))
    assert (ran.returncode, ran.stderr) == (0, "")


def test_the_firmwares_own_copy_is_looked_at_too(
    fresh: Path, live: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    (fresh / "boot/firmware/initramfs_2712").write_text("init\n")
    ran = live(WHOLE)
    assert ran.returncode == 1
    assert f"{fresh}/boot/firmware/initramfs_2712 lacks the script overlayroot" in ran.stderr


def test_a_system_without_any_initramfs_is_refused(
    fresh: Path, live: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    shutil.rmtree(fresh / "lib/modules")
    ran = live(WHOLE)
    assert ran.returncode == 1
    assert "there is no initramfs in /boot/firmware or /boot, which an overlay needs" in ran.stderr
    assert live(WHOLE, dry="yes").returncode == 0


def test_a_kernel_update_without_overlay_fails_by_name(
    fresh: Path, live: Callable[..., subprocess.CompletedProcess[str]], run: Run, tmp_path: Path
) -> None:
    """update-initramfs runs what is in post-update.d after each image, with version and image."""
    install(run, fresh, *BOARD)
    image = tmp_path / "initrd.img-6.18.29"
    image.write_text("scripts/init-bottom/overlayroot\n")
    check = fresh / "etc/initramfs/post-update.d/zz-retrograph"
    environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    ran = subprocess.run([check, "6.18.29", image], env=environment, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr.count("\n")) == (1, 1)
    assert f"{image} lacks the driver overlay" in ran.stderr
