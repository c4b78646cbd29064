"""Progress in a log or pipe: lines on standard error, of what has changed."""

from __future__ import annotations

import io
import sys
from queue import SimpleQueue

import pytest
from limits import running

from host_sync.cli import console


class Pipe(io.StringIO):
    """A standard error of which a test takes one writing after the other: `capsys` may lose one of another thread."""

    def __init__(self) -> None:
        super().__init__()
        self.written = SimpleQueue[str]()

    def write(self, text: str) -> int:
        self.written.put(text)
        return len(text)


def test_a_pipe_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe()
    monkeypatch.setattr(console, "LINES_EVERY_S", 1e-3)
    monkeypatch.setattr(sys, "stderr", pipe)
    with console.progress("bytes") as show:
        for step, done, line in (
            ("card: rg-1", 25.0, "card: rg-1, 25%"),
            ("card: rg-1", 50.0, "card: rg-1, 50%"),
            ("\x1b[2Jcard", None, "\\x1b[2Jcard"),
        ):
            show(step, done, done and 100.0, "card")
            assert pipe.written.get(timeout=60.0) == f"retrosync: {line}\n"
    assert pipe.written.empty()


def test_a_line_leaves_the_program_at_once() -> None:
    program = (
        "import sys; from device.command_line import write_any_sign; write_any_sign(); print('first'); sys.stdin.read()"
    )
    with running([sys.executable, "-c", program], stdin=-1, stdout=-1, text=True) as ran:
        assert ran.stdout is not None
        assert ran.stdin is not None
        assert ran.stdout.readline() == "first\n"
        ran.stdin.close()
