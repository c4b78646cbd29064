"""Speed and memory of a pull, against OpenSSH's own client on the same files in the same run (on demand: -m slow).

The two take turns, and the turn that others disturbed least counts: shares in one turn, never seconds.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from host_sync.offload.paired_devices import PairedDevices
from host_sync.offload.sftp import SftpSource

FILES = 12
FILE_BYTES = 24 << 20
MAX_RSS_KB = 150_000
MIN_FRACTION = 0.8
TURNS = 5

PULL_AND_SAY_RSS = """
import re, sys, time
from pathlib import Path
from host_sync.cli.main import main
import host_sync.offload.sftp
begun = time.monotonic()
code = main(["pull", "rg00c0ffee", "--library", sys.argv[1]])
peak_kb = re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]
sys.stderr.write(f"{time.monotonic() - begun} {peak_kb}")
sys.exit(code)
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("sftp") is None, reason="OpenSSH's sftp is not installed: `make test-deps`")
def test_pulling_keeps_up_with_openssh_in_bounded_memory(
    server: Any, publish_large: Callable[[int], object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(FILES):
        publish_large(FILE_BYTES)
    settings = PairedDevices(tmp_path / "config" / "retrograph")
    settings.private_key(server.private_key.read_bytes)
    settings.save(server.device())
    environment = os.environ | {"XDG_CONFIG_HOME": str(tmp_path / "config")}
    streamed_s, pulled_s, theirs_s, peak_rss_kb = [], [], [], 0
    for turn in range(TURNS):
        target = tmp_path / f"theirs-{turn}"
        target.mkdir()
        options = ["-oStrictHostKeyChecking=no", f"-oUserKnownHostsFile={tmp_path}/known", "-oBatchMode=yes"]
        where = [f"-P{server.port}", f"-i{server.private_key}", f"{server.device().user}@127.0.0.1:scans"]
        begun = time.monotonic()
        subprocess.run(["sftp", "-q", "-r", *options, *where, target], check=True, capture_output=True)
        os.sync()
        theirs_s.append(time.monotonic() - begun)
        begun = time.monotonic()
        with server.link() as link:
            source = SftpSource(link)
            for scan in source.bundle_names("scans").ids:
                digest = hashlib.sha256()
                with (target / "streamed").open("wb") as stream:
                    for block in source.blocks(f"scans/{scan}/raw.tif"):
                        stream.write(block)
                        digest.update(block)
        os.sync()
        streamed_s.append(time.monotonic() - begun)
        library = tmp_path / f"ours-{turn}"
        shutil.rmtree(server.root / "receipts")
        command = [sys.executable, "-c", PULL_AND_SAY_RSS, library]
        ran = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
        pulled_s.append(float(ran.stderr.split()[-2]))
        peak_rss_kb = max(peak_rss_kb, int(ran.stderr.split()[-1]))
        shutil.rmtree(target)
        shutil.rmtree(library)
    megabytes = FILES * FILE_BYTES / 1e6
    streamed, pulled = (
        [theirs / ours for theirs, ours in zip(theirs_s, each_s, strict=True)] for each_s in (streamed_s, pulled_s)
    )
    with capsys.disabled():
        sys.stdout.write(
            f"\nsftp {megabytes / min(theirs_s):.0f} MB/s; ours {megabytes / min(streamed_s):.0f} MB/s written and "
            f"hashed, {megabytes / min(pulled_s):.0f} MB/s as a whole pull with fsync, re-reading and receipts; "
            f"at most {peak_rss_kb / 1e3:.0f} MB of memory\nshares of sftp, turn by turn: "
            f"streamed {' '.join(f'{share:.2f}' for share in streamed)}, "
            f"pulled {' '.join(f'{share:.2f}' for share in pulled)}\n"
        )
    assert peak_rss_kb <= MAX_RSS_KB
    assert max(streamed) >= MIN_FRACTION
    assert max(pulled) >= MIN_FRACTION
