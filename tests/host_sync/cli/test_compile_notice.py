"""The word about compiling is said on a terminal, and only while the cache holds nothing."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from host_sync.cli.console import announce_compiling, report_compile_time
from host_sync.cli.main import run
from host_sync.kernels.cache import SETTING, SUFFIX
from host_sync.kernels.jit import CompileTime, njit


@pytest.mark.parametrize(
    ("terminal", "cached", "words"), [(True, False, 1), (True, True, 0), (False, False, 0), (False, True, 0)]
)
def test_it_is_said_once(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    terminal: bool,
    cached: bool,
    words: int,
) -> None:
    monkeypatch.setenv(SETTING, str(tmp_path))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    if cached:
        (tmp_path / f"host_sync.integration.datum._add_cells-1{SUFFIX}").touch()
    announce_compiling()
    announce_compiling()
    assert capsys.readouterr().err.count("compiles for this machine, about a minute") == words
    report_compile_time()
    assert capsys.readouterr().err.count("s of this run were compiling") == words


def test_how_long_it_took_is_said_at_the_end_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(SETTING, str(tmp_path))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)

    def command() -> int:
        announce_compiling()
        assert doubled(21) == 42
        return 0

    assert run(command) == 0
    first, last = capsys.readouterr().err.splitlines()
    assert "about a minute" in first
    assert last.startswith("retrosync: ")
    assert "s of this run were compiling" in last
    assert run(lambda: 0) == 0
    assert capsys.readouterr().err == ""


def test_the_time_of_compiling_is_counted_once_for_nested_kernels() -> None:
    clock, began_s = CompileTime(), time.monotonic()
    assert clock.total_s == 0.0
    assert redoubled(21) == 84
    taken_s = time.monotonic() - began_s
    assert 0.0 < clock.total_s <= taken_s
    before_s = clock.total_s
    assert redoubled(21) == 84
    assert clock.total_s == before_s


@njit(cache=False)
def doubled(number: int) -> int:
    return 2 * number


@njit(cache=False)
def twice(number: int) -> int:
    return 2 * number


@njit(cache=False)
def redoubled(number: int) -> int:
    return 2 * twice(number)
