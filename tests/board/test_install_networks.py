"""install.sh and networks: what a card was given meets what a data partition knows, and nothing of either is lost."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

pytestmark = pytest.mark.skipif(
    shutil.which("systemctl") is None or shutil.which("systemd-sysusers") is None, reason="systemd is not installed"
)
PLACES = [
    ("etc/NetworkManager/system-connections", "data/network", "preconfigured.nmconnection"),
    ("etc/netplan", "data/netplan", "50-cloud-init.yaml"),
]


def networks(run: subprocess.CompletedProcess[str]) -> list[str]:
    """What it said it did with networks."""
    assert run.returncode == 0, run.stderr
    return [line.strip() for line in run.stdout.splitlines() if "the network" in line]


def test_uninstall_names_what_it_leaves_passwords_first_of_all(fresh: Path, run: Run) -> None:
    (fresh / "etc/hostname").write_text("turbine-lab\n")
    (fresh / "etc/netplan/50-cloud-init.yaml").write_text("network: {version: 2}\n")
    run("board/install.sh", "--root", fresh, "--board", "pi5-imx296", "--no-app")
    (fresh / "data/board").write_text("1234\n")
    said = run("board/install.sh", "--root", fresh, "--uninstall").stdout.splitlines()
    left = "netplan (networks with their passwords), hostname (name), board (number of the board)"
    assert said[-2] == f"The users retroscan and retrosync and every package stay, and in /data: {left}."
    assert said[-1] == "Before the data partition is given away, erase it."
    assert {path.name for path in (fresh / "data").iterdir()} == {"netplan", "hostname", "board"}


@pytest.mark.parametrize(("place", "kept", "name"), PLACES)
def test_a_new_card_adds_its_networks_to_an_old_data_partition(
    fresh: Path, run: Run, place: str, kept: str, name: str
) -> None:
    old, ending = fresh / kept, Path(name).suffix
    old.mkdir(parents=True)
    (old / name).write_text("of the first card")
    (old / f"lab{ending}").write_text("added in the field")
    for file in (name, f"home{ending}"):
        (fresh / place / file).write_text("of the new card")
        (fresh / place / file).chmod(0o600)
    arguments = ("board/install.sh", "--root", fresh, "--board", "pi5-imx296", "--no-app")
    promised = networks(run(*arguments, "--dry-run"))
    said = networks(run(*arguments))
    assert said == promised
    beside = next(path for path in old.glob(f"{Path(name).stem}_*{ending}"))
    assert said == [
        f"copy the network {file} to /{kept}{more}"
        for file, more in sorted([(name, f"/{beside.name}, beside another one of its name"), (f"home{ending}", "")])
    ]
    assert (old / name).read_text() == "of the first card", "what is there is never overwritten"
    assert (old / f"lab{ending}").read_text() == "added in the field"
    assert beside.read_text() == (old / f"home{ending}").read_text() == "of the new card"
    assert beside.stat().st_mode & 0o777 == 0o600, "it holds a password"
    assert max(beside.name, name) == beside.name, "netplan reads it last"
    assert networks(run(*arguments)) == []
