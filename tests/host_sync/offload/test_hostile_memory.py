"""Peak memory of pull, verify, reconstruct and view over every hostile card and frame, and over an honest card."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hostile import HARMS, Harm, Tiff, Victim, listed
from peak_memory import Commands, Ran

from device.acquisition.scanner import Scanner
from device.bundles.scan import Annotations, ScanBundle
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import PressObject
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware

MOST = 1.5
COMMANDS = ("pull", "verify", "reconstruct", "view")
HONEST_SCANS = 3


def scan_coins(root: Path, board: BoardProfile, scans: int) -> list[ScanBundle]:
    """So many presses of a coin, into a calibrated store."""
    with twin_hardware(build(board, VirtualClock())) as hardware:
        scanner = Scanner(hardware, BundleStore(root, hardware.clock, boot_id="b0075e20"))
        made = []
        for _ in range(scans):
            hardware.operator.ask(PressObject("coin"))
            hardware.button.wait_for_press(None)
            made.append(scanner.scan(Annotations()).bundle)
    return made


@pytest.fixture(scope="module")
def card(calibrated_root: Path, small_twin: BoardProfile, tmp_path_factory: pytest.TempPathFactory) -> Victim:
    """A card with three scans and their calibration; the second is the victim."""
    folder = tmp_path_factory.mktemp("honest")
    root = Path(shutil.copytree(calibrated_root, folder / "store"))
    scans = scan_coins(root, small_twin, HONEST_SCANS)
    (folder / "outside").mkdir()
    (folder / "outside" / "authorized_keys").write_bytes(b"ssh-ed25519 mine\n")
    victim = Victim(root, scans[1].directory, folder / "outside")
    listed(victim, "preview.png", bytes(range(256)) * 20)
    return victim


@pytest.fixture(scope="module")
def frames_card(calibrated_root: Path, small_twin: BoardProfile, tmp_path_factory: pytest.TempPathFactory) -> Victim:
    """A card whose first scan is honest, and whose others have a spoiled frame each, in manifests that are in order."""
    folder = tmp_path_factory.mktemp("frames")
    root = Path(shutil.copytree(calibrated_root, folder / "store"))
    (first,) = scan_coins(root, small_twin, 1)
    spoiled = Tiff(first.path("raw.tif").read_bytes()).all().values()
    for scan, data in zip(scan_coins(root, small_twin, len(spoiled)), spoiled, strict=True):
        listed(Victim(root, scan.directory, folder), "raw.tif", data)
    return Victim(root, first.directory, folder)


@pytest.fixture(scope="module")
def commands() -> Iterator[Commands]:
    with Commands() as running:
        yield running


def run_all(commands: Commands, card: Victim, library: Path, names: tuple[str, ...] = COMMANDS) -> dict[str, Ran]:
    """Each command on a card and its library."""
    asked: dict[str, tuple[str | Path, ...]] = {
        "pull": ("pull", card.store, "--library", library),
        "verify": ("verify", "--library", library),
        "reconstruct": ("reconstruct", "--library", library),
        "view": ("view", library, "--no-browser", "--cache", library.with_name("cache")),
    }
    return {name: commands.run(*asked[name]) for name in names}


def copied(card: Victim, folder: Path, harm: Harm) -> Victim:
    """A copy of a card, to which a harm was done."""
    shutil.copytree(card.store.parent, folder, symlinks=True)
    victim = Victim(folder / "store", folder / "store" / "scans" / card.scan.name, folder / "outside")
    harm(victim)
    return victim


def honest_or_absent(card: Victim, library: Path) -> bool:
    """Whether the victim's frame and manifest in the library are those of the honest card, or are not there."""
    pulled = library / "scans" / card.scan.name
    return not pulled.exists() or all(
        (pulled / name).read_bytes() == (card.scan / name).read_bytes() for name in ("raw.tif", "scan.json")
    )


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the peak of memory is read from the kernel")
def test_no_hostile_card_takes_half_as_much_again_as_an_honest_one(
    card: Victim, frames_card: Victim, commands: Commands, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    honest = run_all(commands, copied(card, tmp_path / "honest", lambda _: None), tmp_path / "honest" / "library")
    assert [ran.code for ran in honest.values()] == [0, 0, 0, 0], honest
    most = dict.fromkeys(COMMANDS, (0, ""))

    def note(what: str, done: dict[str, Ran]) -> None:
        for name, ran in done.items():
            assert ran.code in (0, 1), f"{what}: {name}: {ran}"
            assert "Traceback" not in ran.errors, f"{what}: {name}: {ran}"
            most[name] = max(most[name], (ran.peak_kb, what))

    for number, (what, harm) in enumerate(HARMS.items()):
        folder = tmp_path / f"{number}"
        spoiled = copied(card, folder, harm)
        note(what, run_all(commands, spoiled, folder / "library", ("pull", "verify", "view")))
        assert honest_or_absent(card, folder / "library"), what  # so there is nothing hostile to reconstruct
        shutil.rmtree(folder)
    frames = run_all(commands, frames_card, tmp_path / "frames" / "library")
    assert frames["reconstruct"].code == 1
    note("spoiled frames", frames)
    with capsys.disabled():
        for name in COMMANDS:
            (peak_kb, what), own_kb = most[name], honest[name].peak_kb
            ratio = f"{peak_kb / own_kb:.2f} times"
            sys.stdout.write(f"\n{name}: honest {own_kb / 1e3:.0f} MB, hostile {peak_kb / 1e3:.0f} MB, {ratio}: {what}")
        sys.stdout.write(f"\n{len(HARMS)} cards, {len(frames_card_scans(frames_card))} frames\n")
    for name in COMMANDS:
        assert most[name][0] <= MOST * honest[name].peak_kb, (name, most[name])


def frames_card_scans(card: Victim) -> list[Path]:
    """The scans with spoiled frames."""
    return [path for path in (card.store / "scans").iterdir() if path != card.scan]
