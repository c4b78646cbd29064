"""Freed memory stays with the process inside a block, and only there."""

import platform
import sys
from pathlib import Path

import numpy as np
import pytest

from host_sync.kernels import kept_memory as module
from host_sync.kernels.kept_memory import kept_memory

GLIBC = sys.platform == "linux" and platform.libc_ver()[0] == "glibc"
MEGABYTES = 200


class Library:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: list[tuple[int, ...]] = []

    def mallopt(self, setting: int, value: int) -> None:
        self.told.append((setting, value))

    def malloc_trim(self, pad: int) -> None:
        self.told.append((pad,))


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Library:
    one = Library()
    monkeypatch.setattr(module, "_c_library", lambda: one)
    monkeypatch.setattr(module, "_users", 0)
    return one


def resident_mb() -> float:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    (value,) = (line.split()[1] for line in lines if line.startswith("VmRSS"))
    return int(value) / 1024


@pytest.mark.skipif(not GLIBC, reason="only the GNU C library has these settings")
def test_a_freed_array_stays_inside_and_goes_afterwards() -> None:
    before = resident_mb()
    with kept_memory():
        for _ in range(2):
            values = np.ones(MEGABYTES << 17)
            del values
        assert resident_mb() > before + 0.9 * MEGABYTES
    assert resident_mb() < before + 0.5 * MEGABYTES


def test_the_last_of_nested_blocks_returns_memory(library: Library) -> None:
    @kept_memory()
    def work() -> int:
        return len(library.told)

    with kept_memory():
        told = len(library.told)
        assert told > 0
        assert work() == work() == told
        assert len(library.told) == told
    assert library.told[-1] == (0,)
    assert len(library.told) > told


def test_memory_is_returned_after_an_error(library: Library) -> None:
    with pytest.raises(ValueError, match="no"), kept_memory():
        raise ValueError("no")
    assert library.told[-1] == (0,)


def test_another_c_library_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_c_library", lambda: None)
    with kept_memory():
        assert module._users == 0
