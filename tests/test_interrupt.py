"""Ctrl-C at any moment of a command's start ends in one sentence, also in the middle of an import."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from device.shutdown import signals_as_keyboard_interrupt

PROGRAM = """
import signal, sys
wanted = sys.argv.pop(1)
signal.signal(signal.SIGINT, signal.default_int_handler)
def interrupt(event, details):
    global wanted
    if event == "import" and details[0] == wanted:
        wanted = None
        signal.raise_signal(signal.{signal})
from {package}.__main__ import main
sys.addaudithook(interrupt)
sys.exit(main(sys.argv[1:]))
"""
"""Sends itself a signal when it imports the module named first; whoever started it may have had Ctrl-C ignored."""


def stopped_at(module: str, package: str, *arguments: str, number: str = "SIGINT") -> tuple[int, str]:
    program = PROGRAM.format(package=package, signal=number)
    command = [sys.executable, "-c", program, module, *arguments]
    ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60.0)
    return ended.returncode, ended.stderr


@pytest.mark.parametrize(
    "module",
    ["device.cli.main", "device.errors", "hal.errors", "msgspec", "numpy", "cv2", "device.acquisition.selftest"],
)
def test_an_interrupted_import_ends_in_a_sentence(module: str, tmp_path: Path) -> None:
    run = ("--board", "twin", "--store", str(tmp_path), "run")
    assert stopped_at(module, "device", *run) == (130, "retroscan: stopped\n")


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("module", ["host_sync.cli.main", "device.errors", "cyclopts"])
def test_so_does_the_workstations(module: str, number: str) -> None:
    assert stopped_at(module, "host_sync", "status", number=number) == (130, "retrosync: stopped\n")


@pytest.mark.parametrize("module", ["msgspec", "numpy", "cv2", "host_sync.frames.frame_set"])
def test_a_command_that_is_interrupted_in_its_own_imports_says_so(module: str, tmp_path: Path) -> None:
    image = tmp_path / "image.png"
    image.write_bytes(b"")
    said = stopped_at(module, "host_sync", "reconstruct", str(image), "--out", str(tmp_path / "out"))
    assert said == (130, "retrosync: stopped: unfinished results are not kept\n")


class Dropping:
    """An object whose end runs Python code in which an exception cannot be raised."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


def drop_and_wait() -> None:
    dropping = Dropping()
    with signals_as_keyboard_interrupt(signal.SIGTERM):
        del dropping
        signal.pause()


def test_an_interrupt_that_python_drops_is_raised_again() -> None:
    with pytest.raises(KeyboardInterrupt):
        drop_and_wait()


def test_it_is_raised_until_it_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal between the last look at signals and the wait in the system leaves that wait as it is."""
    kill, sent = os.kill, []

    def lose_the_first(process: int, number: int) -> None:
        sent.append(number)
        if len(sent) > 1:
            kill(process, number)

    monkeypatch.setattr(os, "kill", lose_the_first)
    with pytest.raises(KeyboardInterrupt):
        drop_and_wait()
    assert len(sent) > 1
