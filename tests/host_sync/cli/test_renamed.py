"""Commands of the previous release: most still work and name the new words, one names the new form."""

from __future__ import annotations

from pathlib import Path

import pytest

from host_sync.cli.main import OLD_COMMANDS, app, main

ABSENT = ["--library", "absent"]
"""Every command of a library refuses it before it does anything."""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (["search", "valve", "--tag", "worn"], ["list", "valve", "--tag", "worn"]),
        (["label", "valve", "--tag", "worn"], ["list", "valve", "--add-tag", "worn"]),
        (["label", "valve", "--untag", "worn"], ["list", "valve", "--remove-tag", "worn"]),
        (["label", "valve", "--name", "v", "--note", "n"], ["list", "valve", "--set-name", "v", "--set-note", "n"]),
        (["alike", "valve", "-n", "3"], ["list", "--like", "valve", "-n", "3"]),
        (["repair", "/absent/card"], ["verify", "--repair", "/absent/card"]),
        (["forget", "rg-1"], ["verify", "--forget", "rg-1"]),
        (["reprocess", "rg-1"], ["verify", "--reproduce", "rg-1"]),
        (["same-spot", "a", "b"], ["compare", "a", "b"]),
        (["sync", "absent"], ["pull", "absent"]),
        (["watch", "--once"], ["reconstruct", "--watch", "--once"]),
    ],
    ids=lambda words: " ".join(words),
)
def test_an_old_command_names_the_new_one_and_still_works(
    old: list[str], new: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    code = main([*new, *ABSENT])
    said = capsys.readouterr().err
    assert code == 2
    assert main([*old, *ABSENT]) == code
    notice, _, rest = capsys.readouterr().err.partition("\n")
    words = " ".join(OLD_COMMANDS[old[0]].words)
    assert notice == f"retrosync: `{old[0]}` is now `{words}`; the old name will be removed in the next release"
    assert rest == said


@pytest.mark.parametrize(("old", "arguments"), [("gage", ["--table", "none.csv"]), ("figures", ["--out", "pictures"])])
def test_an_old_name_of_a_command_works(old: str, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([old, *arguments]) == 2
    assert f"`{old}` is now `{OLD_COMMANDS[old].words[0]}`" in capsys.readouterr().err


def test_discovery_is_part_of_the_status(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["discover", "--seconds", "x"]) == 2
    assert "`discover` is now `status --network`" in capsys.readouterr().err


def test_a_mirror_is_named_in_its_new_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["mirror", str(tmp_path), str(tmp_path / "copy")]) == 2
    assert capsys.readouterr().err == ("retrosync: `mirror` is now `verify --library LIBRARY --mirror DESTINATION`\n")
    assert not (tmp_path / "copy").exists()


def test_old_names_are_not_listed() -> None:
    assert OLD_COMMANDS.keys().isdisjoint(app)
