"""OpenSCAD's CSG export as a tree: what is left of a source when every parameter, loop and module has been worked out.

Only what `board/enclosure/retrograph.scad` needs is understood; anything else raises `ValueError` with its name.
"""

import ast
import re
from dataclasses import dataclass, field

TOKEN = re.compile(r"\s*([A-Za-z_$][\w$]*)\s*\(([^()]*)\)\s*([{;])|\s*(\})")
GROUPS = frozenset({"group", "union", "difference", "intersection", "multmatrix", "color"})
SOLIDS = frozenset({"cube", "cylinder"})


@dataclass
class Node:
    """One call: its name, its arguments by name (an unnamed one is ""), and what it is applied to."""

    name: str
    arguments: dict[str, object]
    children: list["Node"] = field(default_factory=list)


def argument(text: str) -> object:
    """One value: a number, a list of them, a word in quotes, or true or false."""
    return {"true": True, "false": False}[text] if text in {"true", "false"} else ast.literal_eval(text)


def arguments_of(text: str) -> dict[str, object]:
    """`h = 3, center = false` or `[[1, 0], [0, 1]]` by name; commas within brackets part nothing."""
    found: dict[str, object] = {}
    for part in re.split(r",\s*(?![^\[]*\])(?=[$\w]+ =)", text):
        name, equals, value = part.partition(" = ")
        if part.strip():
            found[name.strip() if equals else ""] = argument((value if equals else name).strip())
    return found


def parse(text: str) -> Node:
    """The tree below one `group` that holds the whole file. Raises `ValueError` on what is not understood."""
    root = Node("group", {})
    stack, at = [root], 0
    end = len(text.rstrip())
    while at < end:
        found = TOKEN.match(text, at)
        if found is None:
            raise ValueError(f"CSG is not understood from {text[at : at + 40].strip()!r}")
        at = found.end()
        name, arguments, opening, closing = found.groups()
        if closing:
            if len(stack) == 1:
                raise ValueError("CSG closes a group that it never opened")
            stack.pop()
            continue
        if name not in GROUPS | SOLIDS:
            raise ValueError(f"CSG has {name}, which no solid is made of here")
        node = Node(name, arguments_of(arguments))
        stack[-1].children.append(node)
        if opening == "{":
            stack.append(node)
    if len(stack) != 1:
        raise ValueError("CSG ends within a group")
    return root
