"""Progress in a log or pipe: lines on standard error, of what has changed."""

from __future__ import annotations

import subprocess
import sys

import pytest

from host_sync.cli import console


def test_a_pipe_gets_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(console, "LINES_EVERY_S", 1e-3)
    written = ""
    with console.progress("bytes") as show:
        for step, done in (("card: rg-1", 25.0), ("card: rg-1", 50.0), ("\x1b[2Jcard", None)):
            show(step, done, done and 100.0, "card")
            while not written.endswith("\n") or len(written.splitlines()) < (done or 75.0) / 25.0:
                written += capsys.readouterr().err
    assert written.splitlines() == [
        "retrosync: card: rg-1, 25%",
        "retrosync: card: rg-1, 50%",
        "retrosync: \\x1b[2Jcard",
    ]


def test_a_line_leaves_the_program_at_once() -> None:
    program = (
        "import sys; from device.command_line import write_any_sign; write_any_sign(); print('first'); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdin=-1, stdout=-1, text=True) as running:
        assert running.stdout is not None
        assert running.stdin is not None
        assert running.stdout.readline() == "first\n"
        running.stdin.close()
