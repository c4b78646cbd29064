"""Commands that were renamed keep their old names for one release."""

from __future__ import annotations

import pytest

from host_sync.cli.main import app, main


@pytest.mark.parametrize(
    ("old", "new", "arguments", "code"),
    [("gage", "gage-rr", ["--table", "none.csv"], 2), ("figures", "paper-figures", ["--out", "pictures"], 2)],
)
def test_an_old_name_names_the_new_one_and_still_works(
    capsys: pytest.CaptureFixture[str], old: str, new: str, arguments: list[str], code: int
) -> None:
    assert main([new, *arguments]) == code
    said = capsys.readouterr().err
    assert main([old, *arguments]) == code
    assert capsys.readouterr().err == (
        f"retrosync: `{old}` is now `{new}`; the old name will be removed in the next release\n{said}"
    )
    assert not app[old].show
