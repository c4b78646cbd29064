"""Words by a check: how docstrings begin, and the words that the glossary avoids."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("hal", "device", "host_sync")

UNDER_REPLACEMENT = frozenset(
    {
        "device/balls", "device/calibration", "device/inverse_map", "host_sync/calibration", "host_sync/denoising",
        "host_sync/frame_checks", "host_sync/gradients", "host_sync/integration", "host_sync/lights",
        "host_sync/reconstruction", "host_sync/uncertainty",
    }
)  # fmt: skip
"""Packages that the new light model replaces: exempt until it does. Remove each with its old code; add none."""

NO_STATEMENT = re.compile(r"(What|Whether|The same|Where|Which|How)\b")


def package_of(path: Path) -> str:
    return "/".join(path.relative_to(ROOT).parts[:2])


def modules() -> list[Path]:
    return [
        path
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        if package_of(path) not in UNDER_REPLACEMENT
    ]


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of the docstrings of a module, its classes and functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield node.body[0].lineno, text


def test_exempt_packages_exist() -> None:
    assert [name for name in UNDER_REPLACEMENT if not (ROOT / name).is_dir()] == []


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
