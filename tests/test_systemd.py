"""The handheld's unit: systemd accepts it, and what it runs exists and ends dark."""

import configparser
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

UNIT = Path(__file__).parent.parent / "systemd" / "retroscan.service"
PROGRAM = "/usr/local/bin/retroscan"

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.fixture
def service() -> configparser.SectionProxy:
    parser = configparser.ConfigParser(interpolation=None, delimiters=("=",), strict=False)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(UNIT, encoding="utf-8")
    return parser["Service"]


@pytest.fixture
def unit_of_this_machine(tmp_path: Path) -> Path:
    """The unit with a program that is there, since systemd looks for it."""
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text(encoding="utf-8").replace(PROGRAM, sys.executable), encoding="utf-8")
    return unit


def test_watches_and_ends_dark(service: configparser.SectionProxy) -> None:
    assert shlex.split(service["ExecStart"])[-1] == "watch"
    assert shlex.split(service["ExecStopPost"])[-1] == "lights-off"
    assert "--board ${RETROSCAN_BOARD}" in service["ExecStart"]


def test_what_runs_after_the_stop_works_on_the_twin(service: configparser.SectionProxy) -> None:
    program, *arguments = shlex.split(service["ExecStopPost"].replace("${RETROSCAN_BOARD}", "twin"))
    assert program == PROGRAM
    ran = subprocess.run([sys.executable, "-m", "device", *arguments], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")


@needs_systemd
def test_systemd_accepts_it(unit_of_this_machine: Path) -> None:
    ran = subprocess.run(
        ["systemd-analyze", "verify", unit_of_this_machine], capture_output=True, text=True, check=False
    )
    complaints = [line for line in ran.stderr.splitlines() if UNIT.stem in line]
    assert (ran.returncode, complaints) == (0, [])


@needs_systemd
def test_it_is_shut_in(unit_of_this_machine: Path) -> None:
    ran = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--threshold=25", unit_of_this_machine],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout


SSHD = shutil.which("sshd", path="/usr/sbin:/usr/local/sbin:/usr/bin")


@pytest.mark.skipif(SSHD is None, reason="OpenSSH's sshd is not installed")
def test_sshd_lets_the_offload_do_nothing_but_sftp(tmp_path: Path) -> None:
    assert SSHD is not None
    key = tmp_path / "host_key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    drop_in = (UNIT.parent / "sshd-retrograph.conf").read_text(encoding="utf-8")
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


@needs_systemd
def test_systemd_accepts_the_mount() -> None:
    mount = UNIT.parent / "srv-retrograph-store.mount"
    ran = subprocess.run(["systemd-analyze", "verify", mount], capture_output=True, text=True, check=False)
    assert [line for line in ran.stderr.splitlines() if "retrograph" in line] == []
