"""The handheld's units: systemd accepts them, they are shut in, and what they run exists and ends dark."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from console_font import SCREEN_FONTS
from sshd import SSHD, needs_sshd, prepare_sshd
from unit_files import INSTRUMENTS, SYSTEMD, settings, unit_files

from device.cli.main import COMMANDS
from device.cli.service import BROKEN_WAIT_S

PROGRAM = "/usr/local/bin/retroscan"
UNPRIVILEGED = (*INSTRUMENTS, "retrograph-power.service")
MAX_EXPOSED = 25
"""Of `systemd-analyze security`, in tenths: what no service may exceed. There are no exceptions."""

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.fixture
def units_of_this_machine(tmp_path: Path) -> Path:
    """All units, with programs that are there, since systemd looks for them."""
    for path in unit_files():
        text = re.sub(r"/usr/(local/(bin|sbin|lib)|libexec)/[a-z/-]+", sys.executable, path.read_text(encoding="utf-8"))
        (tmp_path / path.name).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("unit", INSTRUMENTS)
def test_an_instrument_is_watched_and_ends_dark(unit: str) -> None:
    said = settings(unit)
    assert said["Type"] == ["notify"]
    assert 20 <= int(said["WatchdogSec"][0]) <= 120
    assert {"run", "tui"} & set(shlex.split(said["ExecStart"][0]))
    assert "--board ${RETROSCAN_BOARD}" in said["ExecStart"][0]
    assert shlex.split(said["ExecStopPost"][0])[-1] == "lights-off"
    assert said["User"] == ["retroscan"]
    assert said["StartLimitIntervalSec"] == ["0"]


def test_becoming_ready_confirms_an_update_of_this_very_unit() -> None:
    for unit in INSTRUMENTS:
        (confirming,) = settings(unit)["ExecStartPost"]
        assert confirming.startswith("-+/usr/")
        assert confirming.endswith("/usr/local/sbin/retrograph-slot confirm %n")
        assert any(line.endswith("/retrograph-slot starting") for line in settings(unit)["ExecStartPre"])


def test_confirming_an_update_does_not_hang_up_the_screens_terminal() -> None:
    """systemd resets and hangs up the terminal before every command of a unit, also those beside the main one."""
    said = settings("retroscan-tui.service")
    assert "ExecStartPost" in said
    assert {"TTYReset", "TTYVHangup", "TTYVTDisallocate"} & said.keys() == set()


def test_nobody_writes_across_the_screen() -> None:
    """What a unit on a terminal runs beside its program says so in the journal, and the kernel is asked to be quiet."""
    said = settings("retroscan-tui.service")
    assert said["StandardOutput"] == said["StandardError"] == ["tty"]
    beside = [line for key in ("ExecStartPre", "ExecStartPost") for line in said[key] if "retrograph-slot" in line]
    assert len(beside) == 2
    assert all(line.startswith("-+/usr/bin/systemd-cat ") for line in beside)
    assert "-+/usr/bin/dmesg --console-off" in said["ExecStartPre"]
    assert '-+/usr/bin/bash -c "kill -s RTMIN+21 1"' in said["ExecStartPre"], "see SIGRTMIN+21 in systemd(1)"
    assert "-+/usr/bin/dmesg --console-on" in said["ExecStopPost"]


def test_the_screen_has_a_font_that_holds_what_it_draws() -> None:
    """Set after the system's own, which has no half blocks."""
    said = settings("retroscan-tui.service")
    assert "RETROSCAN_FONT=" + SCREEN_FONTS[0] in said["Environment"]
    assert "-+/usr/bin/setfont -C /dev/tty1 ${RETROSCAN_FONT}" in said["ExecStartPre"]
    assert any("console-setup.service" in units for units in said["After"])


def test_the_camera_has_one_owner() -> None:
    """Each of the two ends the other, and both hold the program's lock in the same folder.

    Without an order between them the one would start while the other ends: it would find the lock held, and
    its lights put out by the other's `lights-off`.
    """
    for unit, other in (INSTRUMENTS, INSTRUMENTS[::-1]):
        said = settings(unit)
        assert other in said["Conflicts"][0].split()
        assert (said["RuntimeDirectory"], said["RuntimeDirectoryPreserve"]) == (["retroscan"], ["yes"])
    in_order = [unit for unit, other in (INSTRUMENTS, INSTRUMENTS[::-1]) if other in ordered_after(unit)]
    assert in_order == ["retroscan-tui.service"], "one of the two: both would be a circle"


def ordered_after(unit: str) -> set[str]:
    return {name for line in settings(unit)["After"] for name in line.split()}


KINDS_OF_DEVICES = {"video4linux", "media", "dma_heap", "i2c", "gpiochip"}
"""As these drivers call themselves in /proc/devices. Raspberry Pi's vcio is not among them: there it is a "misc"."""


def test_devices_are_named_as_the_kernel_names_them() -> None:
    """A name that is not in /proc/devices when the unit starts lets nothing in, and systemd does not say so."""
    for path in unit_files():
        allowed = [line.split()[0] for line in settings(path.name).get("DeviceAllow", [])]
        kinds = {name.removeprefix("char-") for name in allowed if name.startswith("char-")}
        assert kinds <= KINDS_OF_DEVICES, path.name
        assert {name for name in allowed if name.startswith("/")} <= {"/dev/vcio", "/dev/tty1"}, path.name
        if "video4linux" in kinds:
            assert "modprobe@videodev.service" in settings(path.name)["Wants"], path.name
            assert "modprobe@videodev.service" in ordered_after(path.name), path.name


def test_who_opens_the_pairing_window_can_be_reached() -> None:
    """By a held button or on the screen: in a network of its own nobody would ever call."""
    for unit in INSTRUMENTS:
        said = settings(unit)
        assert {"PrivateNetwork", "IPAddressDeny"} & said.keys() == set()
        assert "AF_INET" in said["RestrictAddressFamilies"][0].split()


def test_what_runs_after_the_stop_works_on_the_twin() -> None:
    for unit in INSTRUMENTS:
        command = settings(unit)["ExecStopPost"][0].replace("${RETROSCAN_BOARD}", "twin")
        program, *arguments = shlex.split(command)
        assert program == PROGRAM
        ran = subprocess.run([sys.executable, "-m", "device", *arguments], capture_output=True, text=True, check=False)
        assert (ran.returncode, ran.stderr) == (0, "")


def test_every_command_of_the_units_is_one_of_the_program() -> None:
    known = {command.name for command in COMMANDS}
    lines = [line for path in unit_files() for line in path.read_text(encoding="utf-8").splitlines()]
    commands = [shlex.split(line) for line in lines if line.startswith("Exec") and PROGRAM in line]
    asked = {next(word for word in reversed(words) if not word.startswith("-")) for words in commands}
    assert asked >= {"run", "lights-off", "guard-battery"}
    assert asked <= known


def test_only_what_an_instrument_needs_of_the_devices() -> None:
    for unit in UNPRIVILEGED:
        said = settings(unit)
        assert said.get("DevicePolicy") == ["closed"] or said.get("PrivateDevices") == ["yes"]
        assert all("mem" not in device and "block" not in device for device in said.get("DeviceAllow", []))


def test_root_keeps_only_the_rights_that_its_work_needs() -> None:
    """Services without a user of their own: no place, device or right of the system beside those that they name."""
    for path in unit_files():
        said = settings(path.name)
        if path.suffix == ".service" and "User" not in said:
            assert (said["ProtectSystem"], said["NoNewPrivileges"]) == (["strict"], ["yes"]), path.name
            assert "CapabilityBoundingSet" in said, path.name
            assert said.get("PrivateDevices") == ["yes"] or said["DevicePolicy"] == ["closed"], path.name
            assert all(
                not place.strip("-").startswith(("/etc ", "/usr", "/boot")) for place in said.get("ReadWritePaths", [])
            )


def test_a_stop_by_hand_powers_nothing_off() -> None:
    """SuccessAction= and FailureAction= act on `systemctl stop` and on skipped starts too."""
    assert [path.name for path in unit_files() if {"SuccessAction", "FailureAction"} & settings(path.name).keys()] == []


def test_nothing_waits_for_a_network_or_for_the_time() -> None:
    for path in unit_files():
        text = path.read_text(encoding="utf-8")
        assert "network-online.target" not in text
        assert "time-sync.target" not in text
        assert "time-set.target" not in text


@needs_systemd
def test_systemd_accepts_all_of_them(units_of_this_machine: Path) -> None:
    units = sorted(units_of_this_machine.iterdir())
    ran = subprocess.run(["systemd-analyze", "verify", *units], capture_output=True, text=True, check=False)
    complaints = [line for line in ran.stderr.splitlines() if "retro" in line or "data" in line]
    assert complaints == []
    assert ran.returncode == 0, ran.stderr


@needs_systemd
@pytest.mark.parametrize("unit", [path.name for path in unit_files() if path.suffix == ".service"])
def test_it_is_shut_in(units_of_this_machine: Path, unit: str) -> None:
    ran = subprocess.run(
        [
            "systemd-analyze",
            "security",
            "--offline=yes",
            f"--threshold={MAX_EXPOSED}",
            units_of_this_machine / unit,
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout


@pytest.mark.skipif(shutil.which("systemd-escape") is None, reason="systemd-escape is not installed")
def test_a_mount_is_named_after_its_place() -> None:
    for path in SYSTEMD.glob("*.mount"):
        where = settings(path.name)["Where"][0]
        escaped = subprocess.run(
            ["systemd-escape", "--path", "--suffix=mount", where], capture_output=True, text=True, check=True
        )
        assert escaped.stdout.strip() == path.name


@pytest.mark.skipif(shutil.which("systemd-tmpfiles") is None, reason="systemd-tmpfiles is not installed")
@pytest.mark.skipif(not Path("/proc/self/uid_map").exists(), reason="this is no Linux")
def test_users_and_folders_are_made(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    sysusers = ["systemd-sysusers", f"--root={tmp_path}", SYSTEMD / "sysusers-retrograph.conf"]
    subprocess.run(sysusers, check=True, capture_output=True)
    users = dict(line.split(":", 1) for line in (tmp_path / "etc/passwd").read_text().splitlines())
    assert users.keys() == {"retroscan", "retrosync"}
    assert users["retroscan"].split(":")[2] == users["retrosync"].split(":")[2], "one group: the store's owner's"
    lines = (SYSTEMD / "tmpfiles-retrograph.conf").read_text(encoding="utf-8").splitlines()
    modes = {words[1]: (words[2], words[3]) for line in lines if len(words := line.split()) >= 5 and words[0] == "d"}
    assert modes["/srv/retrograph"] == ("0755", "root"), "sshd asks this of a chroot"
    assert modes["/var/lib/retroscan/receipts"][0] == modes["/var/lib/retroscan/inbox"][0] == "0770"
    assert modes["/var/lib/retroscan"] == ("0750", "retroscan"), "the offload's user reads, and writes nothing else"


def test_the_boot_budget_adds_up_and_names_the_units_own_times() -> None:
    """Of docs/boot.md: 25 s from power to ready, and what may make it longer."""
    text = (SYSTEMD.parent / "docs/boot.md").read_text(encoding="utf-8")
    steps = [int(seconds) for seconds in re.findall(r"^\| \d [^|]+\| (\d+) s \|", text, re.MULTILINE)]
    assert (len(steps), sum(steps) <= 25) == (6, True)
    assert f"its self-test, {settings('retrograph-trial.service')['TimeoutStartSec'][0]} s at most" in text
    assert settings("system-retrograph.conf")["DefaultDeviceTimeoutSec"] == ["45s"]
    assert text.count("| 45 s") == 2
    assert f"| {BROKEN_WAIT_S:.0f} s, then [ready and out of order]" in text
    for unit in INSTRUMENTS:
        said = settings(unit)
        assert f"| ended after {said['TimeoutStartSec'][0]} s, again after {said['RestartSec'][0]} s" in text


def test_the_journal_is_bounded() -> None:
    said = settings("journald-retrograph.conf")
    assert said["Storage"] == ["persistent"]
    assert said["SystemMaxUse"] == ["64M"]


def test_avahi_announces_what_discovery_looks_for() -> None:
    service = ElementTree.parse(SYSTEMD / "avahi-retrograph.xml").getroot()  # noqa: S314
    assert service.findtext("service/type") == "_sftp-ssh._tcp"
    assert service.findtext("service/txt-record") == "retrograph=1"


RESCUE = "retrograph-rescue-key.service"


@needs_sshd
@pytest.mark.parametrize(("there", "starts"), [("ab", True), ("a", True), ("b", True), ("", False)])
def test_sshd_starts_with_its_own_key_or_with_the_one_for_repairs(tmp_path: Path, there: str, starts: bool) -> None:
    """The own key is a link into the data partition, and leads nowhere without it."""
    prepare_sshd()
    own, rescue, partition = tmp_path / "own", tmp_path / "rescue", tmp_path / "data"
    own.symlink_to(partition)
    for name, path in (("a", partition), ("b", rescue)):
        if name in there:
            subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", path], check=True)
    text = (SYSTEMD / "sshd-retrograph.conf").read_text(encoding="utf-8")
    places = {"/etc/ssh/ssh_host_ed25519_key": own, "/run/retrograph-rescue/ssh_host_ed25519_key": rescue}
    assert re.findall("^HostKey (.*)", text, re.MULTILINE) == list(places)
    for place, path in places.items():
        text = text.replace(place, str(path))
    (tmp_path / "sshd_config").write_text(text, encoding="utf-8")
    ran = subprocess.run([SSHD, "-T", "-f", tmp_path / "sshd_config"], capture_output=True, text=True, check=False)
    assert (ran.returncode == 0, "no hostkeys available" in ran.stderr) == (starts, not starts)


def test_the_key_for_repairs_is_made_before_sshd_wants_it_and_only_where_none_is() -> None:
    said, first = settings(RESCUE), settings("retrograph-first-boot.service")
    assert said["ConditionFileNotEmpty"] == ["!/data/ssh/ssh_host_ed25519_key"]
    assert "ssh.service" in said["Before"]
    assert {"Requires", "RequiresMountsFor", "BindsTo"} & said.keys() == set(), "it must run where the partition is not"
    assert "retrograph-first-boot.service" in said["After"][0].split(), "which makes the device's own key"
    assert "ssh.service" in first["Before"][0].split()
    made = shlex.split(said["ExecStart"][0])[-1]
    assert made == f"/run/{said['RuntimeDirectory'][0]}/ssh_host_ed25519_key"
    assert f"HostKey {made}\n" in (SYSTEMD / "sshd-retrograph.conf").read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="OpenSSH is not installed")
def test_what_makes_the_key_for_repairs_makes_one(tmp_path: Path) -> None:
    for line in settings(RESCUE)["ExecStart"]:
        program, *arguments = shlex.split(line.replace("/run/retrograph-rescue", str(tmp_path)))
        subprocess.run(["ssh-keygen", *arguments], check=True, capture_output=True, stdin=subprocess.DEVNULL)
        assert Path(program).name == "ssh-keygen"
    key = tmp_path / "ssh_host_ed25519_key"
    assert "PRIVATE KEY" in key.read_text(encoding="utf-8")
    assert key.stat().st_mode & 0o77 == 0


@needs_sshd
def test_sshd_lets_the_offload_do_nothing_but_sftp(tmp_path: Path) -> None:
    prepare_sshd()
    key = tmp_path / "host_key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    drop_in = (SYSTEMD / "sshd-retrograph.conf").read_text(encoding="utf-8")
    (tmp_path / "sshd_config").write_text(f"HostKey {key}\nPasswordAuthentication yes\n{drop_in}", encoding="utf-8")

    def effective(user: str) -> dict[str, str]:
        who = f"user={user},host=bench,addr=127.0.0.1"
        command = [SSHD, "-T", "-f", tmp_path / "sshd_config", "-C", who]
        ran = subprocess.run(command, check=True, capture_output=True, text=True)  # type: ignore[arg-type]
        return dict(line.split(" ", 1) for line in ran.stdout.splitlines() if " " in line)

    offload = effective("retrosync")
    assert offload["chrootdirectory"] == "/srv/retrograph"
    assert offload["forcecommand"].startswith("internal-sftp -d /store")
    assert (offload["authenticationmethods"], offload["passwordauthentication"]) == ("publickey", "no")
    assert (offload["disableforwarding"], offload["permittty"], offload["authorizedkeysfile"]) == ("yes", "no", "none")
    assert effective("somebody")["passwordauthentication"] == "yes"


def test_the_workstations_nightly_check_is_a_command_that_exists(tmp_path: Path) -> None:
    said = settings("workstation/retrograph-verify.service")
    program, *arguments = shlex.split(said["ExecStart"][0].replace("%%", "%"))
    assert program == "retrosync"
    run = subprocess.run(
        [sys.executable, "-m", "host_sync", *arguments, "--library", tmp_path / "absent"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 2
    assert "there is no library" in run.stderr
    assert settings("workstation/retrograph-verify.timer")["Persistent"] == ["true"]


def test_the_workstations_watch_is_a_command_that_exists(tmp_path: Path) -> None:
    said = settings("workstation/retrograph-watch.service")
    program, *arguments = shlex.split(said["ExecStart"][0])
    assert program == "retrosync"
    run = subprocess.run(
        [sys.executable, "-m", "host_sync", *arguments, tmp_path / "absent"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 2
    assert "there is no library" in run.stderr
    assert said["Restart"] == ["on-failure"]
