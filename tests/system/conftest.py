"""The virtual board's cache, and how long each stage took."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

TREE = Path(__file__).parents[2]
STAGES = pytest.StashKey[list[tuple[str, float]]]()
Stage = Callable[[str], AbstractContextManager[None]]


@pytest.fixture(scope="session")
def system_cache() -> Path:
    named = os.environ.get("RETROGRAPH_SYSTEM")
    if not named:
        pytest.skip("RETROGRAPH_SYSTEM names no cache of the virtual board: run make system-root or make system-test")
    cache = Path(named).expanduser()
    missing = [name for name in ("bzImage", "root.ext4", "wheels") if not (cache / name).exists()]
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


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    stages = config.stash.get(STAGES, [])
    if stages:
        terminalreporter.section("stages on the virtual board (emulated processor)")
        for name, seconds in stages:
            terminalreporter.write_line(f"{seconds:7.1f} s  {name}")
