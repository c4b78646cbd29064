"""Results appear whole, and what a killed run left is cleared by the next one."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from device.errors import OutputError
from device.io.atomic import atomic_directory, publish_directory, write_output
from device.io.folder import Folder
from device.io.lock import locked_directory


def test_what_a_killed_run_left_is_cleared_and_a_running_one_is_left_alone(tmp_path: Path) -> None:
    results = tmp_path / "results"
    for name in (".old-c0ffee.partial", ".running-c0ffee.partial"):
        (results / name).mkdir(parents=True)
        (results / name / "heights").touch()
    with (
        locked_directory(results / ".running-c0ffee.partial"),
        atomic_directory(results / "new-c0ffee", "result.json") as folder,
    ):
        (folder / "result.json").touch()
    assert sorted(path.name for path in results.iterdir()) == [".running-c0ffee.partial", "new-c0ffee"]


def test_hidden_folders_elsewhere_are_nobodys_business(tmp_path: Path) -> None:
    (tmp_path / ".download.partial").mkdir()
    with atomic_directory(tmp_path / "out", "result.json") as folder:
        (folder / "result.json").touch()
    assert (tmp_path / ".download.partial").is_dir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").touch()
    with (
        pytest.raises(OutputError, match="holds other files than results"),
        atomic_directory(tmp_path / "mine", "result.json"),
    ):
        pass


def test_what_another_program_is_writing_is_not_touched(tmp_path: Path) -> None:
    out = tmp_path / "scan" / "out"
    with atomic_directory(out, "result.json") as folder:
        (folder / "result.json").write_text("first")
        with (
            pytest.raises(OutputError, match="another program is writing it; repeat when that has ended"),
            atomic_directory(out, "result.json"),
        ):
            pass
        assert (folder / "result.json").read_text() == "first"
    assert (out / "result.json").read_text() == "first"
    with atomic_directory(out, "result.json") as folder:
        (folder / "result.json").write_text("second")
    assert (out / "result.json").read_text() == "second"
    with pytest.raises(OutputError, match="No space left"), atomic_directory(out, "result.json") as folder:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert (out / "result.json").read_text() == "second"
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOSYS, errno.ENOTSUP])
def test_a_share_without_fsync_takes_files_and_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", refuse)
    write_output(tmp_path / "one.json", b"{}")
    with atomic_directory(tmp_path / "out", "result.json") as folder:
        (folder / "result.json").touch()
    (tmp_path / ".scan").mkdir()
    (tmp_path / ".scan" / "file").touch()
    publish_directory(tmp_path / ".scan", tmp_path / "scan")
    with Folder(tmp_path) as open_folder:
        open_folder.write("two", b"2")
        open_folder.rename("two", "three")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.json", "out", "scan", "three"]


def test_a_disk_that_fails_is_no_share_without_fsync(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OutputError, match="Input/output error"):
        write_output(tmp_path / "one.json", b"{}")
    assert list(tmp_path.iterdir()) == []
