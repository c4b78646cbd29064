"""The screens never advise a shell command that they can do themselves."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import device
from device.tui.drawing.text import screen_advice

ON_SCREENS = re.compile(r"`retroscan (calibrate|selftest|gel|calibrations|pair|list|scan|tui)\b(?! --auto-exposure)")
DEVICE = Path(device.__file__).parent


def sentences(path: Path) -> Iterator[str]:
    """Every text in a module that is not a docstring; what is filled in reads "…"."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.value


def test_every_sentence_with_such_a_command_is_put_into_the_screens_words() -> None:
    advised = 0
    for path in sorted(DEVICE.rglob("*.py")):
        if path.is_relative_to(DEVICE / "cli") or path == DEVICE / "tui" / "drawing" / "text.py":
            continue
        for sentence in sentences(path):
            advised += bool(ON_SCREENS.search(sentence))
            assert not ON_SCREENS.search(screen_advice(sentence)), f"{path.name}: {sentence}"
    assert advised >= 8
    assert screen_advice("none is active: run `retroscan calibrate` first") == "none is active: calibrate first (key 2)"
