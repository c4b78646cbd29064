"""Kernels of different states of the sources are never mixed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import host_sync
from host_sync.kernels.cache import KEPT_S, PACKAGES, SETTING, configure_cache, prune_cache, state_of

CALLER = """
from numba import njit
from callee import inner

@njit(cache=True)
def outer():
    return inner()

print(outer())
"""
CALLEE = """
from numba import njit

@njit(cache=True)
def inner():
    return {number}
"""


def package(folder: Path, **sources: str) -> Path:
    for name, text in sources.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


def test_a_state_is_known_by_every_source_file(tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    package(tmp_path, first="a = 1")
    package(tmp_path / "inside", second="b = 2")
    before = state_of(tmp_path)
    assert state_of(tmp_path) == before
    os.utime(tmp_path / "inside" / "second.py", ns=(7, 7))
    after = state_of(tmp_path)
    package(tmp_path, third="")
    assert len({before, after, state_of(tmp_path)}) == 3


def test_what_python_leaves_behind_changes_no_state(tmp_path: Path) -> None:
    package(tmp_path, first="a = 1")
    before = state_of(tmp_path)
    (tmp_path / "__pycache__").mkdir()
    package(tmp_path / "__pycache__", compiled="")
    (tmp_path / "notes.txt").write_text("no source")
    assert state_of(tmp_path) == before


def test_a_called_kernel_is_compiled_again_when_its_file_changes(tmp_path: Path) -> None:
    """The purpose of the folder: numba alone would still answer 1."""
    sources = tmp_path / "sources"
    sources.mkdir()
    found = []
    for number in (1, 22):
        package(sources, caller=CALLER, callee=CALLEE.format(number=number))
        os.utime(sources / "caller.py", ns=(7, 7))
        environment = {**os.environ, SETTING: str(tmp_path / state_of(sources))}
        run = subprocess.run(
            [sys.executable, sources / "caller.py"], env=environment, capture_output=True, text=True, check=True
        )
        found.append(int(run.stdout))
    assert found == [1, 22]


def test_every_import_of_a_kernel_caches_outside_the_sources(tmp_path: Path) -> None:
    """A kernel that has run is found again, in the folder of this state and not beside its source."""
    code = (
        "import os, numpy as np; "
        "from host_sync.kernels.cache import holds_kernels; assert not holds_kernels(); "
        "from host_sync.integration import datum; "
        "datum.cell_sums(*(np.ones((8, 8), kind) for kind in ('f4', 'f4', '?')), 2); "
        "assert holds_kernels(); print(os.environ['NUMBA_CACHE_DIR']); print(datum._add_cells.stats.cache_path)"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop(SETTING, None)
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    chosen, used = run.stdout.splitlines()
    assert Path(chosen).parent == tmp_path / "retrograph" / "kernels"
    assert Path(used).parent == Path(chosen)


def test_every_kernel_is_compiled_with_the_cache_configured() -> None:
    root = Path(host_sync.__file__).parent
    importing = [path for path in root.rglob("*.py") if "from numba " in path.read_text(encoding="utf-8")]
    assert [path.name for path in importing] == ["jit.py"]


def test_a_state_covers_every_kernel_of_the_package() -> None:
    """A kernel may call one of any other package."""
    root = Path(host_sync.__file__).parent
    kernels = [path for path in root.rglob("*.py") if "njit" in path.read_text(encoding="utf-8")]
    assert kernels
    assert all(any(path.is_relative_to(package) for package in PACKAGES) for path in kernels)


def test_who_sets_a_folder_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    environment = {SETTING: str(tmp_path)}
    configure_cache(environment)
    assert environment[SETTING] == str(tmp_path)
    prune_cache(environment)
    assert tmp_path.is_dir()


def test_folders_that_nobody_has_used_for_a_month_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    environment: dict[str, str] = {}
    configure_cache(environment)
    own = Path(environment[SETTING])
    assert own.parent == tmp_path / "retrograph" / "kernels"
    others = [own.parent / name for name in ("recent", "old")]
    for folder in (own, *others):
        (folder / "reconstruction").mkdir(parents=True)
    used_s = others[0].stat().st_mtime
    os.utime(others[1], (0, used_s - KEPT_S - 60.0))
    os.utime(own, (0, used_s - 2 * KEPT_S))
    prune_cache(environment, now_s=used_s)
    assert sorted(folder.name for folder in own.parent.iterdir()) == sorted([own.name, "recent"])
    assert own.stat().st_mtime >= used_s
