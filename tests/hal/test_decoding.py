"""TOML and JSON decoded: what is not such text is named as that, without the words of a codec."""

import msgspec
import pytest

from hal.validation import decode_json, decode_toml

NOT_TEXT = {
    "a picture": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "it is not text in UTF-8: save it as UTF-8"),
    "UTF-16": ('name = "x"'.encode("utf-16"), "it is text in UTF-16: save it as UTF-8"),
    "Latin-1": (b'{"name": "\xb5"}', "it is not text in UTF-8: save it as UTF-8"),
    "zeros": (bytes(100), "it is not text"),
    "too deep": (b"a = " + b"[" * 5000, "its tables are nested too deeply"),
}


@pytest.mark.parametrize("name", NOT_TEXT)
def test_what_is_not_text_is_not_toml(name: str) -> None:
    data, reason = NOT_TEXT[name]
    with pytest.raises(msgspec.DecodeError) as raised:
        decode_toml(data, dict)
    assert str(raised.value) == f"is not TOML: {reason}"


@pytest.mark.parametrize("name", ["a picture", "UTF-16", "Latin-1", "zeros"])
def test_what_is_not_text_is_not_json(name: str) -> None:
    data, reason = NOT_TEXT[name]
    with pytest.raises(msgspec.DecodeError) as raised:
        decode_json(data, dict)
    assert str(raised.value) == f"is not JSON: {reason}"


def test_text_that_is_not_the_form_says_where() -> None:
    with pytest.raises(msgspec.DecodeError, match=r"^is not TOML: .*line 2"):
        decode_toml(b"a = 1\nb ==", dict)
    with pytest.raises(msgspec.DecodeError, match=r"^is not JSON: .*byte"):
        decode_json(b'{"a" 1}', dict)
    with pytest.raises(msgspec.DecodeError, match=r"^is not JSON: its tables are nested too deeply"):
        decode_json(b"[" * 100_000, list)


def test_the_mark_of_windows_editors_is_skipped_where_people_write() -> None:
    assert decode_toml(b"\xef\xbb\xbfa = 1", dict[str, int]) == {"a": 1}
    with pytest.raises(msgspec.DecodeError, match="is not JSON"):
        decode_json(b'\xef\xbb\xbf{"a": 1}', dict[str, int])  # programs write none, and its bytes are hashed


def test_a_wrong_key_stays_a_validation_error() -> None:
    with pytest.raises(msgspec.ValidationError):
        decode_toml(b'a = "x"', dict[str, int])
