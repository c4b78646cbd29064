"""The handheld's tests are left out only when nothing that they reach has changed since they passed."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.instrument_passed import HANDHELD_TESTS, ROOT, keep, options, state_of

FILES = ["device/errors.py", "tests/device/test_errors.py", "host_sync/api.py", "tests/host_sync/test_api.py"]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n", encoding="utf-8")
    return tmp_path


def test_all_run_until_they_passed_in_this_state(project: Path) -> None:
    stamp = project / "stamp"
    state = state_of(project, FILES)
    assert options(stamp, state) == []
    assert options(stamp, state) == []  # the first run failed
    keep(stamp)
    assert options(stamp, state) == [f"--ignore={folder}" for folder in HANDHELD_TESTS]
    assert options(stamp, None) == []
    keep(stamp)  # a run in an unknown state proves nothing new
    assert options(stamp, "another state") == []


@pytest.mark.parametrize("name", FILES)
def test_only_a_change_of_the_workstation_keeps_the_state(project: Path, name: str) -> None:
    before = state_of(project, FILES)
    (project / name).write_text("2\n", encoding="utf-8")
    assert (state_of(project, FILES) == before) is ("host_sync" in name)
    (project / name).unlink()
    assert (state_of(project, FILES) == before) is ("host_sync" in name)


def test_a_new_file_of_the_handheld_is_a_change(project: Path) -> None:
    before = state_of(project, FILES)
    (project / "device/new.py").write_text("", encoding="utf-8")
    assert state_of(project, [*FILES, "device/new.py"]) != before


def test_no_test_of_the_handheld_reaches_the_workstation() -> None:
    waiting = [path for folder in HANDHELD_TESTS for path in (ROOT / folder).rglob("*.py")]
    waiting.append(ROOT / "tests/conftest.py")
    seen: set[Path] = set()
    reached: list[str] = []
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        for name in imported(path):
            if name.startswith("host_sync"):
                reached.append(f"{path.relative_to(ROOT)}: {name}")
            places = (ROOT / f"{name.replace('.', '/')}.py", ROOT / f"tests/apparatus/{name}.py")
            waiting += [place for place in places if place.is_file() and place.is_relative_to(ROOT / "tests")]
    assert len(seen) > len(HANDHELD_TESTS)
    assert reached == []


def imported(path: Path) -> set[str]:
    """What a file imports anywhere, as modules or as names of modules."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names
