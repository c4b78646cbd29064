"""The house rules that a program can check, and the tools of the one gate with their own words when they fail."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from each_case import each_case

ROOT = Path(__file__).parent.parent
PACKAGES = ("hal", "device", "host_sync")
FOLDERS = (*PACKAGES, "tests", "board", "systemd", "docs", ".ci")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
MAX_LINES = 400

TOOLS = {
    "ruff check": ("ruff", "check"),
    "ruff format": ("ruff", "format", "--check"),
    "mypy --strict": ("mypy",),
    "import contracts": ("lint-imports",),
}

# In pieces, so that this file does not hold what it looks for.
MACHINE_PATH = re.compile(rb"(?<![\w.~}/-])/(?:home|root|work|Users)/\w")
PACKAGE_HOST = re.compile(b"|".join((rb"py" + rb"pi\.(?:org|io)", rb"python" + rb"hosted\.org", rb"npm" + rb"js\.\w")))


def in_root(path: Path) -> str:
    return str(path.relative_to(ROOT))


def own_files() -> list[Path]:
    """What the project consists of: the files at its root and in its folders, without caches."""
    at_root = [path for path in ROOT.iterdir() if path.is_file() and path.name != ".git"]
    inside = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.is_file()]
    return [path for path in at_root + inside if "__pycache__" not in path.parts]


def lines_with(pattern: re.Pattern[bytes], paths: list[Path]) -> list[str]:
    return [
        f"{in_root(path)}:{number}: {line.decode(errors='replace').strip()}"
        for path in paths
        for number, line in enumerate(path.read_bytes().splitlines(), start=1)
        if pattern.search(line)
    ]


def catches_everything(handler: ast.ExceptHandler) -> bool:
    caught = ast.walk(handler.type) if handler.type else iter([ast.Name("BaseException")])
    return any(isinstance(node, ast.Name) and node.id in {"Exception", "BaseException"} for node in caught)


def lets_go(handler: ast.ExceptHandler) -> bool:
    last = handler.body[-1]
    return isinstance(last, ast.Raise) and last.exc is None


@pytest.mark.parametrize("tool", TOOLS)
def test_gate(tool: str) -> None:
    name, *arguments = TOOLS[tool]
    run = subprocess.run(
        [Path(sys.executable).with_name(name), *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if run.returncode:
        pytest.fail(f"{tool}:\n{run.stdout}{run.stderr}", pytrace=False)


def test_a_module_is_one_page() -> None:
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert [f"{in_root(path)}: {count} lines" for path, count in lines.items() if count > MAX_LINES] == []


def test_a_package_file_holds_a_docstring_only() -> None:
    trees = {path: ast.parse(path.read_bytes()) for path in MODULES if path.name == "__init__.py"}
    assert [in_root(path) for path, tree in trees.items() if len(tree.body) != 1 or not ast.get_docstring(tree)] == []


def test_only_an_entry_point_may_catch_everything() -> None:
    """Elsewhere what catches everything cleans up and lets it go on its way: its last line is `raise`."""
    trees = {path: ast.parse(path.read_bytes()) for path in MODULES if path.parts[-2:] != ("cli", "main.py")}
    assert [
        f"{in_root(path)}:{node.lineno}"
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ExceptHandler) and catches_everything(node) and not lets_go(node)
    ] == []


def test_every_package_folder_is_a_package() -> None:
    folders = {path.parent for path in MODULES}
    assert [in_root(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_there_is_no_python_beside_facts_and_units() -> None:
    assert [in_root(path) for folder in ("board", "systemd") for path in (ROOT / folder).rglob("*.py")] == []


def test_no_file_knows_the_machine_it_was_written_on() -> None:
    assert lines_with(MACHINE_PATH, own_files()) == []


def test_no_file_names_a_package_host() -> None:
    assert lines_with(PACKAGE_HOST, own_files()) == []


@each_case(
    [
        "requirements.lock",
        "requirements-bench.lock",
        "requirements-docs.lock",
        "requirements-board.lock",
        ".ci/torch-cpu.lock",
    ],
)
def test_the_lock_pins_by_hash_and_names_no_index(lock: str) -> None:
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    facts = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    pins = [line for line in facts if not line.startswith(" ")]
    assert pins
    assert [pin for pin in pins if not re.match(r"[a-z0-9._-]+==[^ ]+( ; [^\\]+)? \\$", pin)] == []
    assert [
        fact for fact in facts if fact not in pins and not re.match(r" +--hash=sha256:[0-9a-f]{64}( \\)?$", fact)
    ] == []
    assert len(facts) > 2 * len(pins) - 1
