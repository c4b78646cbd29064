"""install.sh on a scratch root: what a dry run says is done, a second run has nothing to do, and back again."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hal.board_profile import load_board_profile

Run = Callable[..., subprocess.CompletedProcess[str]]

pytestmark = pytest.mark.skipif(
    shutil.which("systemctl") is None or shutil.which("systemd-sysusers") is None, reason="systemd is not installed"
)
CONFIG = "dtparam=spi=on\n\n[all]\nenable_uart=1\n"
BOARD = ("--board", "pi5-imx296", "--no-app")


def tree(root: Path) -> dict[str, bytes | str]:
    """Every file of a tree by name, without the user data base."""
    return {
        str(path.relative_to(root)): str(path.readlink()) if path.is_symlink() else path.read_bytes()
        for path in sorted(root.rglob("*"))
        if (path.is_symlink() or path.is_file()) and not path.match("etc/*shadow*") and path.name not in USER_FILES
    }


USER_FILES = {"passwd", "passwd-", "group", "group-", ".pwd.lock"}


def folders(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_dir()}


def done(run: subprocess.CompletedProcess[str]) -> list[str]:
    """What it said it did."""
    assert run.returncode == 0, run.stderr
    return [line.strip() for line in run.stdout.splitlines() if line.startswith("  ") and "(" not in line]


def test_a_dry_run_says_all_and_does_nothing(fresh: Path, run: Run) -> None:
    before = tree(fresh)
    promised = done(run("board/install.sh", "--root", fresh, *BOARD, "--read-only", "--usb", "--dry-run"))
    assert tree(fresh) == before
    assert done(run("board/install.sh", "--root", fresh, *BOARD, "--read-only", "--usb")) == promised


def test_a_second_run_finds_everything_in_place(fresh: Path, run: Run) -> None:
    done(run("board/install.sh", "--root", fresh, *BOARD, "--read-only", "--usb"))
    after = tree(fresh)
    again = run("board/install.sh", "--root", fresh, *BOARD, "--read-only", "--usb")
    assert done(again) == []
    assert "Everything is in place." in again.stdout
    assert tree(fresh) == after


def test_what_is_installed(fresh: Path, run: Run) -> None:
    done(run("board/install.sh", "--root", fresh, *BOARD, "--read-only", "--usb"))
    assert (fresh / "etc/default/retroscan").read_text() == "RETROSCAN_BOARD=pi5-imx296\n"
    assert "i2c-dev" in (fresh / "etc/modules-load.d/retrograph.conf").read_text().splitlines()
    assert "include retrograph.txt" in (fresh / "boot/firmware/config.txt").read_text()
    assert "dtoverlay=dwc2,dr_mode=peripheral" in (fresh / "boot/firmware/retrograph.txt").read_text()
    line = (fresh / "boot/firmware/cmdline.txt").read_text()
    assert line.endswith("rootwait overlayroot=tmpfs:recurse=0\n")
    assert line.count("\n") == 1
    wanted = {path.name for path in (fresh / "etc/systemd/system").glob("*.wants/*")}
    assert {"retroscan.service", "data.mount", "retrograph-first-boot.service", "retrograph-usb.service"} <= wanted
    assert "retroscan-tui.service" not in wanted
    network_manager = (fresh / "etc/NetworkManager/conf.d/retrograph.conf").read_text().splitlines()
    assert network_manager[-2:] == ["[main]", "hostname-mode=none"], "the device's name is not the root's"
    network = fresh / "data/network/retrograph-usb.nmconnection"
    assert network.stat().st_mode & 0o777 == 0o600
    users = (fresh / "etc/passwd").read_text()
    assert {line.split(":")[0] for line in users.splitlines()} == {"retroscan", "retrosync"}
    assert all(line.endswith("/nologin") for line in users.splitlines())


@pytest.mark.parametrize(
    ("board", "wanted"),
    [
        ("pi5-imx296", ["camera_auto_detect=0", "dtoverlay=imx296"]),
        ("pi4-imx477-binned", ["camera_auto_detect=0", "dtoverlay=imx477"]),
        ("zero2w-imx708", ["camera_auto_detect=0", "dtoverlay=imx708"]),
        ("twin", ["camera_auto_detect=1"]),
    ],
)
def test_the_firmware_loads_the_overlay_of_the_profiles_sensor(
    fresh: Path, run: Run, board: str, wanted: list[str]
) -> None:
    done(run("board/install.sh", "--root", fresh, "--board", board, "--no-app"))
    lines = (fresh / "boot/firmware/retrograph.txt").read_text().splitlines()
    assert [line for line in lines if line.startswith(("camera_auto_detect", "dtoverlay=imx"))] == wanted
    assert "dtoverlay=retrograph" in lines


def test_whoever_asks_the_light_driver_at_boot_waits_for_its_bus(fresh: Path, run: Run) -> None:
    """The trial too, or an update that a power cut left unconfirmed would be undone for a late bus."""
    done(run("board/install.sh", "--root", fresh, *BOARD))
    waiting = {path.parent.name for path in (fresh / "etc/systemd/system").glob("*.service.d/i2c.conf")}
    assert waiting == {"retroscan.service.d", "retroscan-tui.service.d", "retrograph-trial.service.d"}


def test_the_screen_takes_the_place_of_the_headless_unit_and_gives_it_back(fresh: Path, run: Run) -> None:
    def wanted() -> set[str]:
        found = {path.name for path in (fresh / "etc/systemd/system").glob("multi-user.target.wants/*")}
        return found & {"retroscan.service", "retroscan-tui.service"}

    for screen, unit in (
        ("none", "retroscan.service"),
        ("panel", "retroscan-tui.service"),
        ("none", "retroscan.service"),
    ):
        done(run("board/install.sh", "--root", fresh, *BOARD, "--screen", screen))
        assert wanted() == {unit}


def test_a_card_without_ssh_is_reported(fresh: Path, run: Run) -> None:
    """Raspberry Pi OS switches it on only when asked, and scans are fetched through it."""
    off = "SSH is switched off"
    assert off in run("board/install.sh", "--root", fresh, *BOARD).stdout
    (fresh / "etc/systemd/system/multi-user.target.wants/ssh.service").symlink_to("/lib/systemd/system/ssh.service")
    assert off not in run("board/install.sh", "--root", fresh, *BOARD).stdout


def test_it_goes_on_where_it_was_interrupted(fresh: Path, run: Run) -> None:
    """Whatever is missing or half, a run makes whole; nothing else is touched."""
    done(run("board/install.sh", "--root", fresh, *BOARD))
    whole = tree(fresh)
    (fresh / "etc/systemd/system/retroscan.service").write_text("[Unit]\n")
    (fresh / "etc/default/retroscan").unlink()
    (fresh / "usr/local/bin/retroscan").unlink()
    (fresh / "boot/firmware/config.txt").write_text(CONFIG)
    shutil.rmtree(fresh / "etc/udev/rules.d")
    repaired = done(run("board/install.sh", "--root", fresh, *BOARD))
    assert len(repaired) == 5
    assert tree(fresh) == whole


def test_uninstall_leaves_the_card_as_it_was_and_every_scan(fresh: Path, run: Run) -> None:
    before, before_folders = tree(fresh), folders(fresh)
    done(run("board/install.sh", "--root", fresh, *BOARD, "--read-only", "--usb"))
    scan = fresh / "data/store/scans/rg1-00000000-000001/scan.json"
    scan.parent.mkdir(parents=True)
    scan.write_text("{}")
    dry = done(run("board/install.sh", "--root", fresh, "--uninstall", "--dry-run"))
    assert scan.exists()
    assert done(run("board/install.sh", "--root", fresh, "--uninstall")) == dry
    kept = str(scan.relative_to(fresh))
    assert tree(fresh) == before | {kept: b"{}"}
    assert folders(fresh) == before_folders | {str(path) for path in Path(kept).parents} - {"."}
    assert done(run("board/install.sh", "--root", fresh, "--uninstall")) == []


def test_a_read_only_root_becomes_writable_and_nothing_else_is_touched(fresh: Path, run: Run) -> None:
    """What an install or an uninstall on a device with a read-only root begins with."""
    line = (fresh / "boot/firmware/cmdline.txt").read_bytes()
    done(run("board/install.sh", "--root", fresh, *BOARD, "--read-only"))
    before = tree(fresh)
    promised = done(run("board/install.sh", "--root", fresh, "--writable", "--dry-run"))
    assert tree(fresh) == before
    read_only = "etc/systemd/system/boot-firmware.mount.d/retrograph.conf"
    assert promised == ["write /boot/firmware/cmdline.txt", f"remove /{read_only}"]
    assert done(run("board/install.sh", "--root", fresh, "--writable")) == promised
    del before[read_only]
    assert tree(fresh) == before | {"boot/firmware/cmdline.txt": line}
    assert done(run("board/install.sh", "--root", fresh, "--writable")) == []


def test_uninstall_keeps_what_was_added_to_the_configuration_since(fresh: Path, run: Run) -> None:
    done(run("board/install.sh", "--root", fresh, *BOARD))
    config = fresh / "boot/firmware/config.txt"
    config.write_text(config.read_text() + "dtoverlay=mine\n")
    done(run("board/install.sh", "--root", fresh, "--uninstall"))
    assert config.read_text() == CONFIG + "\n[all]\ndtoverlay=mine\n"


def test_what_a_card_held_before_is_kept(fresh: Path, run: Run) -> None:
    """Scans of an earlier life, the host key that workstations pinned, and a name that somebody chose."""
    scan = fresh / "var/lib/retroscan/scans/old/scan.json"
    scan.parent.mkdir(parents=True)
    scan.write_text("old")
    key = fresh / "etc/ssh/ssh_host_ed25519_key"
    key.parent.mkdir(parents=True, exist_ok=True)
    key.write_text("secret")
    key.with_name(key.name + ".pub").write_text("public")
    (fresh / "etc/hostname").write_text("turbine-lab\n")
    done(run("board/install.sh", "--root", fresh, *BOARD))
    assert (fresh / "data/store/scans/old/scan.json").read_text() == "old"
    assert (fresh / "data/ssh/ssh_host_ed25519_key").read_text() == "secret"
    assert key.is_symlink()
    assert (fresh / "data/hostname").read_text() == "turbine-lab\n"
    done(run("board/install.sh", "--root", fresh, "--uninstall"))
    assert not key.is_symlink()
    assert key.read_text() == "secret"
    assert (fresh / "data/store/scans/old/scan.json").read_text() == "old"
    assert scan.read_text() == "old"


def test_a_copy_that_was_interrupted_is_made_again(fresh: Path, run: Run) -> None:
    """Half of the scans of an earlier life, or a public key without its key, are not taken for the whole."""
    for name in ("a", "b"):
        scan = fresh / f"var/lib/retroscan/scans/{name}/scan.json"
        scan.parent.mkdir(parents=True)
        scan.write_text(name)
    half = fresh / "data/store.new/scans/a"
    half.mkdir(parents=True)
    key = fresh / "etc/ssh/ssh_host_ed25519_key"
    key.parent.mkdir(parents=True, exist_ok=True)
    key.write_text("secret")
    key.with_name(key.name + ".pub").write_text("public")
    (fresh / "data/ssh").mkdir()
    (fresh / "data/ssh/ssh_host_ed25519_key.pub").write_text("pub")
    done(run("board/install.sh", "--root", fresh, *BOARD))
    assert {path.read_text() for path in (fresh / "data/store/scans").glob("*/scan.json")} == {"a", "b"}
    assert not half.exists()
    assert [(fresh / f"data/ssh/{key.name}{end}").read_text() for end in ("", ".pub")] == ["secret", "public"]


def test_uninstall_gives_back_networks_and_leaves_nothing_half_written(fresh: Path, run: Run) -> None:
    done(run("board/install.sh", "--root", fresh, *BOARD, "--usb"))
    (fresh / "data/network/lab.nmconnection").write_text("[wifi]\n")
    (fresh / "etc/systemd/system/retroscan.service.new").write_text("[Un")
    done(run("board/install.sh", "--root", fresh, "--uninstall"))
    network = fresh / "etc/NetworkManager/system-connections/lab.nmconnection"
    assert network.read_text() == "[wifi]\n"
    assert network.stat().st_mode & 0o777 == 0o600
    assert [path.name for path in network.parent.iterdir()] == [network.name]
    assert list(fresh.rglob("*.new")) == []


def test_networks_of_netplan_are_kept_too_and_given_back(fresh: Path, run: Run) -> None:
    """Raspberry Pi OS trixie: what nmcli adds is YAML in /etc/netplan."""
    wifi = fresh / "etc/netplan/50-cloud-init.yaml"
    wifi.write_text("network: {version: 2}\n")
    done(run("board/install.sh", "--root", fresh, *BOARD))
    kept = fresh / "data/netplan"
    assert (kept / wifi.name).read_text() == wifi.read_text()
    wanted = {path.name for path in (fresh / "etc/systemd/system").glob("*.wants/*")}
    assert {"etc-netplan.mount", "retrograph-networks.service"} <= wanted
    (kept / "90-NM-lab.yaml").write_text("network: {version: 2}\n")
    done(run("board/install.sh", "--root", fresh, "--uninstall"))
    assert (wifi.parent / "90-NM-lab.yaml").stat().st_mode & 0o777 == 0o600
    assert {path.name for path in wifi.parent.iterdir()} == {"90-NM-lab.yaml", wifi.name}


def test_without_netplan_nothing_of_it_is_mounted(fresh: Path, run: Run) -> None:
    """Bookworm, where NetworkManager keeps key files."""
    (fresh / "etc/os-release").write_text("ID=debian\nVERSION_CODENAME=bookworm\n")
    (fresh / "usr/libexec/netplan/generate").unlink()
    done(run("board/install.sh", "--root", fresh, *BOARD))
    wanted = {path.name for path in (fresh / "etc/systemd/system").glob("*.wants/*")}
    assert {name for name in wanted if "netplan" in name or "networks" in name} == set()
    assert not (fresh / "data/netplan").exists()


def test_cloud_init_is_switched_off_once_it_has_done_its_work(fresh: Path, run: Run) -> None:
    """And switched on again by whoever takes Retrograph away; a file of somebody else's stays theirs."""
    off = fresh / "etc/cloud/cloud-init.disabled"
    off.parent.mkdir()
    assert "cloud-init has not finished" in run("board/install.sh", "--root", fresh, *BOARD).stdout
    assert not off.exists()
    finished = fresh / "var/lib/cloud/instances/rpi/boot-finished"
    finished.parent.mkdir(parents=True)
    finished.touch()
    assert done(run("board/install.sh", "--root", fresh, *BOARD)) == ["write /etc/cloud/cloud-init.disabled"]
    done(run("board/install.sh", "--root", fresh, "--uninstall"))
    assert not off.exists()
    off.touch()
    done(run("board/install.sh", "--root", fresh, *BOARD))
    done(run("board/install.sh", "--root", fresh, "--uninstall"))
    assert off.read_bytes() == b""


def test_a_named_device_is_mounted_and_checked(fresh: Path, run: Run) -> None:
    done(run("board/install.sh", "--root", fresh, *BOARD, "--data", "/dev/disk/by-id/usb-x_1-part2"))
    mount = (fresh / "etc/systemd/system/data.mount").read_text()
    assert "What=/dev/disk/by-id/usb-x_1-part2\n" in mount
    assert mount.count(r"systemd-fsck@dev-disk-by\x2did-usb\x2dx_1\x2dpart2.service") == 2
    assert "retrograph-data" not in mount


def test_a_profile_of_ones_own_is_copied(fresh: Path, run: Run, tmp_path: Path) -> None:
    own = tmp_path / "mine.toml"
    shutil.copy(Path(__file__).parents[2] / "board" / "twin.toml", own)
    done(run("board/install.sh", "--root", fresh, "--board", own, "--no-app"))
    assert (fresh / "etc/default/retroscan").read_text() == "RETROSCAN_BOARD=/etc/retrograph/board.toml\n"
    assert load_board_profile(fresh / "etc/retrograph/board.toml").name == "twin"
    assert not (fresh / "etc/systemd/system/retroscan.service.d").exists()


def test_the_program_comes_with_it_once(fresh: Path, run: Run, release: Callable[..., Path]) -> None:
    arguments = ("--root", fresh, "--board", "twin", "--release", release("1.0"))
    assert "install version 1.0" in " ".join(done(run("board/install.sh", *arguments)))
    assert (fresh / "data/app/current").readlink() == Path("a")
    assert (fresh / "usr/local/bin/retroscan").readlink() == Path("/data/app/current/bin/retroscan")
    assert done(run("board/install.sh", *arguments)) == []


def test_another_wheel_of_the_same_version_is_installed(fresh: Path, run: Run, release: Callable[..., Path]) -> None:
    folder = release("1.0")
    arguments = ("--root", fresh, "--board", "twin", "--release", folder)
    done(run("board/install.sh", *arguments))
    next(folder.glob("*.whl")).write_text("mended")
    assert done(run("board/install.sh", *arguments)) == [f"install version 1.0 from {folder}"]
    assert (fresh / "data/app/current").readlink() == Path("b")
    assert done(run("board/install.sh", *arguments)) == []


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--board", "moon", "--no-app"], "there is no board profile 'moon': digit"),
        ([*BOARD, "--data", "sda1"], "a device such as /dev/sda1"),
        ([*BOARD, "--data", "folder", "--read-only"], "would be lost"),
        ([*BOARD, "--data", "/dev/sda1|e id"], "such a name no device has"),
        (["--board", "wiring/wiring", "--no-app"], "the name of a profile"),
        ([*BOARD, "--screen", "huge"], "panel or none"),
        (["--board", "twin", "--release", "/nowhere"], "is no folder: run `make release` first"),
        (["--board"], "usage:"),
        (["--root", "/nowhere", "--no-app", "--board", "twin"], "is no folder"),
        (["--frobnicate"], "usage:"),
    ],
)
def test_bad_wishes_are_refused_before_anything_is_done(
    fresh: Path, run: Run, arguments: list[str], sentence: str
) -> None:
    before = tree(fresh)
    ran = run("board/install.sh", "--root", fresh, *arguments)
    assert ran.returncode == 2
    assert sentence in ran.stderr
    assert tree(fresh) == before


def test_another_system_is_refused(fresh: Path, run: Run) -> None:
    (fresh / "etc/os-release").write_text("ID=debian\nVERSION_CODENAME=bullseye\n")
    ran = run("board/install.sh", "--root", fresh, *BOARD)
    assert (ran.returncode, "this is 'bullseye'" in ran.stderr) == (2, True)
