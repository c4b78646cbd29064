"""A hostile card, one harm at a time: nothing outside is touched, the rest arrives, and one sentence says why."""

from __future__ import annotations

import os
import shutil
import signal
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from hostile import HARMS, QUIET, SPOILED_BUNDLES, Harm, Tiff, Victim, listed

from device.bundles.raw_frame import read_raw, write_raw
from device.bundles.scan import ScanBundle, read_scan
from device.errors import RecordError
from device.store.store import BundleStore
from hal.clock import VirtualClock
from hal.frame import CameraSettings, RawFrame
from host_sync.cli.main import main

LONGEST_S = 30
EVERY_THIRD = [what if at % 3 == 0 else pytest.param(what, marks=pytest.mark.slow) for at, what in enumerate(HARMS)]
SECRET = b"ssh-ed25519 mine\n"


class TookTooLong(BaseException):
    """Not an error that a reader could take for bad input."""


@pytest.fixture(autouse=True)
def in_time() -> Iterator[None]:
    def ring(_: int, __: FrameType | None) -> None:
        raise TookTooLong

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(autouse=True)
def without_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture
def victim(store: BundleStore, publish_scan: Callable[..., ScanBundle], tmp_path: Path) -> Victim:
    """The second of three scans of a card."""
    outside = tmp_path / "outside"
    outside.mkdir()
    scans = [publish_scan(store) for _ in range(3)]
    found = Victim(store.root, scans[1].directory, outside)
    found.secret.write_bytes(SECRET)
    return found


def other_scans(victim: Victim) -> set[str]:
    return {path.name for path in victim.scan.parent.iterdir() if path.name.startswith("rg")} - {victim.scan.name}


def check_answers(said: pytest.CaptureFixture[str], code: int, what: str) -> str:
    told = said.readouterr()
    assert "Traceback" not in told.err, told.err
    assert all(line.startswith("retrosync: ") for line in told.err.splitlines()), told.err
    assert "\x1b" not in told.err + told.out
    assert code in (0, 1), f"{what}: exit code {code}: {told.err}"
    assert bool(told.err) == (code == 1), f"{what}: exit code {code}: {told.err}"
    return told.err


@pytest.mark.parametrize("what", EVERY_THIRD)
def test_a_hostile_card_harms_nobody_else(
    victim: Victim, tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    others = other_scans(victim)
    HARMS[what](victim)
    library = tmp_path / "library"
    pull = ["pull", str(victim.store), "--library", str(library)]
    code = main(pull)
    errors = check_answers(capsys, code, what)
    assert code == (0 if what in QUIET else 1)
    assert code == 0 or len(errors.splitlines()) == 1
    for command in (["verify"], ["list"], ["list", "--set-aside"]):
        assert main([*command, "--library", str(library)]) == 0, capsys.readouterr().err
    assert main(["list", "--library", str(library)]) == 0
    found = capsys.readouterr().out
    assert all(scan in found for scan in others)
    check_answers(capsys, main(pull), f"{what}, again")
    assert victim.secret.read_bytes() == SECRET
    assert [path.name for path in victim.outside.iterdir()] == [victim.secret.name]


@pytest.mark.parametrize("what", list(SPOILED_BUNDLES)[::3])
def test_a_spoiled_bundle_of_the_library_is_noticed_and_repaired(
    victim: Victim, tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    library = tmp_path / "library"
    assert main(["pull", str(victim.store), "--library", str(library)]) == 0
    inside = Victim(library, library / "scans" / victim.scan.name, victim.outside)
    others = other_scans(inside)
    SPOILED_BUNDLES[what](inside)
    capsys.readouterr()
    code = main(["verify", "--library", str(library)])
    assert code == 1
    errors = check_answers(capsys, code, what)
    assert len(errors.splitlines()) == 1
    assert victim.scan.name in errors
    main(["list", "--library", str(library)])
    told = capsys.readouterr()
    assert "Traceback" not in told.err
    assert all(scan in told.out for scan in others)
    check_answers(capsys, main(["pull", str(victim.store), "--library", str(library)]), what)
    assert main(["verify", "--repair", str(victim.store), "--library", str(library)]) == 0
    assert main(["verify", "--library", str(library)]) == 0
    assert main(["list", "--set-aside", "--library", str(library)]) == 0
    assert victim.scan.name in capsys.readouterr().out
    assert victim.secret.read_bytes() == SECRET
    assert [path.name for path in victim.outside.iterdir()] == [victim.secret.name]


@pytest.fixture(scope="module")
def honest_peak_bytes(tmp_path_factory: pytest.TempPathFactory) -> int:
    """Memory that reading a frame of the largest supported sensor takes."""
    path = tmp_path_factory.mktemp("honest") / "raw.tif"
    counts = np.random.default_rng(0).integers(250, 4096, (3040, 4056), dtype=np.uint16)
    write_raw(path, RawFrame(counts, "RGGB", 256.0, 4095.0, CameraSettings(2000.0, 1.0), 0))
    return peak_bytes(lambda: read_raw(path))


def peak_bytes(work: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def spoiled_frames(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("frame") / "raw.tif"
    mosaic = np.random.default_rng(1).integers(250, 4096, (32, 48), dtype=np.uint16)
    write_raw(path, RawFrame(mosaic, "RGGB", 256.0, 4095.0, CameraSettings(1998.4, 1.0), 1))
    return Tiff(path.read_bytes()).all()


def test_a_spoiled_frame_is_pulled_as_it_is_and_refused_before_it_is_decoded(
    victim: Victim, tmp_path: Path, spoiled_frames: dict[str, bytes], honest_peak_bytes: int
) -> None:
    signal.alarm(10 * LONGEST_S)
    kept = tmp_path / "kept"
    shutil.copytree(victim.scan, kept)
    for what, data in spoiled_frames.items():
        shutil.rmtree(victim.scan)
        shutil.copytree(kept, victim.scan)
        listed(victim, "raw.tif", data)
        library = tmp_path / f"library of {len(data)} {what}".replace("/", "-")

        def pulled_and_refused(library: Path = library, what: str = what) -> None:
            assert main(["pull", str(victim.store), "--library", str(library)]) == 0, what
            assert main(["verify", "--library", str(library)]) == 0, what
            bundle = read_scan(library / "scans" / victim.scan.name)
            with pytest.raises(RecordError, match=r"raw\.tif") as caught:
                bundle.raw_frame()
            assert "\n" not in str(caught.value)

        assert peak_bytes(pulled_and_refused) <= 1.5 * honest_peak_bytes, what
        assert main(["export", victim.scan.name, "--library", str(library), "--to", "dng", "--out", str(tmp_path)]) != 0


def test_there_are_two_hundred_harms() -> None:
    assert len(HARMS) >= 200
    assert set(HARMS) > QUIET


def test_a_device_keeps_its_store_when_the_card_is_hostile(victim: Victim) -> None:
    """What a workstation's key can put into receipts and inbox does not stop the store from being opened and freed."""
    harms: dict[str, Harm] = {what: harm for what, harm in HARMS.items() if "receipt " in what}
    for harm in harms.values():
        harm(victim)
        for path in (victim.store / "receipts").iterdir():
            store = BundleStore(victim.store, VirtualClock(), boot_id="b0071d01")
            assert len(store.scans().bundles) == 3
            assert store.make_room(1) == []
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)  # what is no receipt is gone already
    assert victim.secret.read_bytes() == SECRET
