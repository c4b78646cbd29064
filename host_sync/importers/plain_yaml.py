"""The part of YAML that GelSight's `scan.yaml` uses: keys with values, lists of values, lists of such tables.

Deeper tables are skipped. Values stay text; who asks for a number reads one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from host_sync.errors import FrameSetError

Table = dict[str, str]
MAX_BYTES: Final = 4 << 20


def read_plain_yaml(path: Path) -> dict[str, str | list[str] | list[Table]]:
    """Keys of the file at its outermost level.

    Raises
    ------
    FrameSetError
        The file cannot be read, is too large or no text.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise FrameSetError(f"{path}: cannot be read ({error.strerror}): name another folder") from error
    if len(data) > MAX_BYTES:
        raise FrameSetError(f"{path}: is larger than any scan's description: name another folder")
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FrameSetError(f"{path}: is no text: name another folder") from error
    found: dict[str, str | list[str] | list[Table]] = {}
    key, tables, values = "", list[Table](), list[str]()
    for line in lines:
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        if line[0] not in " -\t":
            key, _, value = text.partition(":")
            tables, values = [], []
            found[key] = value.strip().strip("\"'")
        elif text.startswith("- ") and ":" in text:
            tables.append(_pair(text[2:]))
            found[key] = tables
        elif text.startswith("- "):
            values.append(text[2:].strip().strip("\"'"))
            found[key] = values
        elif tables and ":" in text:
            tables[-1].update(_pair(text))
    return found


def _pair(text: str) -> Table:
    name, _, value = text.partition(":")
    return {name.strip(): value.strip().strip("\"'")}
