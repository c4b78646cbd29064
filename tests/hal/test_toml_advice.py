"""Slips in TOML that people make are named by their line, with what to write there."""

from __future__ import annotations

import msgspec
import pytest

from hal.validation import decode_toml


class Table(msgspec.Struct):
    name: str = ""
    pitch: float = 0.0
    image: str = ""
    flag: bool = False


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("pitch = 20,0", "write a decimal point, 20.0"),
        ("pitch = 20,0  # µm", "write a decimal point, 20.0"),
        ("pitch = 1.234,5", "write a decimal point, and no sign between thousands"),
        ("balls = [{ x = 117,2, y = 100.0 }]", "write a decimal point, 117.2"),
        ("pitch = −2.0", "write a minus as -"),
        ("pitch = 2.0;", "end the line after the value"),
        ("pitch = 2.0, ", "end the line after the value"),
        ("pitch = 2.0 // mm", "begin remarks with #"),
        ("name = `bench`", "write straight quotes"),
        ('image = "presses\\p0.png"', "write / in paths instead of \\"),
        ("name = “bench”", "write straight quotes"),
        ("name = „bench“", "write straight quotes"),
        ("name = ‘bench’", "write straight quotes"),
        ("pitch = 20.0 um", "write numbers without a unit"),
        ("pitch = .5", "write digits on both sides of the point"),
        ("pitch = 5.", "write digits on both sides of the point"),
        ("flag = True", "write true or false"),
        ("name = bench", "put texts between quotes"),
        ("name = Übung", "put texts between quotes"),
        ('name: "bench"', "write = between a key and its value"),
        ('name = "bench', "close the quotes"),
        ("name =", "write a value after ="),
        ("// a remark", "begin remarks with #"),
        ("pitch\u00a0= 20.0", "remove a space of another kind"),
        ("name", "write = and a value after a key"),
        ("balls = [{ x = 72, y = 48,", "write all between { and } on one line"),
        ("pitch = １２", "write digits from 0 to 9"),
    ],
)
def test_the_line_and_its_mend_are_said(line: str, words: str) -> None:
    with pytest.raises(msgspec.DecodeError) as caught:
        decode_toml(f"# a set\n{line}\n".encode(), Table)
    message = str(caught.value)
    assert message.startswith(f"is not TOML: line 2, {line.strip()}: ")
    assert words in message
    assert "\n" not in message


def test_twice_is_said_to_be_twice() -> None:
    with pytest.raises(msgspec.DecodeError, match="line 3, pitch = 2: this key appears twice"):
        decode_toml(b'name = "a"\npitch = 1.0\npitch = 2\n', Table)
    with pytest.raises(
        msgspec.DecodeError, match=r"line 3, \[press\]: this table appears twice: leave one out, or .*press"
    ):
        decode_toml(b'[press]\nname = "a"\n[press]\nname = "b"\n', Table)


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-16-le"])
def test_text_in_utf_16_is_named(encoding: str, mark: str) -> None:
    with pytest.raises(msgspec.DecodeError, match="text in UTF-16: save it as UTF-8"):
        decode_toml((mark + 'name = "bench"\n').encode(encoding), Table)


def test_line_ends_that_are_none_are_named() -> None:
    assert decode_toml(b'name = "a"\r\npitch = 2.0\r\n', Table).pitch == 2.0
    with pytest.raises(msgspec.DecodeError, match="lines end as on an old Macintosh: save it"):
        decode_toml(b'name = "a"\rpitch = 2.0\r', Table)


def test_text_of_windows_is_named() -> None:
    with pytest.raises(msgspec.DecodeError, match="not text in UTF-8: save it as UTF-8"):
        decode_toml('name = "Prüfling"\n'.encode("cp1252"), Table)


def test_a_line_too_long_is_cut() -> None:
    with pytest.raises(msgspec.DecodeError) as caught:
        decode_toml(b"name = x" + b"y" * 500 + b"\n", Table)
    assert len(str(caught.value)) < 200
