"""The folder of a job: on the library's disk, gone with the job, removed later when the job was killed."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from limits import running

from host_sync.batch import library_batch as module
from host_sync.batch.library_batch import work_folder

JOB = """
import sys
from pathlib import Path
from host_sync.batch.library_batch import work_folder

with work_folder(Path(sys.argv[1])) as folder:
    (folder / "a.calibration").write_bytes(b"0" * 100)
    print(folder, flush=True)
    sys.stdin.read()
"""


@contextmanager
def job(place: Path) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """The folder of another program's job that runs, and the program; it ends when its input does."""
    command = [sys.executable, "-c", JOB, str(place)]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield Path(process.stdout.readline().strip()), process


def test_a_folder_lies_in_its_place_and_goes_with_the_job(tmp_path: Path) -> None:
    with work_folder(tmp_path) as folder:
        assert folder.parent == tmp_path
        assert folder.name.startswith(".retrosync-")
        (folder / "some").write_text("files", encoding="utf-8")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(RuntimeError), work_folder(tmp_path):
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_job_left_is_removed_at_the_next_start(tmp_path: Path) -> None:
    with job(tmp_path) as (left, process):
        process.kill()
    assert (left / "a.calibration").is_file()
    with work_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]


def test_the_folder_of_a_job_that_runs_stays(tmp_path: Path) -> None:
    with job(tmp_path) as (alive, process):
        with work_folder(tmp_path) as folder:
            assert set(tmp_path.iterdir()) == {alive, folder}
        assert (alive / "a.calibration").is_file()
        process.communicate("")
        assert process.returncode == 0
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_another_computer_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with job(tmp_path) as (left, process):
        process.kill()
    monkeypatch.setattr(socket, "gethostname", lambda: "another")
    with work_folder(tmp_path) as folder:
        assert set(tmp_path.iterdir()) == {left, folder}  # its lock may not be seen from here


def test_a_folder_that_another_start_took_for_abandoned_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []

    def stolen_once(**given: object) -> str:
        folder = tmp_path / f".retrosync-{len(made)}"
        folder.mkdir()
        made.append(given)
        if len(made) == 1:
            folder.rmdir()
        return str(folder)

    monkeypatch.setattr(module, "mkdtemp", stolen_once)
    with work_folder(tmp_path) as folder:
        assert folder.name == ".retrosync-1"
    assert len(made) == 2


def test_a_place_that_is_missing_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), work_folder(tmp_path / "absent"):
        pass
