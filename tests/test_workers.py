"""A test that hangs ends the run neither late nor silently."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import limits
import pytest

HANGS = """
import subprocess
import threading

import pytest

@pytest.mark.parametrize("one", range(3))
def test_before(one):
    pass

def test_that_hangs():
    for own_session in (False, True):
        subprocess.Popen(["sleep", "3600"], start_new_session=own_session)
    threading.Event().wait()

@pytest.mark.parametrize("one", range(3))
def test_after(one):
    pass
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere programs that a test started may outlive it")
def test_a_test_that_hangs_is_named_once_and_the_rest_runs_and_nothing_is_left(tmp_path: Path) -> None:
    for name in ("test_one.py", "test_two.py", "test_three.py"):
        (tmp_path / name).write_text("import pytest\n\n@pytest.mark.parametrize('n', range(4))\ndef test(n): pass\n")
    (tmp_path / "test_hanging.py").write_text(HANGS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nfaulthandler_timeout = 1\nfaulthandler_exit_on_timeout = true\n")
    options = ["-p", "tests.apparatus.workers", "-n", "2", "--dist", "loadfile", "-rf"]
    ran = subprocess.run(  # until nobody holds its output open
        [sys.executable, "-m", "pytest", *options, "-c", tmp_path / "pytest.ini", tmp_path],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ran.returncode == 1, ran.stdout + ran.stderr
    assert "1 failed, 18 passed" in ran.stdout
    assert "crashed while running 'test_hanging.py::test_that_hangs'" in ran.stdout
    assert "Timeout (0:00:01)!" in ran.stderr
    assert "in test_that_hangs" in ran.stderr
    assert ran.stderr.count("outlived its test, and is ended: sleep 3600") == 2


def test_programs_that_do_not_end_fail_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "WAIT_S", 0.05)
    with pytest.raises(subprocess.TimeoutExpired, match="sleep"):
        subprocess.run(["sleep", "3600"], check=False)
    with (
        pytest.raises(pytest.fail.Exception, match=r"killed after 0\.05 s: \['sleep'"),
        limits.running(["sleep", "3600"], stdout=subprocess.PIPE) as program,
    ):
        program.stdout.readline()
