"""Words by a check: how docstrings begin, and the words that the glossary avoids."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from each_case import each_case

ROOT = Path(__file__).parent.parent
PACKAGES = ("hal", "device", "host_sync")

GLOSSARY = ROOT / "docs" / "glossary.md"
AVOIDED = re.compile(r"\*\*([^*]+)\*\*")
LETTERS = re.compile(r"[^\W\d_]+")

NO_STATEMENT = re.compile(r"(What|Whether|The same|Where|Which|How)\b")


def modules() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of the docstrings of a module, its classes and functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield node.body[0].lineno, text


def test_docstrings_begin_with_a_statement() -> None:
    """ "Return the ...", "Height above the zero, µm."; not "What ...", "Whether ..."."""
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in modules()
        for line, text in docstrings(ast.parse(path.read_text(encoding="utf-8")))
        if NO_STATEMENT.match(text)
    ]
    assert found == []


def test_a_docstring_without_a_statement_is_found() -> None:
    tree = ast.parse('def f():\n    """Whether it is."""\n')
    assert [NO_STATEMENT.match(text) is not None for _, text in docstrings(tree)] == [True]


def avoided() -> list[tuple[str, ...]]:
    """Return the words in bold of the glossary's avoid column, each as the words it consists of."""
    found = []
    for line in GLOSSARY.read_text(encoding="utf-8").splitlines():
        if line.startswith("| "):
            column = line.strip("|").split("|")[-1]
            found += [tuple(words_of(words)) for words in AVOIDED.findall(column)]
    return found


def words_of(text: str) -> list[str]:
    """Return the words of a text or an identifier: `FittedLamps` and `fitted_lamps` are both fitted, lamps."""
    return LETTERS.findall(re.sub(r"([a-z])([A-Z])", r"\1 \2", text.replace("_", " ")).lower().strip())


def uses(text: str, avoid: list[tuple[str, ...]]) -> list[str]:
    """Return the avoided words that a text uses, also in the plural."""
    words = words_of(text)
    heads: dict[str, list[tuple[str, ...]]] = {}
    for one in avoid:
        heads.setdefault(one[0], []).append(one)
        if len(one) == 1:
            heads.setdefault(f"{one[0]}s", []).append((f"{one[0]}s",))
    return [
        " ".join(one)
        for at, word in enumerate(words)
        for one in heads.get(word, ())
        if tuple(words[at : at + len(one)]) == one
    ]


def identifiers(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of what a module defines, takes and uses."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute):
            yield node.lineno, node.attr


def strings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of docstrings, messages and other texts of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


RECORD_KEYS = frozenset({"islands"})
ARRAY_KEYS = frozenset({"taught"})
"""Members of records, and keys of arrays, on disk keep the words of their schema version."""

MEMBER = re.compile(rf"^ *({'|'.join(sorted(RECORD_KEYS))}) :", re.MULTILINE)
"""Such a key where a docstring lists it."""

OLD_COMMANDS = frozenset({"shelf"})
"""Old words that the programs still accept."""

KEPT = RECORD_KEYS | ARRAY_KEYS | OLD_COMMANDS


def test_the_glossary_is_read() -> None:
    assert {("lamp",), ("taught",), ("in", "force"), ("nought",)} <= set(avoided())


def test_an_avoided_word_is_found() -> None:
    assert uses("FittedLamps lamp_mm, clamp", avoided()) == ["lamps", "lamp"]
    assert uses("it is in force", avoided()) == ["in force"]


def test_identifiers_and_texts_use_no_avoided_word() -> None:
    avoid, found = avoided(), []
    for path in modules():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = [one for one in identifiers(tree) if one[1] not in RECORD_KEYS]
        texts = [(line, MEMBER.sub("", text)) for line, text in strings(tree) if text not in KEPT]
        found += [
            f"{path.relative_to(ROOT)}:{line}: {word}" for line, text in [*names, *texts] for word in uses(text, avoid)
        ]
    assert found == []


PAGES = sorted(
    [ROOT / name for name in ("README.md", "CONTRIBUTING.md")]
    + [path for folder in ("docs", "board") for path in (ROOT / folder).rglob("*.md") if path != GLOSSARY]
)


@each_case(PAGES, name=lambda path: str(path.relative_to(ROOT)))
def test_documents_use_no_avoided_word(path: Path) -> None:
    text = re.sub(r"`[^`\n]*`|\]\([^)]*\)", "", path.read_text(encoding="utf-8"))
    assert uses(text, avoided()) == []
