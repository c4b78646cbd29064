"""The card's image: its table, the texts by which a slot is found, and what is built into it, on a tiny root."""

import itertools
import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import image_build
import pytest
from image_layout import (
    BOOT_NUMBERS,
    DATA_NUMBER,
    MIB,
    ROOT_NUMBERS,
    SELECT_NUMBER,
    SLOTS,
    Sizes,
    autoboot,
    card_mib,
    command_line,
    disk_id,
    partitions,
    sfdisk_script,
)
from virtual_card import DEVICES_S, patient

ROOT = Path(__file__).parents[2]
MOST_AUTOBOOT_BYTES = 512
"""The firmware reads no more of it; one sector is also what a card writes whole or not at all."""
PATH = "/usr/sbin:/sbin:/usr/bin:/bin"
TOOLS = ("sfdisk", "mkfs.ext4", "mkfs.vfat", "mcopy", "debugfs", "zstd")
SMALL = Sizes(select_mib=16, boot_mib=34, root_mib=24, data_mib=16)
NAME = "retrograph-test"
CARD_MIB = 512
LONGEST_LINE_BYTES = 2048
"""COMMAND_LINE_SIZE of an arm64 kernel, which cuts what is longer."""

needs_sfdisk = pytest.mark.skipif(shutil.which("sfdisk", path=PATH) is None, reason="sfdisk is not installed")
needs_tools = pytest.mark.skipif(
    any(shutil.which(tool, path=PATH) is None for tool in TOOLS),
    reason="sfdisk, e2fsprogs, dosfstools, mtools or zstd is not installed",
)


def call(*command: str | Path, text: str | None = None) -> str:
    return subprocess.run(
        command, input=text, capture_output=True, text=True, check=True, env={**os.environ, "PATH": PATH}
    ).stdout


def table(card: Path) -> dict[int, tuple[int, int, str]]:
    """Start and size in MiB and type of every partition, by number, as sfdisk reads them back."""
    found = json.loads(call("sfdisk", "--json", card))["partitiontable"]["partitions"]
    return {
        int(part["node"].removeprefix(str(card))): (part["start"] // 2048, part["size"] // 2048, part["type"])
        for part in found
    }


@pytest.fixture
def card(tmp_path: Path) -> Path:
    """An image with its table, on a card that is larger."""
    image = tmp_path / "card.img"
    with image.open("wb") as stream:
        stream.truncate(card_mib(SMALL) * MIB)
    call("sfdisk", "--quiet", image, text=sfdisk_script(SMALL, NAME))
    with image.open("r+b") as stream:
        stream.truncate(CARD_MIB * MIB)
    return image


@needs_sfdisk
def test_sfdisk_takes_the_table_as_it_is_meant(card: Path) -> None:
    meant = {part.number: (part.start_mib, part.size_mib, part.kind) for part in partitions(SMALL)}
    assert table(card) == meant
    assert json.loads(call("sfdisk", "--json", card))["partitiontable"]["id"] == f"{disk_id(NAME):#010x}"


def test_partitions_do_not_overlap_and_slots_are_alike() -> None:
    known = Sizes(**image_build.facts()["sizes"])
    parts = {part.number: part for part in partitions(known)}
    real = sorted((part for part in parts.values() if part.number != 4), key=lambda part: part.start_mib)
    assert all(left.start_mib + left.size_mib <= right.start_mib for left, right in itertools.pairwise(real))
    assert real[-1].number == DATA_NUMBER, "what grows is the last one"
    for numbers in (BOOT_NUMBERS, ROOT_NUMBERS):
        assert parts[numbers["a"]].size_mib == parts[numbers["b"]].size_mib
    assert card_mib(known) < 7600, "fits a card that is sold as 8 GB"


@pytest.mark.parametrize("slot", SLOTS)
def test_autoboot_names_the_slot_and_tries_the_other_one(slot: str) -> None:
    default, _, tried = autoboot(slot).partition("[tryboot]\n")
    assert "tryboot_a_b=1\n" in default
    spare = SLOTS[1 - SLOTS.index(slot)]
    assert f"boot_partition={BOOT_NUMBERS[slot]}\n" in default
    assert tried == f"boot_partition={BOOT_NUMBERS[spare]}\n"
    assert len(autoboot(slot)) == len(autoboot(spare)) <= MOST_AUTOBOOT_BYTES


@pytest.mark.parametrize("slot", SLOTS)
def test_a_slot_knows_its_own_root_and_boot_partition(slot: str) -> None:
    line = command_line(NAME, slot)
    assert line.count("\n") == 1
    identifier = f"{disk_id(NAME):08x}"
    assert f" root=PARTUUID={identifier}-0{ROOT_NUMBERS[slot]} " in line
    assert f"systemd.mount-extra=PARTUUID={identifier}-0{BOOT_NUMBERS[slot]}:/boot/firmware:vfat:ro" in line
    assert f"retrograph.slot={slot} " in line
    assert line.endswith(" overlayroot=tmpfs:recurse=0\n")


def test_the_emulated_board_waits_longer_for_its_card_than_the_image_does() -> None:
    """The image keeps a board's 45 s; what gives an emulated disk more time is in the kernel's command line, whole."""
    line = patient(command_line(NAME, "a"))
    assert len(line.encode()) < LONGEST_LINE_BYTES
    assert set(command_line(NAME, "a").split()) - set(line.split()) == {"console=serial0,115200"}
    assert [word for word in line.split() if word.startswith("console=")][-1] == "console=ttyAMA0"
    given = re.search(r"^DefaultDeviceTimeoutSec=(\d+)s$", (ROOT / "systemd/system-retrograph.conf").read_text(), re.M)
    assert given
    assert f" systemd.default_device_timeout_sec={DEVICES_S} " in line
    assert int(given[1]) < DEVICES_S


@needs_sfdisk
def test_data_grows_to_the_cards_end_once_and_the_others_stay(card: Path) -> None:
    script, before = ROOT / "board/image/grow-data", table(card)
    call("bash", script, card)
    after = table(card)
    assert {number: after[number] for number in after if number not in (4, DATA_NUMBER)} == {
        number: before[number] for number in before if number not in (4, DATA_NUMBER)
    }
    for number in (4, DATA_NUMBER):
        assert after[number][0] == before[number][0]
        assert after[number][0] + after[number][1] == CARD_MIB
    assert call("bash", script, card) == ""
    assert table(card) == after


@needs_sfdisk
def test_another_card_does_not_grow(tmp_path: Path) -> None:
    image = tmp_path / "other.img"
    with image.open("wb") as stream:
        stream.truncate(64 * MIB)
    call("sfdisk", "--quiet", image, text="label: dos\nsize=8MiB, type=c\nsize=8MiB, type=83\n")
    before = image.read_bytes()
    assert "left as it is" in call("bash", ROOT / "board/image/grow-data", image)
    assert image.read_bytes() == before


@needs_tools
def test_an_image_holds_what_the_root_held(tmp_path: Path) -> None:
    root, scratch, image = (tmp_path / name for name in ("root", "scratch", "card.img"))
    scratch.mkdir()
    for path, text in (
        ("boot/firmware/cmdline.txt", command_line(NAME, "a")),
        ("boot/firmware/overlays/retrograph.dtbo", "overlay"),
        ("boot/firmware/bootcode.bin", "first stage"),
        ("data/app/a/ready", "1.0\n"),
        ("etc/os-release", "ID=debian\n"),
    ):
        file = root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    image_build.assemble(root, image, SMALL, NAME, 1_700_000_000, scratch, tmp_path)
    parts = {part.number: part.offset for part in partitions(SMALL)}

    def in_fat(number: int, path: str) -> str:
        return call("mtype", "-i", f"{image}@@{parts[number]}", f"::{path}")

    def in_ext4(number: int, path: str) -> str:
        return call("debugfs", "-R", f"cat {path}", f"{image}?offset={parts[number]}")

    assert in_fat(SELECT_NUMBER, "autoboot.txt") == autoboot("a")
    assert in_fat(SELECT_NUMBER, "bootcode.bin") == "first stage"
    assert in_fat(BOOT_NUMBERS["a"], "cmdline.txt") == command_line(NAME, "a")
    assert in_fat(BOOT_NUMBERS["a"], "overlays/retrograph.dtbo") == "overlay"
    assert in_ext4(ROOT_NUMBERS["a"], "etc/os-release") == "ID=debian\n"
    assert in_ext4(DATA_NUMBER, "app/a/ready") == "1.0\n"
    listed = call("debugfs", "-R", "ls data", f"{image}?offset={parts[ROOT_NUMBERS['a']]}")
    assert "app" not in listed.split(), "data is on the data partition alone"
    for name, number in (("boot", BOOT_NUMBERS["a"]), ("root", ROOT_NUMBERS["a"])):
        unpacked = tmp_path / f"{name}.img"
        call("zstd", "-q", "-d", f"{unpacked}.zst", "-o", unpacked)
        with image.open("rb") as stream:
            stream.seek(parts[number])
            assert stream.read(unpacked.stat().st_size) == unpacked.read_bytes()


def test_debian_or_raspberry_pi_but_one_kernel() -> None:
    known = image_build.facts()
    plain = image_build.packages(known, None)
    more = image_build.packages(known, Path("raspberry-pi.sources"))
    assert [name for name in plain if name.startswith("linux-image")] == ["linux-image-arm64"]
    assert [name for name in more if name.startswith("linux-image")] == ["linux-image-rpi-2712", "linux-image-rpi-v8"]
    assert "python3-picamera2" in more
    assert {"overlayroot", "raspi-firmware", "openssh-server", "avahi-daemon", "python3-venv"} <= set(plain) & set(more)
    command = image_build.bootstrap_command(Path("out.tar.zst"), None, "20251115T000000Z")
    assert command[-1].startswith("deb [check-valid-until=no] ")
    assert "20251115T000000Z/ trixie main non-free-firmware" in command[-1]


@pytest.mark.parametrize(
    ("board", "pipeline", "kernel", "tool"),
    [("pi5-imx296", "pisp", "kernel_2712.img", "vcgencmd"), ("zero2w-imx708", "vc4", "kernel8.img", None)],
)
def test_what_a_profile_claims_is_in_the_image_or_named_as_lacking(
    tmp_path: Path, board: str, pipeline: str, kernel: str, tool: str | None
) -> None:
    profile = tomllib.loads((ROOT / f"board/{board}.toml").read_text(encoding="utf-8"))
    sensor = profile["sensor"]["model"].lower()
    files = [
        f"usr/lib/aarch64-linux-gnu/libcamera/ipa/ipa_rpi_{pipeline}.so",
        f"usr/share/libcamera/ipa/rpi/{pipeline}/{sensor}.json",
        f"boot/firmware/{kernel}",
        f"boot/firmware/{kernel.replace('kernel', 'initramfs').removesuffix('.img')}",
        *([f"usr/bin/{tool}"] if tool else []),
    ]
    assert len(image_build.lacking(tmp_path, profile)) == len(files)
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    assert image_build.lacking(tmp_path, profile) == []
    (tmp_path / files[1]).unlink()
    assert image_build.lacking(tmp_path, profile) == [files[1]]
    twin = tomllib.loads((ROOT / "board/twin.toml").read_text(encoding="utf-8"))
    assert image_build.lacking(tmp_path, twin) == []


def test_the_packages_that_the_profiles_claim_are_asked_for_by_name() -> None:
    """Recommendations are off, so nothing comes by itself."""
    more = set(image_build.packages(image_build.facts(), Path("raspberry-pi.sources")))
    assert {"raspi-utils", "raspberrypi-sys-mods", "libcamera-ipa", "python3-picamera2"} <= more


def test_a_profile_that_is_not_there_is_refused_in_one_sentence(tmp_path: Path) -> None:
    options = image_build.argparse.Namespace(board="nosuchboard", ssh_key=None, network=None, sources=None)
    with pytest.raises(image_build.BuildError):
        image_build.check(options)
    assert tomllib.loads((ROOT / "board/image/image.toml").read_text())["debian"]["release"] == "trixie"
