"""Ctrl-C at any moment of a command's start ends in one sentence, also in the middle of an import."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from device.shutdown import signals_as_keyboard_interrupt

PROGRAM = """
import signal, sys
wanted = sys.argv.pop(1)
def interrupt(event, details):
    global wanted
    if event == "import" and details[0] == wanted:
        wanted = None
        signal.raise_signal(signal.SIGINT)
from device.cli.start import main
sys.addaudithook(interrupt)
sys.exit(main(sys.argv[1:]))
"""
"""Sends itself Ctrl-C when it imports the module named first."""


@pytest.mark.parametrize(
    "module",
    ["device.cli.main", "device.errors", "hal.errors", "msgspec", "numpy", "cv2", "device.acquisition.selftest"],
)
def test_an_interrupted_import_ends_in_a_sentence(module: str, tmp_path: Path) -> None:
    arguments = [sys.executable, "-c", PROGRAM, module, "--board", "twin", "--store", str(tmp_path), "run"]
    ended = subprocess.run(arguments, check=False, capture_output=True, text=True, timeout=60.0)
    assert (ended.returncode, ended.stderr) == (130, "retroscan: stopped\n")


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
