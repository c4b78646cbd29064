"""The workstation's commands do without what Windows lacks: run here with it taken away."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from ball_folder import OPTIONS, PLACES, presses, put
from limits import running

from device.command_line import long_path
from device.io import atomic, folder, lock
from device.io.folder import Folder, IrregularFile
from device.io.lock import FolderLocked, locked_directory
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import load_frame_set

ROOT = Path(__file__).parents[2]
GOLDEN = ROOT / "tests" / "golden"


@pytest.fixture
def without_open_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system that opens no folders and follows every link."""
    monkeypatch.setattr(folder, "OPENS_FOLDERS", False)
    monkeypatch.setattr(atomic, "OPENS_FOLDERS", False)
    monkeypatch.setattr(folder, "NO_FOLLOW", 0)
    monkeypatch.setattr(folder, "_READ", os.O_RDONLY)


@pytest.mark.slow
def test_commands_run_with_posix_taken_away(tmp_path: Path) -> None:
    put(tmp_path / "presses" / "ref.png")
    presses(tmp_path / "presses", "sample_{}.png")
    result = str(tmp_path / "results" / "sample_1")
    shutil.copytree(GOLDEN, tmp_path / "card")  # a pull leaves receipts there
    commands = [
        ["import", str(tmp_path / "presses"), *OPTIONS, "--results", str(tmp_path / "results")],
        ["calibrate", str(tmp_path / "presses" / "frameset.toml"), "--out", str(tmp_path / "gel.calibration")],
        ["measure", result, "--json"],
        ["export", result, "--to", "gsf", "x3p", "--out", str(tmp_path / "exported")],
        ["report", result, "--out", str(tmp_path / "reports")],
        ["pull", str(tmp_path / "card"), "--library", str(tmp_path / "library")],
        ["verify", "--library", str(tmp_path / "library")],
        ["view", "--help"],
    ]
    script = ROOT / "tests" / "apparatus" / "without_posix.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    program = [sys.executable, "-W", "ignore:only soft file lock", str(script), json.dumps(commands)]
    ran = subprocess.run(program, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert f"{len(PLACES)} of {len(PLACES)} presses show a ball" in ran.stdout
    for name in (
        "results/sample_1/height_um.tif",
        "exported/sample_1.x3p",
        "reports/sample_1.pdf",
        "gel.calibration",
        "gel.calibration.png",
    ):
        assert (tmp_path / name).stat().st_size > 0, name
    assert "2 of 2 verified" in ran.stdout
    assert not list(tmp_path.rglob("*.lock"))


@pytest.mark.parametrize("name", ["con", "NUL", "aux.tif", "COM3", "lpt9.old"])
def test_no_result_is_called_as_a_device_of_windows(name: str, tmp_path: Path) -> None:
    put(tmp_path / "one.png")
    text = f'name = "x"\npixel_pitch_um = 1\nencoding = "linear"\n[[scan]]\nname = "{name}"\nimage = "one.png"\n'
    (tmp_path / "set.toml").write_text(text)
    with pytest.raises(FrameSetError, match="cannot name a result folder"):
        load_frame_set(tmp_path / "set.toml", calibrates=False)


def test_long_paths_of_windows_are_named_as_such() -> None:
    deep = "\\".join(["folder"] * 30)
    assert long_path(rf"D:\scans\{deep}") == rf"\\?\D:\scans\{deep}"
    assert long_path(f"D:/scans/{deep.replace(chr(92), '/')}") == rf"\\?\D:\scans\{deep}"
    assert long_path(rf"\\nas\share\{deep}") == rf"\\?\UNC\nas\share\{deep}"
    assert long_path(rf"\\?\D:\{deep}") == rf"\\?\D:\{deep}"
    assert long_path(r"D:\scans") == r"D:\scans"


@pytest.mark.skipif(os.name == "nt", reason="links want an administrator on Windows")
def test_a_folder_by_its_path_follows_no_link(tmp_path: Path, without_open_folders: None) -> None:
    (tmp_path / "card" / "scans").mkdir(parents=True)
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "key").write_bytes(b"secret")
    (tmp_path / "card" / "way").symlink_to(tmp_path / "secret")
    (tmp_path / "card" / "file").symlink_to(tmp_path / "secret" / "key")
    with Folder(tmp_path / "card") as card:
        card.write("scans/one", b"first")
        card.write("scans/one", b"second")
        card.make_folder("scans/deeper")
        card.make_folder("scans/deeper")
        card.rename("scans/one", "scans/deeper/two")
        assert card.read("scans/deeper/two", 10) == b"second"
        assert [(one.name, one.kind) for one in card.entries()] == [
            ("file", "other"),
            ("scans", "folder"),
            ("way", "other"),
        ]
        with pytest.raises(IrregularFile):
            card.read("file", 10)
        for place in ("way/key", "way/new"):
            with pytest.raises(OSError, match="symbolic links"):
                card.write(place, b"no")
        for place in ("../secret/key", "scans/..\\\\secret", "C:key", "scans/one:stream"):
            with pytest.raises(OSError, match="no name"):
                card.read(place, 10)
        card.remove_file("file")
        card.remove_file("absent")
    assert (tmp_path / "secret" / "key").read_bytes() == b"secret"
    assert sorted(path.name for path in (tmp_path / "secret").iterdir()) == ["key"]
    with pytest.raises(OSError, match="symbolic links"):
        Folder(tmp_path / "card" / "way", follow=False)
    with pytest.raises(NotADirectoryError):
        Folder(tmp_path / "secret" / "key")


def test_files_appear_whole_without_open_folders(tmp_path: Path, without_open_folders: None) -> None:
    atomic.replace_file(tmp_path / "a", b"one")
    atomic.replace_file(tmp_path / "a", b"two", 0o600)
    assert (tmp_path / "a").read_bytes() == b"two"
    with atomic.atomic_directory(tmp_path / "results", "marker") as partial:
        (partial / "marker").write_bytes(b"")
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["marker"]


def test_a_locked_file_stands_in_for_a_folders_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "fcntl", None)
    for place in (tmp_path / "kept", tmp_path / ".hidden.partial"):
        place.mkdir()
        with locked_directory(place):
            with pytest.raises(FolderLocked, match="another program"), locked_directory(place, wait=False):
                pass
            assert (place / "x").parent.is_dir()
        with locked_directory(place, wait=False):
            pass
        assert list(place.iterdir()) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == [".hidden.partial", "kept"]
    with pytest.raises(FileNotFoundError), locked_directory(tmp_path / "absent"):
        pass
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OSError, match=os.strerror(errno.ENOTDIR)), locked_directory(tmp_path / "file"):
        pass


def test_the_lock_ends_with_its_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "fcntl", None)
    words = (
        "import sys, os, device.io.lock as l; from pathlib import Path; l.fcntl = None\n"
        "with l.locked_directory(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read(1); os._exit(0)"
    )
    program = [sys.executable, "-c", words, str(tmp_path)]
    with running(program, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(FolderLocked), locked_directory(tmp_path, wait=False):
            pass
        other.communicate("x")
    with locked_directory(tmp_path, wait=False):
        pass
