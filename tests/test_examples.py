"""The worked examples of docs/extending.md, and the function names of docs/architecture.md."""

from __future__ import annotations

import importlib
import re
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each_case import each_case

DOCS = Path(__file__).parent.parent / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
DOTTED = re.compile(r"`((?:hal|device|host_sync)(?:\.\w+)+)`")


def example(heading: str) -> dict[str, Any]:
    """Run the code blocks of a section of docs/extending.md; return its names."""
    page = (DOCS / "extending.md").read_text(encoding="utf-8")
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {"__name__": "example"}
    for block in BLOCK.findall(section):
        exec(compile(block, f"docs/extending.md, {heading}", "exec", dont_inherit=True), names)  # noqa: S102
    return names


def test_light_driver() -> None:
    names = example("A light driver")
    assert names["driven"] == [50, 0, 25]
    assert names["dark"] == [0, 0, 0]


def test_export_format() -> None:
    names = example("An export format")
    rows = np.loadtxt(names["xyz"].getvalue().decode().splitlines())
    np.testing.assert_array_equal(rows, [[0.0, 2.0, 0.0], [2.0, 2.0, 1.0], [2.0, 0.0, 3.0]])


def test_measurand() -> None:
    assert example("A measurand")["sdc_um"] == pytest.approx(7.0, abs=0.01)


def test_frame_check() -> None:
    names = example("A frame check")
    assert names["healthy"].outcome == "passed"
    assert names["dead"].outcome == "refused"
    assert names["dead"].value == pytest.approx(1 / 60)


def resolve(name: str) -> object:
    """Return the module, class, method or function of a dotted name."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            module = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        return reduce(getattr, parts[end:], module)
    raise ModuleNotFoundError(name)


@each_case(
    sorted(set(DOTTED.findall((DOCS / "architecture.md").read_text(encoding="utf-8")))), ImportError, AttributeError
)
def test_named_functions_exist(name: str) -> None:
    assert resolve(name)
