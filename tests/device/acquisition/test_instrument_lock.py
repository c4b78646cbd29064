"""One owner of camera and lights: a second program is refused by name, and a dead owner is none."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from limits import running

from device.acquisition.instrument_lock import exclusive_instrument, instrument_lock, lock_path
from device.errors import InstrumentBusy
from hal.board_profile import load_board_profile

HOLD = """
import sys
from pathlib import Path
from device.acquisition.instrument_lock import instrument_lock
with instrument_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_one_is_refused_and_learns_who_has_it(tmp_path: Path) -> None:
    lock = tmp_path / "instrument.lock"
    command = [sys.executable, "-c", HOLD, str(lock)]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "held\n"
        with pytest.raises(InstrumentBusy, match=f"in use by process {owner.pid}"), instrument_lock(lock):
            pass
        owner.kill()
    with instrument_lock(lock):
        assert lock.read_text() == f"{os.getpid()}\n"
    with instrument_lock(lock):
        pass


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InstrumentBusy, match="run this as its own user"), instrument_lock(tmp_path / "no" / "lock"):
        pass


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InstrumentBusy, match="cannot be locked"), instrument_lock(tmp_path / "lock"):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_where_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    service, own = tmp_path / "service", tmp_path / "own"
    own.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(own))
    assert lock_path(service) == own / f"retroscan-{os.getuid()}.lock"
    service.mkdir()
    assert lock_path(service) == service / "instrument.lock"


def test_a_session_without_a_runtime_folder_is_locked_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    path = lock_path(tmp_path / "none")
    assert path.name == f"retroscan-{os.getuid()}.lock"
    assert path.parent.is_dir()


def test_simulated_boards_need_none() -> None:
    """A lock would refuse the second of the two with InstrumentBusy."""
    twin = load_board_profile("twin")
    with exclusive_instrument(twin), exclusive_instrument(twin):
        pass
