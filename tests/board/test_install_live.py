"""install.sh on a running system: in which order the system is told of what is new."""

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOLD = ("systemctl", "systemd-tmpfiles", "udevadm")

pytestmark = pytest.mark.skipif(
    shutil.which("systemctl") is None or shutil.which("systemd-sysusers") is None, reason="systemd is not installed"
)


@pytest.fixture
def told(tmp_path: Path) -> Path:
    """Where it is noted whom install.sh told what."""
    return tmp_path / "told"


@pytest.fixture
def installer(fresh: Path, told: Path, tmp_path: Path) -> Path:
    """An install.sh of its own that takes the scratch root for a running system, once all is in place."""
    here, real = tmp_path / "here", shutil.which("systemctl")
    for part in ("board", "systemd"):
        shutil.copytree(ROOT / part, here / part)
    (tmp_path / "bin").mkdir()
    for name in TOLD:
        of_root = f'case "$*" in --root=*) exec {real} "$@" ;; esac\n' if name == "systemctl" else ""
        script = tmp_path / "bin" / name
        script.write_text(f'#!/bin/bash\n{of_root}echo "{name} $*" >>"{told}"\n')
        script.chmod(0o755)
    (here / "board/retrograph-slot").write_text(f'echo "retrograph-slot $1" >>"{told}"\n')
    (fresh / "run/systemd/system").mkdir(parents=True)
    with (here / "board/install/take-away.sh").open("a", encoding="utf-8") as parts:
        parts.write('live() { [ -z "$root" ] || [[ ${FUNCNAME[1]} = @(tell_the_system|camera_is_loaded) ]]; }\n')
    return here / "board/install.sh"


@pytest.fixture
def install(
    fresh: Path, installer: Path, told: Path, release: Callable[..., Path]
) -> Callable[[str], subprocess.CompletedProcess[str]]:
    def run(board: str) -> subprocess.CompletedProcess[str]:
        command = ["bash", installer, "--root", fresh, "--board", board, "--release", release("1.0")]
        environment = {**os.environ, "PATH": f"{told.parent / 'bin'}:{os.environ['PATH']}"}
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    return run


NUMPY = "hal.errors.DriverMissing: picamera2 is installed and cannot be imported (numpy.dtype size changed)"


@pytest.mark.parametrize(("board", "works"), [("pi5-imx296", True), ("pi5-imx296", False), ("twin", False)])
def test_a_camera_that_cannot_be_loaded_is_reported_at_once(
    fresh: Path, install: Callable[[str], subprocess.CompletedProcess[str]], board: str, works: bool
) -> None:
    """Where there is one: the twin's needs no library of the system."""
    python = fresh / "data/app/current/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\n" if works else f"#!/bin/sh\necho Traceback >&2; echo '{NUMPY}' >&2; exit 1\n")
    python.chmod(0o755)
    ran = install(board)
    is_told = "The camera cannot be used: picamera2 is installed and cannot be imported (numpy" in ran.stdout
    assert (is_told, ran.returncode) == ((False, 0) if works or board == "twin" else (True, 1)), ran.stdout
    assert ran.stdout.splitlines()[-1] == "Done. Reboot."


def test_the_system_knows_units_folders_and_rules_before_the_program_is_swapped(
    told: Path, install: Callable[[str], subprocess.CompletedProcess[str]]
) -> None:
    """Or a new program would be tried, and started, under the units of the one before."""
    ran = install("twin")
    assert ran.returncode == 0, ran.stderr
    lines = told.read_text().splitlines()
    assert lines[:2] == ["retrograph-slot verify", "systemctl daemon-reload"]
    assert lines[-1] == "retrograph-slot install"
    assert {"systemctl start data.mount", "udevadm control --reload"} <= set(lines)
    assert "systemd-tmpfiles --create /etc/tmpfiles.d/retrograph.conf" in lines
