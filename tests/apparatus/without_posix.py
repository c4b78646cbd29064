"""Run commands of `retrosync` as on a system without POSIX: `python without_posix.py '[["list"], ["verify"]]'`.

Ends with the first exit code that is not 0.

What Windows lacks is taken away before the program is imported: modules, flags and functions. Opening a folder,
looking names up in an open one, and signalling a process to see whether it runs are errors there, so they are here.
"""

from __future__ import annotations

import builtins
import importlib
import io
import json
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

MODULES = ("fcntl", "pwd", "grp", "resource", "termios", "tty", "pty", "syslog", "posix_ipc")
FLAGS = ("O_NOFOLLOW", "O_DIRECTORY", "O_NONBLOCK", "O_CLOEXEC", "O_SYNC", "O_DSYNC")
FUNCTIONS = (
    "uname", "getuid", "geteuid", "getgid", "getegid", "fchmod", "fchown", "chown", "fork", "statvfs", "fstatvfs",
    "sched_getaffinity", "posix_fadvise", "posix_fallocate", "mkfifo", "fwalk", "sysconf", "getpgid", "killpg",
)  # fmt: skip
SIGNALS = ("SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGKILL", "SIGPIPE", "SIGCHLD", "SIGALRM")
SYSTEM_FILES = ("/proc/", "/sys/", "/etc/")
OURS = ("hal", "device", "host_sync", "filelock")
OTHERS = (
    "asyncio", "asyncssh", "cv2", "cyclopts", "matplotlib.figure", "matplotlib.backends.backend_agg", "msgspec",
    "multiprocessing.connection", "numba", "numpy", "PIL.Image", "platformdirs",
    "rich.progress", "scipy.fft", "scipy.ndimage", "scipy.optimize", "scipy.sparse.linalg", "starlette.applications",
    "subprocess", "threadpoolctl", "tifffile", "uvicorn", "zeroconf.asyncio",
)  # fmt: skip
"""Libraries have a Windows of their own, which they choose by the system's name: they are loaded before."""


def take_away() -> None:
    """Take from this process what Windows lacks."""
    for name in OTHERS:
        importlib.import_module(name)
    real_import = builtins.__import__

    def without_modules(name: str, *values: Any, **named: Any) -> ModuleType:
        variables = values[0] if values else named.get("globals")
        caller = str((variables or {}).get("__name__", ""))
        if name in MODULES and caller.partition(".")[0] in OURS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real_import(name, *values, **named)

    real_stream = io.open

    def without_system_files(file: Any, *values: Any, **named: Any) -> Any:
        if not isinstance(file, int) and str(file).startswith(SYSTEM_FILES):
            raise FileNotFoundError(2, "No such file or directory", file)
        return real_stream(file, *values, **named)

    builtins.__import__, io.open = without_modules, without_system_files
    real_statvfs = getattr(os, "statvfs", None)

    def disk_usage(path: Any) -> Any:
        facts = real_statvfs(path)
        return shutil._ntuple_diskusage(  # type: ignore[attr-defined]
            facts.f_blocks * facts.f_frsize, 0, facts.f_bavail * facts.f_frsize
        )

    if real_statvfs is not None:
        shutil.disk_usage = disk_usage
    for name in FLAGS + FUNCTIONS:
        if hasattr(os, name):
            delattr(os, name)
    for name in SIGNALS:
        if hasattr(signal, name):
            delattr(signal, name)
    real_kill, real_open = os.kill, os.open

    def kill(pid: int, number: int) -> None:
        library = str(sys._getframe(1).f_globals["__name__"]).startswith("filelock")  # asks by the system's name
        assert number or library, "on Windows this ends the process"
        real_kill(pid, number)

    def open_file(path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        assert dir_fd is None, "no name is looked up in an open folder"
        if not isinstance(path, int) and Path(os.fsdecode(path)).is_dir():
            raise PermissionError(13, "Permission denied", path)
        return real_open(path, flags, mode)

    os.kill, os.open = kill, open_file
    for function in (os.mkdir, os.rename, os.replace, os.unlink, os.rmdir, os.stat):
        _refuse_open_folders(function)
    os.supports_dir_fd = set()
    os.supports_fd = set()
    shutil.rmtree = _plain_rmtree
    tempfile._bin_openflags = os.O_RDWR | os.O_CREAT | os.O_EXCL  # type: ignore[attr-defined]


def _refuse_open_folders(function: Any) -> None:
    def checked(*values: Any, **named: Any) -> Any:
        assert not any(named.get(key) is not None for key in ("dir_fd", "src_dir_fd", "dst_dir_fd")), function.__name__
        return function(*values, **named)

    setattr(os, function.__name__, checked)


def _plain_rmtree(path: Any, ignore_errors: bool = False, *_: Any, **__: Any) -> None:
    """As `shutil.rmtree` without open folders; its own one decides at import."""
    try:
        for folder, folders, files in os.walk(path, topdown=False):
            for name in files:
                Path(folder, name).unlink()
            for name in folders:
                Path(folder, name).rmdir()
        Path(path).rmdir()
    except OSError:
        if not ignore_errors:
            raise


if __name__ == "__main__":
    take_away()
    from host_sync.cli.main import main

    sys.exit(next(filter(None, (main(words) for words in json.loads(sys.argv[1]))), 0))
