"""A flashed image gets its data partition behind a root that has room, and nothing else is ever touched."""

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "board" / "prepare-card.sh"
GIB = 1 << 30
MIB = 1 << 20
ROOT_AT = 16 * MIB
TOOLS = ("sfdisk", "blkid", "mkfs.ext4", "resize2fs", "e2fsck", "debugfs")
PATH = "/usr/sbin:/sbin:/usr/bin:/bin"

pytestmark = pytest.mark.skipif(
    any(shutil.which(tool, path=PATH) is None for tool in TOOLS), reason="sfdisk or e2fsprogs is not installed"
)


def call(*command: str | Path) -> str:
    ran = subprocess.run(command, capture_output=True, text=True, check=True, env={"PATH": PATH})
    return ran.stdout


def prepare(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", SCRIPT, *arguments], capture_output=True, text=True, check=False, env={"PATH": PATH})


@pytest.fixture
def card(tmp_path: Path) -> Path:
    """An image as flashed on a card of 4 GiB, with a file in its root; sparse."""
    image = tmp_path / "a card.img"
    with image.open("wb") as file:
        file.truncate(4 * GIB)
    table = f"label: dos\nstart=2048, size=30720, type=c\nstart={ROOT_AT // 512}, size={64 * MIB // 512}, type=83\n"
    subprocess.run(["sfdisk", "--quiet", image], input=table, text=True, check=True, env={"PATH": PATH})
    (tmp_path / "issue").write_text("Raspberry Pi OS\n")
    call("mkfs.ext4", "-q", "-F", "-L", "rootfs", "-E", f"offset={ROOT_AT}", image, "65536k")
    call("debugfs", "-w", "-R", f"write {tmp_path}/issue issue", f"{image}?offset={ROOT_AT}")
    return image


def partitions(card: Path) -> list[dict[str, int]]:
    table: list[dict[str, int]] = json.loads(call("sfdisk", "--json", card))["partitiontable"]["partitions"]
    return table


def digest(card: Path) -> str:
    with card.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def test_root_grows_and_the_rest_is_for_scans(card: Path) -> None:
    ran = prepare("--root-gib", "1", card)
    assert ran.returncode == 0, ran.stderr
    _boot, root, data = partitions(card)
    assert root["size"] * 512 >= GIB
    assert data["start"] == root["start"] + root["size"]
    assert data["start"] * 512 % (4 * MIB) == 0, "a card's erase blocks are not shared by two partitions"
    assert (data["start"] + data["size"]) * 512 == 4 * GIB
    for start, label, size in (
        (root["start"], "rootfs", root["size"]),
        (data["start"], "retrograph-data", data["size"]),
    ):
        place = f"{card}?offset={start * 512}"
        call("e2fsck", "-f", "-n", place)
        told = call("debugfs", "-R", "stats", place)
        assert f"volume name:   {label}" in told
        blocks = int(told.split("Block count:")[1].split()[0]) * int(told.split("Block size:")[1].split()[0])
        assert size * 512 - blocks < 64 * 1024
    assert "Raspberry Pi OS" in call("debugfs", "-R", "cat issue", f"{card}?offset={ROOT_AT}")


def test_twice_is_once(card: Path) -> None:
    prepare("--root-gib", "1", card)
    before = partitions(card)
    again = prepare("--root-gib", "1", card)
    assert (again.returncode, again.stdout) == (0, "Everything is in place.\n")
    assert partitions(card) == before


@pytest.mark.skipif(shutil.which("parted", path=PATH) is None, reason="parted is not installed")
@pytest.mark.parametrize("is_prepared", [True, False])
def test_the_first_boot_of_trixie_enlarges_root_unless_the_card_is_prepared(card: Path, is_prepared: bool) -> None:
    """Its initramfs gives parted the card's last sector, with these words, and goes on where parted refuses."""
    if is_prepared:
        prepare("--root-gib", "1", card)
    before, last = partitions(card), 4 * GIB // 512 - 1
    command = ("parted", "-m", card, "u", "s", "resizepart", "2", str(last))
    ran = subprocess.run(command, input="", capture_output=True, text=True, check=False, env={"PATH": PATH})
    assert (ran.returncode != 0) == is_prepared, ran.stdout
    assert (partitions(card) == before) == is_prepared
    assert ("overlapping" in ran.stdout + ran.stderr) == is_prepared


def test_the_boot_partition_and_its_command_line_stay_as_they_are(card: Path) -> None:
    """In cmdline.txt stands what trixie's first boot has to do."""
    with card.open("r+b") as file:
        file.seek(MIB)
        file.write(b"root=PARTUUID=deadbeef-02 rootwait resize\n")
    prepare("--root-gib", "1", card)
    with card.open("rb") as file:
        file.seek(MIB)
        assert file.read(64).startswith(b"root=PARTUUID=deadbeef-02 rootwait resize\n\0")


STEPS = ("sfdisk", "e2fsck", "resize2fs", "mkfs.ext4", "sfdisk --append")


def interrupted(card: Path, step: str) -> None:
    """As a power cut just before that step leaves the card: the tool ends the script there."""
    tools = card.parent / "tools"
    tools.mkdir()
    name, *words = step.split()
    real = shutil.which(name, path=PATH)
    ends = f'case "$*" in *{" ".join(words) or "--no-reread" if name == "sfdisk" else ""}*) exit 9 ;; esac\n'
    (tools / name).write_text(f'#!/bin/bash\n{ends}exec {real} "$@"\n')
    (tools / name).chmod(0o755)
    environment = {"PATH": f"{tools}:{PATH}"}
    ran = subprocess.run(["bash", SCRIPT, "--root-gib", "1", card], capture_output=True, check=False, env=environment)
    assert ran.returncode != 0


@pytest.mark.parametrize("step", STEPS)
def test_it_goes_on_where_it_was_interrupted(card: Path, step: str) -> None:
    interrupted(card, step)
    assert len(partitions(card)) == 2, "the third one comes last"
    ran = prepare("--root-gib", "1", card)
    assert (ran.returncode, ran.stderr) == (0, "")
    _boot, root, data = partitions(card)
    assert root["size"] * 512 >= GIB
    for partition in (root, data):
        call("e2fsck", "-f", "-n", f"{card}?offset={partition['start'] * 512}")
    assert "Raspberry Pi OS" in call("debugfs", "-R", "cat issue", f"{card}?offset={ROOT_AT}")
    assert prepare("--root-gib", "1", card).stdout == "Everything is in place.\n"


def test_a_third_partition_without_a_file_system_gets_one(card: Path, tmp_path: Path) -> None:
    """Of a card that was interrupted when the table was still written first; one that holds anything is not touched."""
    prepare("--root-gib", "1", card)
    data = partitions(card)[2]
    with card.open("r+b") as file:
        file.seek(data["start"] * 512)
        file.write(bytes(MIB))
    ran = prepare("--root-gib", "1", card)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert partitions(card)[2] == data
    call("e2fsck", "-f", "-n", f"{card}?offset={data['start'] * 512}")
    call("tune2fs", "-L", "precious", f"{card}?offset={data['start'] * 512}")
    ran = prepare("--root-gib", "1", card)
    assert (ran.returncode, "holds 3 partitions" in ran.stderr) == (2, True)
    assert "volume name:   precious" in call("debugfs", "-R", "stats", f"{card}?offset={data['start'] * 512}")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--root-gib", "4"], "are too small for a root of 4 GiB"),
        (["--root-gib", "big"], "usage:"),
        (["--frob"], "usage:"),
    ],
)
def test_what_does_not_fit_is_refused(card: Path, arguments: list[str], sentence: str) -> None:
    before = partitions(card)
    ran = prepare(*arguments, card)
    assert (ran.returncode, sentence in ran.stderr) == (2, True)
    assert partitions(card) == before


def test_another_disk_is_never_touched(card: Path, tmp_path: Path) -> None:
    """A disk with other partitions, other file systems, or none."""
    (foreign := tmp_path / "disk.img").write_bytes(b"precious" * 512)
    before = digest(foreign)
    ran = prepare("--root-gib", "1", foreign)
    assert (ran.returncode, "holds 0 partitions" in ran.stderr) == (2, True)
    assert digest(foreign) == before
    call("tune2fs", "-L", "home", f"{card}?offset={ROOT_AT}")
    table = partitions(card)
    ran = prepare("--root-gib", "1", card)
    assert (ran.returncode, "is not Raspberry Pi OS's rootfs" in ran.stderr) == (2, True)
    assert partitions(card) == table
    assert "is neither a device nor an image file" in prepare(tmp_path / "nowhere").stderr
