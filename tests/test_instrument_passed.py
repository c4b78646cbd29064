"""The handheld's tests are left out only when nothing that they reach has changed since they passed."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.instrument_passed import HANDHELD_TESTS, ROOT, UNKNOWN, current_state, keep, options, state_of

ON_PATH = ("tests/apparatus", ".ci/image", ".ci/step")
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
    keep(stamp, state, "edited during the run")
    assert options(stamp, state) == []
    keep(stamp, state, state)
    assert options(stamp, state) == [f"--ignore={folder}" for folder in HANDHELD_TESTS]
    assert options(stamp, "another state") == []


def test_what_is_unknown_is_never_left_out(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stamp = project / "stamp"
    keep(stamp, UNKNOWN, UNKNOWN)
    assert not stamp.exists()
    stamp.write_text(UNKNOWN, encoding="utf-8")
    assert options(stamp, UNKNOWN) == []
    monkeypatch.setenv("PYTEST_ADDOPTS", "-k few")
    assert current_state() == UNKNOWN


@pytest.mark.parametrize("name", FILES)
def test_only_a_change_of_the_workstation_keeps_the_state(project: Path, name: str) -> None:
    before = state_of(project, FILES)
    (project / name).write_text("2\n", encoding="utf-8")
    assert (state_of(project, FILES) == before) is ("host_sync" in name)
    (project / name).unlink()
    assert (state_of(project, FILES) == before) is ("host_sync" in name)


def test_a_file_that_may_not_be_run_any_more_is_a_change(project: Path) -> None:
    before = state_of(project, FILES)
    (project / "device/errors.py").chmod(0o755)
    assert state_of(project, FILES) != before


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
            if name.startswith(("host_sync", "tests.host_sync")):
                reached.append(f"{path.relative_to(ROOT)}: {name}")
            own = [f"{name.replace('.', '/')}.py", *(f"{folder}/{name}.py" for folder in ON_PATH)]
            tests = [ROOT / place for place in own if place.startswith(("tests/", ".ci/"))]
            waiting += [place for place in tests if place.is_file()]
    assert len(seen) > len(HANDHELD_TESTS)
    assert reached == []


def imported(path: Path) -> set[str]:
    """What a file imports anywhere, as modules or as names of modules."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module, f"{path}: an import by dots is not followed"
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names
