"""What a fresh machine that lacks something is told: one plain sentence, and nothing is left behind."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of what set-up reads, without an environment."""
    folder = tmp_path / "a checkout"
    (folder / ".ci").mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "requirements-bench.lock"):
        shutil.copy(ROOT / name, folder / name)
    for path in filter(Path.is_file, (ROOT / ".ci").iterdir()):
        shutil.copy(path, folder / ".ci")
    return folder


def script(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(("#!/bin/sh", *lines, "")), encoding="utf-8")
    path.chmod(0o755)
    return path


def make(checkout: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "PIP_", "MFLAGS"))}
    return subprocess.run(
        ["make", *arguments], cwd=checkout, env=environment, capture_output=True, text=True, check=False
    )


def complaint(run: subprocess.CompletedProcess[str]) -> str:
    """What was said of a run that failed without a traceback."""
    assert run.returncode != 0
    assert "Traceback" not in run.stdout + run.stderr
    return run.stderr


@pytest.mark.parametrize("target", ["demo", "test"])
def test_no_python(checkout: Path, target: str) -> None:
    said = complaint(make(checkout, target, "PYTHON=no-such-python"))
    assert "there is no 'no-such-python' here: install Python 3.11" in said
    assert not (checkout / ".venv").exists()


@pytest.mark.parametrize("version", ["2.7.18", "3.10.13", "3.14.0"])
def test_python_of_another_version(checkout: Path, tmp_path: Path, version: str) -> None:
    python = script(tmp_path / "python", f"echo {version}")
    assert f"is Python {version}, but 3.11, 3.12 or 3.13 is needed" in complaint(
        make(checkout, "test", f"PYTHON={python}")
    )
    assert not (checkout / ".venv").exists()


def test_python_without_venv(checkout: Path, tmp_path: Path) -> None:
    python = script(
        tmp_path / "python",
        'case "$2" in *ensurepip*) echo "ModuleNotFoundError: No module named ensurepip" >&2; exit 1 ;; esac',
        f'exec "{sys.executable}" "$@"',
    )
    assert "apt install python3-venv" in complaint(make(checkout, "test", f"PYTHON={python}"))
    assert not (checkout / ".venv").exists()


def test_packages_out_of_reach_then_within_reach(checkout: Path, tmp_path: Path) -> None:
    """An interrupted set-up leaves no `ready` behind, so that the next run begins again."""
    python = fake_python(tmp_path, "echo 'ERROR: No matching distribution found for numpy' >&2; exit 1")
    said = complaint(make(checkout, "set-up", f"PYTHON={python}"))
    assert "could not be installed" in said
    assert "No matching distribution found for numpy" in said
    assert not (checkout / ".venv" / "ready").exists()

    python = fake_python(tmp_path, "exit 0")
    assert make(checkout, "set-up", f"PYTHON={python}").returncode == 0
    assert (checkout / ".venv" / "ready").is_file()


def test_an_environment_of_something_else_is_left_alone(checkout: Path, tmp_path: Path) -> None:
    python = fake_python(tmp_path, "exit 0")
    other = tmp_path / "other"
    other.mkdir()
    (other / "pyvenv.cfg").touch()
    (other / "ready").write_text("3.11.7 1 2 /somewhere/else\n", encoding="utf-8")
    said = complaint(make(checkout, "set-up", f"PYTHON={python}", f"VENV={other}"))
    assert "was not made for this checkout: name another with VENV=" in said
    assert sorted(path.name for path in other.iterdir()) == ["pyvenv.cfg", "ready"]


def test_a_named_environment_that_was_interrupted_is_made_again(checkout: Path, tmp_path: Path) -> None:
    named = f"VENV={tmp_path / 'named'}"
    complaint(make(checkout, "set-up", named, f"PYTHON={fake_python(tmp_path, 'exit 1')}"))
    assert make(checkout, "set-up", named, f"PYTHON={fake_python(tmp_path, 'exit 0')}").returncode == 0
    assert (tmp_path / "named" / "ready").is_file()


def test_no_network(checkout: Path, tmp_path: Path) -> None:
    python = fake_python(tmp_path, "echo 'WARNING: Retrying after NewConnectionError(...)' >&2; exit 1")
    assert "the package index cannot be reached" in complaint(make(checkout, "set-up", f"PYTHON={python}"))


def test_second_run_installs_nothing_until_the_lock_or_the_project_changes(checkout: Path, tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    python = fake_python(tmp_path, f'echo "$*" >> "{calls}"')

    def installed() -> list[str]:
        calls.write_text("", encoding="utf-8")
        assert make(checkout, "set-up", f"PYTHON={python}").returncode == 0
        return ["lock" if "requirements.lock" in line else "checkout" for line in calls.read_text().splitlines()]

    assert installed() == ["lock", "checkout"]
    assert installed() == []
    with (checkout / "pyproject.toml").open("a", encoding="utf-8") as project:
        project.write("\n# changed\n")
    assert installed() == ["checkout"]
    with (checkout / "requirements.lock").open("a", encoding="utf-8") as lock:
        lock.write("# changed\n")
    assert installed() == ["lock", "checkout"]


def set_up_peers(checkout: Path, tmp_path: Path, pip: str) -> subprocess.CompletedProcess[str]:
    """Set up the benchmark's peers with a pip that does what is given."""
    python = checkout / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(fake_python(tmp_path, f'mkdir -p "{checkout}/.venv/peers"; {pip}'), python)
    return subprocess.run(
        ["bash", ".ci/set-up-bench", ".venv"], cwd=checkout, capture_output=True, text=True, check=False
    )


def test_the_benchmark_takes_the_small_torch_once(checkout: Path, tmp_path: Path) -> None:
    calls = tmp_path / "calls"
    pip = f'echo "$*" >> "{calls}"'
    assert set_up_peers(checkout, tmp_path, pip).returncode == 0
    assert [".ci/torch-cpu.lock" in line for line in calls.read_text().splitlines()] == [False, True]
    assert set_up_peers(checkout, tmp_path, "exit 1").returncode == 0


def test_the_benchmark_goes_on_without_torch(checkout: Path, tmp_path: Path) -> None:
    run = set_up_peers(checkout, tmp_path, 'case "$*" in *light*) exit 0 ;; esac; echo "ERROR: no torch" >&2; exit 1')
    assert run.returncode == 0, run.stderr
    assert "torch could not be installed: the benchmark goes on without it" in run.stdout


def test_the_benchmark_without_its_peers_says_so(checkout: Path, tmp_path: Path) -> None:
    run = set_up_peers(checkout, tmp_path, "echo 'ERROR: No matching distribution found for pyamg' >&2; exit 1")
    assert "No matching distribution found for pyamg" in complaint(run)
    assert not (checkout / ".venv" / "peers" / "ready").exists()


def fake_python(folder: Path, pip: str) -> Path:
    """A Python whose environments are made at once and whose pip does what is given."""
    return script(
        folder / "python",
        'case "$1 $2" in',
        '\'-m venv\') mkdir -p "$3/bin" && touch "$3/pyvenv.cfg" && cp "$0" "$3/bin/python" ;;',
        f"'-m pip') {pip} ;;",
        f'*) exec "{sys.executable}" "$@" ;;',
        "esac",
    )


def audit(checkout: Path, tmp_path: Path, *pip_audit: str, installs: bool = True) -> subprocess.CompletedProcess[str]:
    """`.ci/audit` with a Python whose environments answer like this when pip-audit is called."""
    arguments = 'while [ $# -gt 1 ]; do [ "$1" != --output ] || answer=$2; shift; done; lock=$1'
    pip = f'case "$2" in pip) exit {0 if installs else 1} ;; esac'
    inner = script(tmp_path / "inner", pip, arguments, *pip_audit)
    outer = script(tmp_path / "python", 'mkdir -p "$3/bin"', f'ln -s "{inner}" "$3/bin/python"')
    return subprocess.run(
        ["bash", checkout / ".ci/audit", outer], capture_output=True, text=True, check=False, cwd=checkout
    )


def test_known_faults_end_an_audit_and_name_the_package(checkout: Path, tmp_path: Path) -> None:
    ran = audit(checkout, tmp_path, '[ "$lock" != requirements.lock ] || { echo numpy 1.0 GHSA-1 >"$answer"; exit 1; }')
    assert ran.returncode == 1
    assert "numpy 1.0 GHSA-1" in ran.stdout
    assert "requirements.lock: has packages with known faults" in ran.stdout
    assert "requirements-bench.lock: no known faults" in ran.stdout


@pytest.mark.parametrize("installs", [True, False])
def test_without_a_network_nothing_is_audited_and_that_is_said(checkout: Path, tmp_path: Path, installs: bool) -> None:
    ran = audit(checkout, tmp_path, "echo ConnectionError >&2; exit 1", installs=installs)
    assert (ran.returncode, ran.stdout.startswith("not audited: ")) == (0, True)


def test_packages_without_faults_pass(checkout: Path, tmp_path: Path) -> None:
    ran = audit(checkout, tmp_path, "exit 0")
    assert (ran.returncode, ran.stdout.count("no known faults")) == (0, 2)
