"""The word about compiling is said on a terminal, and only while the cache holds nothing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from host_sync import compile_notice
from host_sync.reconstruction import rest_level


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
    monkeypatch.setattr(rest_level, "cache_directory", lambda: tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    if cached:
        (tmp_path / "rest_level._add_cells-1.py311.nbi").touch()
    compile_notice.tell_of_compiling()
    assert capsys.readouterr().err.count("compiles") == words


def test_a_kernel_that_has_run_is_in_the_cache() -> None:
    rest_level._cell_sums(*(rest_level.np.ones((8, 8), dtype) for dtype in ("float32", "float32", "bool")), 2)
    assert compile_notice.compiled_before()
