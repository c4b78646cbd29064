"""A scratch root that looks like a fresh Raspberry Pi OS, release folders, and a Python that installs in no time."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CONFIG = "dtparam=spi=on\n\n[all]\nenable_uart=1\n"
COMMAND_LINE = "console=tty1 root=PARTUUID=deadbeef-02 rootfstype=ext4 rootwait\n"

Run = Callable[..., subprocess.CompletedProcess[str]]


FOLDERS = (
    "boot/firmware/overlays",
    "etc/NetworkManager/conf.d",
    "etc/NetworkManager/system-connections",
    "etc/avahi/services",
    "etc/default",
    "etc/initramfs/post-update.d",
    "etc/modules-load.d",
    "etc/netplan",
    "etc/ssh/sshd_config.d",
    "etc/sysusers.d",
    "etc/systemd/system",
    "etc/tmpfiles.d",
    "etc/udev/rules.d",
    "srv",
    "usr/local/bin",
    "usr/local/lib",
    "usr/local/sbin",
    "usr/share/initramfs-tools/modules.d",
    "var/lib",
)
"""That any card has."""


def write(path: Path, text: str, mode: int = 0o644) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


@pytest.fixture
def fresh(tmp_path: Path) -> Path:
    """What install.sh looks at on a fresh card."""
    root = tmp_path / "root fs"
    for folder in FOLDERS:
        (root / folder).mkdir(parents=True)
    write(root / "etc/os-release", 'PRETTY_NAME="Debian GNU/Linux 13 (trixie)"\nVERSION_CODENAME=trixie\n')
    write(root / "etc/hostname", "raspberrypi\n")
    write(root / "boot/firmware/config.txt", CONFIG)
    write(root / "boot/firmware/cmdline.txt", COMMAND_LINE)
    write(root / "usr/libexec/netplan/generate", "#!/bin/sh\n", 0o755)
    return root


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """A Python whose environments are made at once; its pip copies the `retroscan` that lies beside the wheel."""
    return write(
        tmp_path / "python",
        """#!/bin/bash
set -euo pipefail
case "$1 $2" in
'-m venv') mkdir -p "$4/bin" && cp "$0" "$4/bin/python" ;;
'-m pip')
    wheel=${*: -1}
    case $wheel in
    *.whl)
        [ ! -e "$(dirname "$wheel")/retroscan" ] || cp "$(dirname "$wheel")/retroscan" "$(dirname "$0")/retroscan" ;;
    *) echo "$* TMPDIR=${TMPDIR:-}" >>"${0%/*}/pip-calls" && touch "${TMPDIR:?}/wheel" ;;
    esac ;;
esac
""",
        0o755,
    )


@pytest.fixture
def release(tmp_path: Path) -> Callable[..., Path]:
    """Makes a release folder of a version, whose self-test ends as told."""

    def make(version: str, selftest: int = 0, start: int = 0) -> Path:
        folder = tmp_path / f"release {version}"
        write(folder / f"retrograph-{version}-py3-none-any.whl", "")
        write(folder / "requirements-device.lock", "")
        script = f'#!/bin/bash\ncase "$*" in --version) exit {start} ;; *selftest) exit {selftest} ;; esac\n'
        write(folder / "retroscan", script + f"echo {version}\n", 0o755)
        return folder

    return make


@pytest.fixture
def run(fresh: Path, python: Path) -> Run:
    """Runs a script of the project on the scratch root."""

    def call(script: str, *arguments: str | Path, **more: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "RETROGRAPH_ROOT": str(fresh), "RETROGRAPH_PYTHON": str(python), **more}
        return subprocess.run(
            ["bash", ROOT / script, *arguments], env=environment, capture_output=True, text=True, check=False
        )

    return call
