"""`retroscan` from its command line: what it says, and with which code it ends."""

from pathlib import Path

import pytest

from device.__main__ import main


def refusal(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int) -> str:
    assert main(arguments) == code
    error = capsys.readouterr().err
    assert error.startswith("retroscan: ")
    assert error.count("\n") == 1
    return error


def test_scanning_before_calibrating_says_what_to_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = str(tmp_path / "store")
    for command in ("scan", "watch"):
        assert "retroscan calibrate" in refusal(capsys, ["--board", "twin", "--store", store, command], 2)
        assert list(tmp_path.iterdir()) == []


def test_an_empty_name_is_no_store(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--board", "twin", "--store", "", "calibrate"])
    assert ended.value.code == 2
    assert "an empty name is no folder" in capsys.readouterr().err


def test_an_unknown_board_lists_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    error = refusal(capsys, ["--board", "moon", "lights-off"], 2)
    assert "twin" in error
    assert "twin-distant" in error


def test_the_twin_is_never_taken_unasked(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["scan"])
    assert ended.value.code == 2
    assert "--board" in capsys.readouterr().err


@pytest.mark.parametrize("radius", ["0", "-3", "nan", "ball"])
def test_a_ball_needs_a_radius(radius: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--board", "twin", "calibrate", "--ball-radius-mm", radius])
    assert ended.value.code == 2
    assert "is not a length above 0 mm" in capsys.readouterr().err


def test_a_store_that_cannot_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    store = str(tmp_path / "file" / "store")
    assert store in refusal(capsys, ["--board", "twin", "--store", store, "calibrate"], 2)


def test_lights_off_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--board", "twin", "lights-off"]) == 0
    assert capsys.readouterr().out == ""
