"""Commands of users without a home or a language set: service users, containers, old terminals."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from host_sync.calibration_file.inputs import CalibrationCache
from host_sync.cli.main import main, run
from host_sync.errors import LibraryError
from host_sync.kernels.cache import SETTING, USER_CACHE, cache_home, configure_cache
from host_sync.library.library import default_library
from host_sync.viewer.cache import default_cache

ROOT = Path(__file__).parents[3]
SENTENCE = "the pitch is 20 ± 0.1 µm at 5°"


def test_a_named_cache_holds_all_that_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = {USER_CACHE: str(tmp_path)}
    configure_cache(environment)
    assert environment[SETTING] == str(tmp_path / "kernels")
    monkeypatch.setenv(USER_CACHE, str(tmp_path))
    assert default_cache() == tmp_path / "viewer"
    assert CalibrationCache.of_user({USER_CACHE: ""}).find("key") is None


def test_without_a_home_nothing_lands_in_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", USER_CACHE):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as for a user without a home
    assert cache_home({}) is None
    assert default_cache().is_dir()
    with pytest.raises(LibraryError, match="name the library with --library"):
        default_library()
    assert main(["pair", "bench.local"]) == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_every_sentence_is_printed_in_every_encoding(encoding: str) -> None:
    code = (
        "from device.command_line import print_json, write_any_sign\n"
        "from host_sync.cli.console import print_error, print_line\n"
        f"write_any_sign(); print_line({SENTENCE!r}); print_error({SENTENCE!r}, 2); print_json({{'µ': {SENTENCE!r}}})\n"
    )
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True)
    line, document = run.stdout.decode(encoding).splitlines()
    plain = "the pitch is 20 +/- 0.1 um at 5 deg"
    assert line == (plain if encoding == "ascii" else SENTENCE)
    assert run.stderr.decode(encoding) == f"retrosync: {line}\n"
    assert json.loads(document) == {"µ": SENTENCE}


def test_a_folder_that_the_system_keeps_closed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    closed, usual = tmp_path / "closed", Path.stat

    def stat(path: Path, *, follow_symlinks: bool = True) -> os.stat_result:
        if path.is_relative_to(closed):
            raise PermissionError(13, "Permission denied", str(path))
        return usual(path, follow_symlinks=follow_symlinks)

    monkeypatch.setattr(Path, "stat", stat)
    for command in (["measure"], ["view", "--no-browser"], ["calibrate", "--out", str(tmp_path / "gel.calibration")]):
        assert main([command[0], str(closed), *command[1:]]) == 2
        said = capsys.readouterr()
        assert said.err.startswith(f"retrosync: {closed}")
        assert "cannot be used (Permission denied): let this user read" in said.err


def test_an_output_without_a_name_is_that_of_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full() -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("device.command_line.discard_output", lambda: None)
    assert run(full) == 1
    assert "the output cannot be written (No space left on device)" in capsys.readouterr().err


def test_a_folder_without_a_frame_set_is_no_damaged_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", str(tmp_path), "--out", str(tmp_path / "gel.calibration")]) == 2
    said = capsys.readouterr().err
    assert said.endswith("holds no frameset.toml and no calibration.json: `retrosync import` describes its images\n")
    (tmp_path / "frameset.toml").write_text('name = "bench"')
    assert main(["calibrate", str(tmp_path), "--out", str(tmp_path / "gel.calibration")]) == 2
    assert f"{tmp_path / 'frameset.toml'}: pixel_pitch_um is missing" in capsys.readouterr().err
