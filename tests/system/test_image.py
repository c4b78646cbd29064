"""The image of `make image` in QEMU's arm64 board: it boots, scans with the twin by name, and is pulled from.

`make system-test` builds the image of the twin, as any board's but for the profile. docs/image.md says what this shows.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import image_build
import pytest
from image_layout import Sizes
from paired_guest import pair_by_typing
from virtual_board import Stage
from virtual_card import VirtualCard
from virtual_machine import SSH

from device.bundles.scan import read_scan

pytestmark = pytest.mark.system

TREE = Path(__file__).parents[2]
CARD_MIB = 7600
"""A card that is sold as 8 GB."""

HANDOVER = "/data/handover"
PATIENCE = ("--patience-s", "120")
"""An emulated board takes about 8 s to answer one request."""

TWIN = "runuser -u retroscan -- retroscan --board twin --store /var/lib/retroscan"


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory, stage: Stage) -> Iterator[VirtualCard]:
    cache = Path(os.environ.get("RETROGRAPH_IMAGE", "no-image")).expanduser()
    missing = [name for name in ("twin.img", "key") if not (cache / name).exists()]
    if missing:
        pytest.skip(f"RETROGRAPH_IMAGE names no folder with {' and '.join(missing)}: run make system-test")
    sizes = Sizes(**image_build.facts()["sizes"])
    update = cache / "twin.update"
    share = update if update.is_dir() else None
    folder = tmp_path_factory.mktemp("card")
    with VirtualCard(cache / "twin.img", cache / "key", sizes, folder, CARD_MIB, share) as machine:
        with stage("image: first boot until SSH answers"):
            machine.wait_for("true")
        with stage("image: until the first boot has made id and name"):
            machine.wait_for("systemctl is-active retrograph-first-boot")
        yield machine


def test_the_root_is_read_only_and_data_has_grown_to_the_cards_end(card: VirtualCard) -> None:
    roots = "findmnt -n -o FSTYPE /; findmnt -n -o OPTIONS /media/root-ro | cut -d , -f 1; findmnt -n -o FSTYPE /data"
    assert card.run(roots).split() == ["overlay", "ro", "ext4"]
    built = image_build.facts()["sizes"]["data_mib"]
    grown = int(card.run("df --output=size -BM /data | tail -n 1").strip().removesuffix("M"))
    assert grown > 1.3 * built
    assert card.run("findmnt -n -o FSTYPE,OPTIONS /boot/firmware").split()[0] == "vfat"


def test_it_booted_from_slot_a_with_a_key_and_a_name_of_its_own(card: VirtualCard) -> None:
    assert "slot a: partitions 2 and 5, booted, default" in card.run("retrograph-root status")
    assert card.run("ssh-keygen -lf /data/ssh/ssh_host_ed25519_key.pub").startswith("256 SHA256:")
    assert card.run("hostname").startswith("rg")
    assert card.run("systemctl list-units --failed --no-legend --plain") == ""


def test_it_scans_with_the_twin_by_name_and_is_pulled_from(
    card: VirtualCard, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    made = tmp_path / "workstation"
    retroscan(made, "calibrate")
    (calibration,) = (made / "calibrations").iterdir()
    card.run("systemctl stop retroscan")
    with stage("image: a calibration of the twin, made here, is imported"):
        card.put(calibration, HANDOVER)
        card.run(
            f"chown -R retroscan: {HANDOVER}; {TWIN} calibrations import {HANDOVER}/{calibration.name} --adopt --use; "
            f"rm -r {HANDOVER}"
        )
    with stage("image: scan"):
        said = card.run(f"{TWIN} scan </dev/null", 3000.0)
    taken = re.search(r"^good: .* \(([\w-]+)\)$", said, re.MULTILINE)
    assert taken, said
    device = pair_by_typing(card, TREE)
    library = tmp_path / "library"
    with stage("image: pull over SFTP"):
        retrosync("pull", device, "--at", f"127.0.0.1:{card.ports[SSH]}", "--library", str(library), *PATIENCE)
    assert {path.name for path in (library / "scans").iterdir()} == {taken[1]}
    read_scan(library / "scans" / taken[1]).verify()


def test_an_update_boots_from_the_other_slot_and_is_kept(card: VirtualCard, stage: Stage) -> None:
    if card.share is None:
        pytest.skip("the image was built without UPDATE=1")
    card.run("mkdir -p /run/share; mount -t 9p -o trans=virtio,version=9p2000.L,ro share /run/share")
    with stage("image: update into slot b"):
        card.run("retrograph-root install /run/share", 3000.0)
    assert "slot b" in card.run("retrograph-root try")
    card.wait_until_off()
    assert card.default_slot() == "b"
    with stage("image: boot of slot b until it is kept"):
        card.switch_on()
        card.wait_for("systemctl is-active retroscan; test ! -e /data/root-trial")
    assert "slot b: partitions 3 and 6, booted, default" in card.run("retrograph-root status")
    card.run(f"{TWIN} list")


def test_a_root_that_stayed_writable_is_an_alarm(card: VirtualCard, stage: Stage) -> None:
    """As with an initramfs that lacks the driver: overlayroot goes on without it."""
    card.run("systemctl poweroff --no-block")
    card.wait_until_off()
    with stage("image: boot without the overlay until the alarm"):
        card.switch_on("rw overlayroot=tmpfs:driver=absent")
        card.wait_for("systemctl show -P StatusText retroscan | grep 'the root file system is writable although'")
    assert card.run("findmnt -n -o FSTYPE /").strip() == "ext4"


def retrosync(*arguments: str) -> str:
    return run_here("host_sync", *arguments)


def retroscan(store: Path, *arguments: str) -> str:
    return run_here("device", "--board", "twin", "--store", str(store), *arguments)


def run_here(module: str, *arguments: str) -> str:
    ran = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=TREE, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout
