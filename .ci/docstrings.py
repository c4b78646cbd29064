"""Docstrings of this project as Markdown, for the API reference: an extension of mkdocstrings.

Lines "name : meaning" become a list, examples become code, and the underlined "Raises" a bold word.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

MEANING = re.compile(r"^(?P<names>\w+(?:, \w+)*) : (?P<meaning>.*)$")
EXCEPTION = re.compile(r"^(?P<names>[A-Z]\w+(?:, [A-Z]\w+)*)$")


class Docstrings(griffe.Extension):
    """Rewrites each docstring once it is collected."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of a module, class, function or attribute."""
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)


def as_markdown(text: str) -> str:
    """The docstring in Markdown."""
    written: list[str] = []
    raises = in_code = False
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if in_code and not line.strip():
            written += ["```", ""]
            in_code = False
        elif not in_code and line.startswith(">>> "):
            written += ["", "```pycon", line]
            in_code = True
        elif in_code:
            written.append(line)
        elif line == "Raises":
            written += ["", "**Raises**", ""]
            raises = True
        elif line.startswith("---"):
            continue
        elif found := MEANING.match(line) or (EXCEPTION.match(line) if raises else None):
            first = not (number and MEANING.match(lines[number - 1]))
            said = found["meaning"] if "meaning" in found.groupdict() else ""
            names = ", ".join(f"`{name}`" for name in found["names"].split(", "))
            written += [*([""] if first else []), f"- {names}: {said}"]
        else:
            written.append(line)
    return "\n".join([*written, *(["```"] if in_code else [])])
