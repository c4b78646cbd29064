"""What a device gets of its own at its first boot, once; and the USB adapter that it shows."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from unit_files import settings

Run = Callable[..., subprocess.CompletedProcess[str]]
UNPAIRED = (
    "retrograph: no workstation was ever paired: "
    "the instrument opens the pairing window and shows codes on the console\n"
)
needs_ssh = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="OpenSSH is not installed")


@pytest.fixture
def program(fresh: Path) -> Path:
    """A `retroscan` that draws another id whenever it is asked."""
    path = fresh / "usr/local/bin/retroscan"
    path.parent.mkdir(parents=True, exist_ok=True)
    store = fresh / "var/lib/retroscan"
    store.mkdir(parents=True, exist_ok=True)
    drawn = f'echo "{{}}" >"{store}/device.json"'
    path.write_text(f'#!/bin/bash\necho "$*" >>"${{0}}-calls"\n{drawn}\necho "rg$RANDOM"\n')
    path.chmod(0o755)
    return path


@needs_ssh
def test_key_and_name_are_made_once(fresh: Path, run: Run, program: Path) -> None:
    first = run("systemd/first-boot", RETROSCAN_BOARD="twin")
    assert first.returncode == 0, first.stderr
    key, name = fresh / "data/ssh/ssh_host_ed25519_key", fresh / "data/hostname"
    made = (key.read_bytes(), key.with_name(key.name + ".pub").read_bytes(), name.read_text())
    assert key.stat().st_mode & 0o777 == 0o600
    assert key.with_name(key.name + ".pub").stat().st_mode & 0o777 == 0o644, "read when a workstation pairs"
    assert made[2].startswith("rg")
    assert "made the host key SHA256:" in first.stdout
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").stdout == UNPAIRED
    assert (key.read_bytes(), key.with_name(key.name + ".pub").read_bytes(), name.read_text()) == made
    store = fresh / "var/lib/retroscan"
    assert program.with_name("retroscan-calls").read_text() == f"--board twin --store {store} identity\n"


@needs_ssh
def test_a_code_is_not_written_across_the_screen_of_a_panel(fresh: Path, run: Run, program: Path) -> None:
    enabled = fresh / "etc/systemd/system/multi-user.target.wants/retroscan-tui.service"
    enabled.parent.mkdir(parents=True)
    enabled.symlink_to("/etc/systemd/system/retroscan-tui.service")
    said = run("systemd/first-boot", RETROSCAN_BOARD="twin").stdout
    assert "Set-up on the screen opens the pairing window" in said
    assert UNPAIRED not in said


@needs_ssh
def test_a_name_that_somebody_chose_stays(fresh: Path, run: Run, program: Path) -> None:
    name = fresh / "data/hostname"
    name.parent.mkdir(parents=True)
    name.write_text("turbine-lab\n")
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").returncode == 0
    assert name.read_text() == "turbine-lab\n"
    assert (fresh / "var/lib/retroscan/device.json").exists()


@needs_ssh
def test_a_power_cut_in_the_middle_costs_nothing(fresh: Path, run: Run, program: Path) -> None:
    folder = fresh / "data/ssh"
    folder.mkdir(parents=True)
    (folder / "ssh_host_ed25519_key.new").write_text("half")
    (folder / "ssh_host_ed25519_key").touch()
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").returncode == 0
    assert b"PRIVATE KEY" in (folder / "ssh_host_ed25519_key").read_bytes()
    assert not (folder / "ssh_host_ed25519_key.new").exists()


@needs_ssh
def test_a_public_key_that_was_lost_is_made_from_the_key(fresh: Path, run: Run, program: Path) -> None:
    run("systemd/first-boot", RETROSCAN_BOARD="twin")
    key = fresh / "data/ssh/ssh_host_ed25519_key"
    public = key.with_name(key.name + ".pub")
    before, secret = public.read_text().split()[:2], key.read_bytes()
    public.write_text("")
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").returncode == 0
    assert (public.read_text().split()[:2], key.read_bytes()) == (before, secret)


@needs_ssh
def test_a_name_that_is_none_is_refused(fresh: Path, run: Run, program: Path) -> None:
    program.write_text("#!/bin/bash\necho 'rg1; reboot'\n")
    ran = run("systemd/first-boot", RETROSCAN_BOARD="twin")
    assert ran.returncode != 0
    assert "tells no id" in ran.stderr
    assert not (fresh / "data/hostname").exists()


@pytest.fixture
def device(fresh: Path, run: Run, program: Path) -> Path:
    """The data partition of a device that was set up, paired and calibrated in the board of that number."""
    number = fresh / "sys/firmware/devicetree/base/serial-number"
    number.parent.mkdir(parents=True)
    number.write_bytes(b"100000001234abcd\0")
    (fresh / "data").mkdir(exist_ok=True)
    program.write_text(program.read_text().replace("rg$RANDOM", "rg$(printf %08x $RANDOM)"))
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").returncode == 0
    for place in ("var/lib/retroscan-pairing/authorized_keys", "var/lib/retroscan/active.json"):
        (fresh / place).parent.mkdir(parents=True, exist_ok=True)
        (fresh / place).write_text("of the first board\n")
    scan = fresh / "var/lib/retroscan/scans/rg1/scan.json"
    scan.parent.mkdir(parents=True)
    scan.touch()
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").stdout == ""
    return fresh


def identity(root: Path) -> list[str]:
    return [(root / place).read_text() for place in ("data/ssh/ssh_host_ed25519_key.pub", "data/hostname")]


@needs_ssh
@pytest.mark.parametrize("cut", [False, True], ids=["whole", "after a power cut"])
def test_a_copied_card_is_another_device_and_says_so(device: Path, run: Run, cut: bool) -> None:
    before = identity(device)
    (device / "sys/firmware/devicetree/base/serial-number").write_bytes(b"10000000deadbeef\0")
    if cut:
        (device / "data/ssh/ssh_host_ed25519_key").unlink()
        (device / "var/lib/retroscan/device.json").unlink()
    ran = run("systemd/first-boot", RETROSCAN_BOARD="twin")
    assert ran.returncode == 0, ran.stderr
    assert "was set up in another board (number 100000001234abcd)" in ran.stderr
    assert "pair every workstation again, and calibrate" in ran.stderr
    assert all(old != new for old, new in zip(before, identity(device), strict=True))
    paired = device / "var/lib/retroscan-pairing/authorized_keys"
    assert not paired.exists()
    assert paired.with_name("authorized_keys.of-another-board").exists()
    assert not (device / "var/lib/retroscan/active.json").exists()
    assert (device / "var/lib/retroscan/scans/rg1/scan.json").exists()
    assert (device / "data/board").read_text() == "10000000deadbeef\n"
    after = identity(device)
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").stderr == ""
    assert identity(device) == after


@needs_ssh
def test_a_chosen_name_stays_on_a_copied_card(device: Path, run: Run) -> None:
    (device / "data/hostname").write_text("turbine-lab\n")
    (device / "sys/firmware/devicetree/base/serial-number").write_bytes(b"10000000deadbeef\0")
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").returncode == 0
    assert (device / "data/hostname").read_text() == "turbine-lab\n"


@needs_ssh
@pytest.mark.parametrize("gone", ["data/board", "sys/firmware/devicetree/base/serial-number"])
def test_a_board_that_takes_the_place_of_a_broken_one_keeps_everything(device: Path, run: Run, gone: str) -> None:
    """Told so by removing the number; nor is a board without a number another one."""
    before = identity(device)
    (device / "sys/firmware/devicetree/base/serial-number").write_bytes(b"10000000deadbeef\0")
    (device / gone).unlink()
    assert run("systemd/first-boot", RETROSCAN_BOARD="twin").stderr == ""
    assert identity(device) == before
    assert (device / "var/lib/retroscan-pairing/authorized_keys").exists()


@pytest.fixture
def gadget(fresh: Path) -> Path:
    (fresh / "sys/class/udc/fe980000.usb").mkdir(parents=True)
    (fresh / "sys/firmware/devicetree/base").mkdir(parents=True)
    (fresh / "sys/firmware/devicetree/base/serial-number").write_bytes(b"100000001234abcd\0")
    return fresh / "sys/kernel/config/usb_gadget/retrograph"


def test_the_usb_adapter_has_addresses_of_its_own(gadget: Path, run: Run) -> None:
    assert run("systemd/usb-gadget", "start").returncode == 0
    assert (gadget / "UDC").read_text() == "fe980000.usb"
    device, host = ((gadget / f"functions/ncm.usb0/{end}_addr").read_text() for end in ("dev", "host"))
    assert device != host
    assert device.startswith("02:")
    assert host.startswith("06:")
    assert device[2:] == host[2:]
    assert len(device.split(":")) == 6
    assert (gadget / "strings/0x409/serialnumber").read_text() == "100000001234abcd"
    attributes = int((gadget / "configs/c.1/bmAttributes").read_text(), 16)
    assert attributes & 0x40, "self-powered: a hub without a supply of its own takes it"
    assert int((gadget / "configs/c.1/MaxPower").read_text()) <= 100
    before = (gadget / "UDC").stat().st_mtime_ns
    assert run("systemd/usb-gadget", "start").returncode == 0
    assert (gadget / "UDC").stat().st_mtime_ns == before


def test_without_a_device_port_it_says_what_is_missing_and_is_started_again(
    gadget: Path, fresh: Path, run: Run
) -> None:
    """A unit that had succeeded in vain would stay as it is when the port is found a second later."""
    controller = fresh / "sys/class/udc/fe980000.usb"
    controller.rmdir()
    ran = run("systemd/usb-gadget", "start")
    assert ran.returncode == 1
    assert "dtoverlay=dwc2" in ran.stderr
    assert not gadget.exists()
    assert "usb-gadget.target" in settings("retrograph-usb.service")["WantedBy"][0].split()
    controller.mkdir()
    assert run("systemd/usb-gadget", "start").returncode == 0
    assert (gadget / "UDC").read_text() == "fe980000.usb"


def test_usb_usage(run: Run) -> None:
    assert run("systemd/usb-gadget").returncode == 2
