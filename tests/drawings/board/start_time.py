"""Time of the instrument from its start to READY=1, on the twin on this machine: the last step of docs/boot.md.

usage: python -m tests.drawings.board.start_time [RUNS]     calibrates a scratch store first, half a minute
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RETROSCAN = (sys.executable, "-m", "device", "--board", "twin")


def main() -> None:
    """Print every run and the fastest."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        subprocess.run([*RETROSCAN, "--store", store, "calibrate"], check=True, capture_output=True)
        took_s = [start_to_ready_s(store, Path(folder) / "notify") for _ in range(runs)]
    sys.stdout.write("".join(f"start to READY=1: {one_s:.2f} s\n" for one_s in took_s))
    sys.stdout.write(f"quickest: {min(took_s):.2f} s\n")


def start_to_ready_s(store: Path, address: Path) -> float:
    """Seconds from starting the program to its READY=1."""
    address.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(address))
        listening.settimeout(120.0)
        environment = {**os.environ, "NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "60000000"}
        began_s = time.perf_counter()
        with subprocess.Popen(
            [*RETROSCAN, "--store", store, "run"], env=environment, stdout=subprocess.DEVNULL
        ) as program:
            while not listening.recv(4096).startswith(b"READY=1"):
                pass
            took_s = time.perf_counter() - began_s
            program.terminate()
        return took_s


if __name__ == "__main__":
    main()
