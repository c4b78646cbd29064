"""Hooks of pytest for several worker processes.

The first takes files from the front, others from the end: neighbouring files share calibrations and kernels, which two
processes would compile at the same time. A test that hangs runs once, and nothing outlives the run.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from pathlib import Path

import pytest

PR_SET_CHILD_SUBREAPER = 36


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log):  # type: ignore[no-untyped-def]
    """Return the scheduler of `--dist loadfile`, whose workers begin at both ends of the list of files."""
    from xdist.scheduler import LoadFileScheduling

    class FromBothEnds(LoadFileScheduling):
        def _assign_work_unit(self, node) -> None:  # type: ignore[no-untyped-def]
            if node.gateway.id != "gw0":
                self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
            super()._assign_work_unit(node)

    return FromBothEnds(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_configure(config: pytest.Config) -> None:
    """Let programs whose worker is gone become children of this process."""
    if _distributes(config):
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_handlecrashitem(crashitem: str, sched) -> None:  # type: ignore[no-untyped-def]
    """Count the test that ended its worker as done: the next worker would hang in it as well."""
    for file in getattr(sched, "workqueue", {}).values():
        if crashitem in file:
            file[crashitem] = True


def pytest_unconfigure(config: pytest.Config) -> None:
    """End every program that is left: it would keep the output of this run open."""
    while _distributes(config) and (left := _children()):
        for child in left:
            if command := Path(f"/proc/{child}/cmdline").read_text(errors="replace").replace("\0", " "):
                sys.stderr.write(f"outlived its test, and is ended: {command}\n")
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _distributes(config: pytest.Config) -> bool:
    return sys.platform == "linux" and bool(config.getoption("numprocesses", 0)) and not hasattr(config, "workerinput")


def _children() -> list[int]:
    return [int(one) for task in Path("/proc/self/task").glob("*/children") for one in task.read_text().split()]
