"""Freed memory stays with the process inside a block, and only there."""

import platform
import subprocess
import sys
from pathlib import Path

import pytest

from host_sync.kernels import process_settings as module
from host_sync.kernels.process_settings import kept_memory

GLIBC = sys.platform == "linux" and platform.libc_ver()[0] == "glibc"
MEGABYTES = 200
ROOT = Path(__file__).parents[3]


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


# In a process of its own: one that ran other tests holds free memory already.
PROGRAM = """
import sys
from pathlib import Path

import numpy as np

from host_sync.kernels.process_settings import kept_memory


def resident_mb():
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


figures = [resident_mb()]
with kept_memory():
    for _ in range(2):
        values = np.ones(int(sys.argv[1]) << 17)
        del values
    figures.append(resident_mb())
figures.append(resident_mb())
print(*figures)
"""


@pytest.mark.skipif(not GLIBC, reason="only the GNU C library has these settings")
def test_a_freed_array_stays_inside_and_goes_afterwards() -> None:
    run = [sys.executable, "-c", PROGRAM, str(MEGABYTES)]
    said = subprocess.run(run, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    before, inside, after = map(float, said.split())
    assert inside > before + 0.9 * MEGABYTES
    assert after < before + 0.5 * MEGABYTES


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
