"""The documents: every page in the navigation, no dead link, commands that the programs and the Makefile know."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from cyclopts import CycloptsError
from each_case import each_case
from typed_commands import parse

ROOT = Path(__file__).parent.parent
PAGES = sorted(
    [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    + [path for folder in ("docs", "board") for path in (ROOT / folder).rglob("*.md")]
)
CHANGES = ROOT / "CHANGELOG.md"
LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ +(.+?) *$", re.MULTILINE)
FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^(?: {4}|\t)(.*)$", re.MULTILINE)
PROGRAM = re.compile(r"^(?:sudo (?:-u \w+ )?)?(?:\S*/bin/)?((?:retroscan|retrosync)(?:$| .*))")
INLINE = re.compile(r"`(retroscan|retrosync) ([a-z][a-z-]+)")
MAKE = re.compile(r"^make ((?:[a-z][a-z-]* ?)+)")


def in_root(path: Path) -> str:
    return str(path.relative_to(ROOT))


def navigation() -> list[str]:
    """The pages that mkdocs.yml names, in order."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    return re.findall(r"^ +- [^\n]+?: (\S+\.md)$", text, re.MULTILINE)


def without_code(text: str) -> str:
    return re.sub(r"`[^`\n]*`", "", FENCED.sub("", text))


def anchors(path: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and as the site make them."""
    text = path.read_text(encoding="utf-8")
    found = set(re.findall(r'<a (?:id|name)="([^"]+)"', text))
    for heading in HEADING.findall(FENCED.sub("", text)):
        plain = re.sub(r"[^\w\s-]", "", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)).strip().lower()
        found |= {plain.replace(" ", "-"), re.sub(r"[\s-]+", "-", plain)}
    return found


def typed(path: Path) -> list[str]:
    """Lines of a page's code blocks."""
    text = path.read_text(encoding="utf-8").replace("\\\n", " ")
    fenced = [line for kind, code in FENCED.findall(text) if kind != "python" for line in code.split("\n")]
    return fenced + INDENTED.findall(FENCED.sub("", text))


COMMANDS = sorted(
    {
        (in_root(path), found[1].replace("…", "").replace("...", "").strip())
        for path in PAGES
        if path != CHANGES
        for line in typed(path)
        if (found := PROGRAM.match(line.strip()))
    }
)


def test_every_page_is_in_the_navigation_once() -> None:
    named = navigation()
    assert len(named) == len(set(named))
    assert sorted(named) == sorted(in_root(path) for path in PAGES)


@each_case(PAGES, name=in_root)
def test_no_link_is_dead(path: Path) -> None:
    dead = []
    for target in LINK.findall(without_code(path.read_text(encoding="utf-8"))):
        if target.startswith(("https://", "http://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        place = (path.parent / name).resolve() if name else path
        if not place.is_file() or (anchor and place.suffix == ".md" and anchor not in anchors(place)):
            dead.append(target)
    assert dead == []


def test_what_pages_link_to_is_copied_for_the_site() -> None:
    """`.ci/docs` builds the site from a copy; its command names what the copy holds."""
    copied = re.search(r"cp -r --parents (.+) \"\$source\"", (ROOT / ".ci" / "docs").read_text(encoding="utf-8"))
    assert copied
    places = [ROOT / name for name in copied[1].split()]
    for path in PAGES:
        for target in LINK.findall(without_code(path.read_text(encoding="utf-8"))):
            if "://" not in target and (name := target.partition("#")[0]):
                linked = (path.parent / name).resolve()
                assert any(linked == place or place in linked.parents for place in places), (in_root(path), target)


@each_case(COMMANDS, CycloptsError, name=": ".join)
def test_every_command_parses(command: tuple[str, str]) -> None:
    parse(command[1])


def test_commands_are_found() -> None:
    assert (
        "README.md",
        "retrosync demo           # a simulated handheld, and at the end the page of the viewer",
    ) in (COMMANDS)
    assert len(COMMANDS) > 60


@each_case([path for path in PAGES if path != CHANGES], CycloptsError, name=in_root)
def test_a_command_in_a_sentence_exists(path: Path) -> None:
    for program, command in INLINE.findall(path.read_text(encoding="utf-8")):
        parse(f"{program} {command} --help")


def test_every_target_of_make_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    asked = {
        word
        for path in PAGES
        if path != CHANGES
        for line in [*typed(path), *re.findall(r"`(make [^`]+)`", path.read_text(encoding="utf-8"))]
        if (found := MAKE.match(line.strip()))
        for word in found[1].split()[:1]
    }
    assert {"demo", "test", "docs", "release"} <= asked <= targets


@each_case(PAGES, SyntaxError, name=in_root)
def test_python_in_documents_is_python(path: Path) -> None:
    for kind, code in FENCED.findall(path.read_text(encoding="utf-8")):
        if kind == "python":
            ast.parse(code)


def test_there_is_no_program_in_docs() -> None:
    assert [in_root(path) for path in (ROOT / "docs").rglob("*") if path.suffix in {".py", ".sh"}] == []


def test_the_readme_fits_a_screen() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 60


DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))


@each_case(DECISIONS, name=in_root)
def test_a_decision_has_its_four_parts_on_a_page(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert re.match(rf"# {path.stem[:4]} \w", text)
    assert re.findall(r"^\*\*(\w+)\.\*\*", text, re.MULTILINE) == ["Status", "Context", "Decision", "Consequences"]
    assert len(text.split()) <= 700
