"""What the wheel holds, and that it works away from the checkout."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("hal", "device", "host_sync")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def held(wheel: Path) -> frozenset[str]:
    return frozenset(zipfile.ZipFile(wheel).namelist())


@pytest.fixture(scope="module")
def unpacked(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


def run_away_from_checkout(unpacked: Path, *arguments: str) -> str:
    """What Python prints when the wheel comes first on its path and the checkout is not its folder."""
    environment = {**os.environ, "PYTHONPATH": str(unpacked)}
    ran = subprocess.run(
        [sys.executable, *arguments], cwd=unpacked.parent, env=environment, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def test_wheel_holds_the_three_packages_and_nothing_else(held: frozenset[str]) -> None:
    assert {name.partition("/")[0] for name in held if ".dist-info/" not in name} == set(PACKAGES)
    facts = ("hal/board/", "device/schemas/", "host_sync/viewer/page/", "device/tui/screens/screens.tcss")
    marks = {f"{package}/py.typed" for package in PACKAGES}
    assert marks <= held
    assert not [name for name in held if "test" in Path(name).parts[0] or Path(name).name.startswith("test_")]
    code = [name for name in held if ".dist-info/" not in name and not name.startswith(facts) and name not in marks]
    assert {Path(name).suffix for name in code} == {".py"}
    assert {Path(name).suffix for name in held if name.startswith("hal/board/")} <= {".toml", ".md"}


def test_wheel_holds_every_module(held: frozenset[str]) -> None:
    modules = {path.relative_to(ROOT).as_posix() for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    assert {name for name in held if name.endswith(".py")} == modules


def test_wheel_holds_every_board_profile(held: frozenset[str]) -> None:
    profiles = {f"hal/board/{path.name}" for path in (ROOT / "board").glob("*.toml")}
    assert "hal/board/twin.toml" in profiles
    assert profiles <= held


def test_wheel_holds_every_schema(held: frozenset[str]) -> None:
    schemas = {f"device/schemas/{path.name}" for path in (ROOT / "docs" / "schemas").glob("*.json")}
    assert "device/schemas/scan-1.json" in schemas
    assert {name for name in held if name.startswith("device/schemas/")} == schemas


def test_wheel_holds_the_viewers_page_and_the_licence_of_what_it_brings(held: frozenset[str]) -> None:
    place = ROOT / "host_sync" / "viewer" / "page"
    page = {path.relative_to(ROOT).as_posix() for path in place.rglob("*") if path.is_file()}
    assert {"host_sync/viewer/page/index.html", "host_sync/viewer/page/vendor/three.LICENSE.txt"} <= page <= held


def test_wheel_carries_its_licence(held: frozenset[str]) -> None:
    carried = {Path(name).name for name in held if ".dist-info/licenses/" in name}
    assert carried == {"LICENSE", "NOTICE"}


def test_version_stands_in_one_place(wheel: Path) -> None:
    """The program reads it from its own metadata; no source file repeats it."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert wheel.name == f"retrograph-{stated}-py3-none-any.whl"
    sources = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    assert [path.name for path in sources if f'"{stated}"' in path.read_text(encoding="utf-8")] == []
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"({stated})" in changes.split("\n## ")[1].splitlines()[0] or f"## {stated}" in changes


@pytest.mark.slow  # compiles once more, for another place of the source files
def test_demo_plays_from_the_wheel(unpacked: Path, small_board: Path, tmp_path: Path) -> None:
    """Without a checkout, and to the picture."""
    out = tmp_path / "story"
    arguments = ["demo", "--out", str(out), "--board", str(small_board), "--no-browser"]
    said = run_away_from_checkout(
        unpacked, "-c", f"import sys; from host_sync.cli.main import main; sys.exit(main({arguments!r}))"
    )
    assert "12 balls used, 0 rejected" in said
    assert (out / "demo.png").read_bytes().startswith(b"\x89PNG")


def test_board_profile_loads_from_the_wheel(unpacked: Path) -> None:
    told = run_away_from_checkout(
        unpacked,
        "-c",
        "import hal.board_profile as b; print(b.__file__); print(b.load_board_profile('twin').name)",
    )
    assert told.split() == [str(unpacked / "hal" / "board_profile.py"), "twin"]


@pytest.mark.parametrize("command", ["retroscan", "retrosync"])
def test_command_answers_from_the_wheel(unpacked: Path, command: str) -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    module, _, function = scripts[command].partition(":")
    call = f"import sys; from {module} import {function}; sys.exit({function}(['--help']))"
    assert command in run_away_from_checkout(unpacked, "-c", call)


@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        ("requirements.lock", ("device", "host", "dev")),
        ("requirements-bench.lock", ("bench", "cluster")),
        ("requirements-docs.lock", ("docs",)),
        ("requirements-board.lock", ("board",)),
    ],
)
def test_lock_holds_what_the_project_asks_for(lock: str, extras: tuple[str, ...]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [need for extra in extras for need in project["optional-dependencies"][extra]]
    if "host" in extras:
        asked += project["dependencies"]
    names = {need.partition(">")[0].partition("[")[0] for need in asked} - {project["name"]}
    pinned = {line.partition("==")[0] for line in (ROOT / lock).read_text(encoding="utf-8").splitlines()}
    assert names <= pinned
