"""Runs `retrosync` commands one after the other, each in a process of its own, and says the peak of its memory.

As a program it reads a JSON list of arguments a line and answers with a line {"code", "peak_kb", "errors"}. Each
process is forked from one that has imported everything and computed nothing, so that a thousand take minutes.
"""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import urllib.parse
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

ROUTES = (
    "",
    "/thumbnail",
    "/level/0?first=0&last=64",
    "/height?row=3&column=4",
    "/profile?row_0=0&column_0=0&row_1=9&column_1=9",
    "/sigma",
    "/frame",
)
LONGEST_S = 1200


@dataclass(frozen=True)
class Ran:
    """How a command ended, its peak of resident memory, and what it said on standard error."""

    code: int
    peak_kb: int
    errors: str


class Commands:
    """The program below, running; a context manager."""

    def __init__(self) -> None:
        environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
        self._process = subprocess.Popen([sys.executable, __file__], stdin=-1, stdout=-1, text=True, env=environment)

    def __enter__(self) -> Commands:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.communicate()

    def run(self, *arguments: str | Path) -> Ran:
        """Run one command; `view` is asked for everything that it lists and then interrupted."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(one) for one in arguments]) + "\n")
        self._process.stdin.flush()
        return Ran(**json.loads(self._process.stdout.readline()))


def serve() -> None:
    """Answer line by line."""
    import host_sync.offload.mirror
    import host_sync.reconstruction.scans
    import host_sync.viewer.app  # noqa: F401
    from host_sync.cli.main import main

    for line in sys.stdin:
        arguments = json.loads(line)
        with tempfile.TemporaryFile() as errors:
            child = os.fork()
            if child == 0:
                signal.alarm(LONGEST_S)
                os.dup2(errors.fileno(), 2)
                os._exit(viewed(arguments, main) if arguments[0] == "view" else quiet(arguments, main))
            _, status, usage = os.wait4(child, 0)
            errors.seek(0)
            said = errors.read().decode(errors="replace")
        code = os.waitstatus_to_exitcode(status)
        sys.stdout.write(json.dumps({"code": code, "peak_kb": usage.ru_maxrss, "errors": said}) + "\n")
        sys.stdout.flush()


def quiet(arguments, main) -> int:  # type: ignore[no-untyped-def]
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return int(main(arguments))


def viewed(arguments, main) -> int:  # type: ignore[no-untyped-def]
    read_end, write_end = os.pipe()
    os.dup2(write_end, 1)
    visitor = threading.Thread(target=visit, args=(read_end,), daemon=True)
    visitor.start()
    return int(main(arguments))


def visit(output: int) -> None:
    """Open the link that the viewer prints and ask for everything, then interrupt it."""
    try:
        with os.fdopen(output) as lines:
            link = urllib.parse.urlsplit(next(word for line in lines for word in line.split() if "://" in word))
        headers = {"Host": link.netloc}

        def get(path: str) -> tuple[http.client.HTTPResponse, bytes]:
            connection = http.client.HTTPConnection("127.0.0.1", link.port, timeout=LONGEST_S)  # no resolver is needed
            with closing(connection):
                connection.request("GET", path, headers=headers)
                answer = connection.getresponse()
                return answer, answer.read()

        answer, _ = get(f"{link.path}?{link.query}")
        headers["Cookie"] = answer.headers["Set-Cookie"].partition(";")[0]
        for entry in json.loads(get("/api/list")[1])["entries"]:
            for route in ROUTES:
                get(f"/api/scan/{entry['key']}{route}")
    finally:
        os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    serve()
