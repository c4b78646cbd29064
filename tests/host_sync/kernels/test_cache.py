"""A compiled kernel is found again until something changes that it computes with."""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import host_sync
from host_sync.kernels.cache import KEPT_S, SETTING, SUFFIX, USER_CACHE, configure_cache, prune_cache, state_of
from host_sync.kernels.jit import CompileTime, kernel_digest, njit

SOURCES = {
    "caller": """
from callee import inner
from numbers_of_kernels import FACTOR
from host_sync.kernels.jit import njit

@njit(cache=True)
def outer(number):
    '''Return the number, multiplied.'''
    return FACTOR * inner(number)
""",
    "callee": """
from host_sync.kernels.jit import njit

@njit(cache=True, fastmath={"contract"})
def inner(number):
    return 1 * number
""",
    "numbers_of_kernels": "FACTOR = 3\n",
}
CALL = """
import sys
from host_sync.kernels.jit import CompileTime
clock = CompileTime()
from caller import outer
print(outer(7), clock.total_s > 0.0)
"""


class Kernels:
    """Source files of a kernel, of another that it calls and of a constant, run in a process of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "sources"
        self.cache = folder / "cache"
        self.folder.mkdir()
        for name, text in SOURCES.items():
            (self.folder / f"{name}.py").write_text(text, encoding="utf-8")

    def change(self, name: str, old: str, new: str) -> None:
        path = self.folder / f"{name}.py"
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")

    def run(self) -> tuple[int, bool]:
        """Return the result, and whether anything was compiled for it."""
        path = os.pathsep.join((str(self.folder), str(Path(host_sync.__file__).parents[1])))
        environment = {**os.environ, SETTING: str(self.cache), "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
        run = subprocess.run([sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, check=True)
        result, compiled = run.stdout.split()
        return int(result), compiled == "True"


def test_a_kernel_is_compiled_again_exactly_when_what_it_reaches_changes(tmp_path: Path) -> None:
    """numba alone would compile again after the new docstring, and not after the new number in another file."""
    kernels = Kernels(tmp_path)
    assert kernels.run() == (21, True)
    assert kernels.run() == (21, False)
    kernels.change("caller", "Return the number, multiplied.", "Return a product.\n\n    A longer text.\n    ")
    kernels.change("callee", "@njit", "# A remark.\n\n@njit")
    assert kernels.run() == (21, False)
    kernels.change("callee", "1 * number", "22 * number")
    assert kernels.run() == (3 * 22 * 7, True)
    kernels.change("numbers_of_kernels", "3", "4")
    assert kernels.run() == (4 * 22 * 7, True)
    kernels.change("callee", ', fastmath={"contract"}', "")
    assert kernels.run() == (4 * 22 * 7, True)
    kernels.change("numbers_of_kernels", "4", "3")
    kernels.change("callee", "cache=True", 'cache=True, fastmath={"contract"}')
    assert kernels.run() == (3 * 22 * 7, False)


def test_a_file_that_was_not_fully_written_is_compiled_again(tmp_path: Path) -> None:
    kernels = Kernels(tmp_path)
    assert kernels.run() == (21, True)
    files = list(kernels.cache.glob(f"*{SUFFIX}"))
    assert len(files) == 2
    for path in files:
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2] + bytes(len(content) - len(content) // 2))
    assert kernels.run() == (21, True)
    assert kernels.run() == (21, False)


def test_a_kernel_whose_callee_moved_to_another_module_is_compiled_again(tmp_path: Path) -> None:
    kernels = Kernels(tmp_path)
    assert kernels.run() == (21, True)
    (kernels.folder / "callee.py").rename(kernels.folder / "moved.py")
    kernels.change("caller", "from callee", "from moved")
    assert kernels.run() == (21, True)
    assert kernels.run() == (21, False)


def test_a_folder_that_cannot_be_written_keeps_nothing(tmp_path: Path) -> None:
    kernels = Kernels(tmp_path)
    kernels.cache.write_text("no folder")
    assert kernels.run() == (21, True)
    assert kernels.run() == (21, True)
    assert kernels.cache.read_text() == "no folder"


def test_all_that_any_kernel_of_the_package_uses_is_part_of_its_digest() -> None:
    """A kernel that used a module or a plain function of the package would raise."""
    modules = [importlib.import_module(found.name) for found in pkgutil.walk_packages(host_sync.__path__, "host_sync.")]
    kernels = {id(value): value for module in modules for value in vars(module).values() if hasattr(value, "py_func")}
    assert len(kernels) > 50
    assert len({kernel_digest(kernel) for kernel in kernels.values()}) == len(kernels)


def test_a_kernel_that_uses_what_no_digest_covers_is_refused() -> None:
    with pytest.raises(TypeError, match=r"not_covered uses .*, which no digest can cover"):
        kernel_digest(not_covered)


@njit(cache=False)
def not_covered() -> object:
    return Path, CompileTime  # a class of the package, whose attributes may be anything


def test_every_import_of_a_kernel_caches_in_the_users_folder(tmp_path: Path) -> None:
    """A kernel that has run is found again, in that folder and not beside its source."""
    code = (
        "import numpy as np; "
        "from host_sync.kernels.cache import holds_kernels; assert not holds_kernels(); "
        "from host_sync.integration import datum; "
        "datum.cell_sums(*(np.ones((8, 8), kind) for kind in ('f4', 'f4', '?')), 2); "
        "assert holds_kernels(); print(datum._add_cells.stats.cache_path)"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop(SETTING, None)
    environment.pop(USER_CACHE, None)
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    used = tmp_path / "retrograph" / "kernels"
    assert run.stdout.splitlines() == [str(used)]
    assert {path.name.partition("-")[0] for path in used.iterdir()} >= {"host_sync.integration.datum._add_cells"}
    assert {path.suffix for path in used.iterdir()} == {SUFFIX}


def test_every_kernel_is_compiled_with_the_cache_configured() -> None:
    root = Path(host_sync.__file__).parent
    importing = [path for path in root.rglob("*.py") if "from numba " in path.read_text(encoding="utf-8")]
    assert [path.name for path in importing] == ["jit.py"]


def test_who_sets_a_folder_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    environment = {SETTING: str(tmp_path)}
    configure_cache(environment)
    assert environment[SETTING] == str(tmp_path)
    (tmp_path / f"old{SUFFIX}").touch()
    os.utime(tmp_path / f"old{SUFFIX}", (0, 0))
    prune_cache(environment)
    assert [path.name for path in tmp_path.iterdir()] == [f"old{SUFFIX}"]


def test_kernels_that_nobody_has_used_for_a_month_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    environment: dict[str, str] = {}
    configure_cache(environment)
    home = Path(environment[SETTING])
    assert home == tmp_path / "retrograph" / "kernels"
    for folder in ("folder of today", "folder of an earlier version"):
        (home / folder / "reconstruction").mkdir(parents=True)
    for name in ("recent", "old"):
        (home / f"{name}{SUFFIX}").touch()
    used_s = (home / f"recent{SUFFIX}").stat().st_mtime
    for old in (f"old{SUFFIX}", "folder of an earlier version"):
        os.utime(home / old, (0, used_s - KEPT_S - 60.0))
    prune_cache(environment, now_s=used_s)
    assert sorted(entry.name for entry in home.iterdir()) == ["folder of today", f"recent{SUFFIX}"]


def test_a_state_of_sources_is_another_after_every_change_of_a_source_file(tmp_path: Path) -> None:
    package, other = tmp_path / "package", tmp_path / "other"
    deeper = package / "deeper"
    for folder in (deeper, package / "__pycache__", other):
        folder.mkdir(parents=True)
    for path in (package / "one.py", deeper / "two.py", other / "three.py"):
        path.write_text("A = 1\n")
        os.utime(path, (1e9, 1e9))
    states = [state_of(package, other)]
    for beside in (package / "table.toml", package / "__pycache__" / "one.py", package / "__pycache__" / "one.pyc"):
        beside.write_text("1")
    (deeper / "two.py").read_text()
    assert state_of(package, other) == states[0], "what is compiled from sources and what lies beside them is no source"

    (deeper / "two.py").write_text("A = 2\n")
    os.utime(deeper / "two.py", (1e9, 1e9 + 1))
    states.append(state_of(package, other))
    (deeper / "two.py").write_text("A = 20\n")
    os.utime(deeper / "two.py", (1e9, 1e9 + 1))
    states.append(state_of(package, other))
    (deeper / "two.py").rename(deeper / "four.py")
    states.append(state_of(package, other))
    (deeper / "four.py").rename(package / "four.py")
    states.append(state_of(package, other))
    (package / "four.py").unlink()
    states.append(state_of(package, other))
    (other / "three.py").write_text("A = 3\n")
    states.append(state_of(package, other))
    assert len(set(states)) == len(states) == 7
    assert states[-1] != state_of(package)
