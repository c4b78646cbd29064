"""The virtual board: its cache, the machine, and how long each stage took."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from virtual_board import DATA_MIB, SHARES, Board, Stage
from virtual_machine import VirtualMachine

TREE = Path(__file__).parents[2]
STAGES = pytest.StashKey[list[tuple[str, float]]]()


@pytest.fixture(scope="session")
def system_cache() -> Path:
    named = os.environ.get("RETROGRAPH_SYSTEM")
    if not named:
        pytest.skip("RETROGRAPH_SYSTEM names no cache of the virtual board: run make system-root or make system-test")
    cache = Path(named).expanduser()
    missing = [
        name for name in ("bzImage", "root.ext4", "initrd.img", "trees", "wheels") if not (cache / name).exists()
    ]
    if missing:
        pytest.skip(f"{cache} has no {', '.join(missing)}: run make system-root or make system-test")
    return cache


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """This tree as the wheel that a release holds."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], cwd=TREE, check=True)
    return next(folder.iterdir())


@pytest.fixture(scope="session")
def stage(request: pytest.FixtureRequest) -> Stage:
    """Measures what happens within it, for the table at the end."""
    seconds = request.config.stash.setdefault(STAGES, [])

    @contextmanager
    def measured(name: str) -> Iterator[None]:
        began = time.monotonic()
        yield
        seconds.append((name, time.monotonic() - began))

    return measured


@pytest.fixture(scope="session")
def release(system_cache: Path, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A release folder with the wheels that a device without a network needs; the heavy ones are in its root."""
    folder = tmp_path_factory.mktemp("handover") / "release"
    folder.mkdir()
    shutil.copy(wheel, folder)
    shutil.copy(TREE / "requirements-device.lock", folder)
    for part in ("board", "systemd"):
        shutil.copytree(TREE / part, folder / part)
    (folder / "wheels").mkdir()
    for needed in (system_cache / "wheels" / "device").iterdir():
        if not needed.name.startswith(("numpy", "scipy", "opencv", "imagecodecs")):
            shutil.copy(needed, folder / "wheels")
    return folder


@pytest.fixture(scope="session")
def board(system_cache: Path, release: Path, tmp_path_factory: pytest.TempPathFactory, stage: Stage) -> Iterator[Board]:
    folder = tmp_path_factory.mktemp("vm")
    data, blank = folder / "data.img", folder / "blank.img"
    with data.open("wb") as stream:
        stream.truncate(DATA_MIB << 20)
    subprocess.run(["mkfs.ext4", "-q", "-L", "retrograph-data", "-m", "0", data], check=True)
    subprocess.run(["cp", "--sparse=always", data, blank], check=True)
    shares = {"source": TREE, "handover": release.parent}
    with ExitStack() as held:
        with stage("first boot"):
            machine = held.enter_context(VirtualMachine(system_cache, folder, shares, data=data))
            machine.run("systemctl is-system-running --wait || true")
            machine.run(SHARES)
        yield Board(machine, stage, blank, release.parent)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    stages = config.stash.get(STAGES, [])
    if stages:
        terminalreporter.section("stages on the virtual board (emulated processor)")
        for name, seconds in stages:
            terminalreporter.write_line(f"{seconds:7.1f} s  {name}")
