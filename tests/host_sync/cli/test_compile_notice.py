"""The word about compiling is said on a terminal, and only while the cache holds nothing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from host_sync.cli.console import tell_of_compiling
from host_sync.kernels.cache import SETTING


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
        (tmp_path / "integration").mkdir()
        (tmp_path / "integration" / "datum._add_cells-1.py311.nbi").touch()
    tell_of_compiling()
    assert capsys.readouterr().err.count("compiles") == words
