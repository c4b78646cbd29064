"""Fifty scans of 12 megapixels: how soon the first picture is there, and what the viewer keeps in memory.

The time is that of the machine it runs on and is printed; what is asserted is memory, and generous bounds of time.
"""

import json
import os
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from host_sync.results.field_file import write_field

SHAPE = (3000, 4000)
SCANS = 50
DIFFERENT = 3
MAX_MB = 900
MAX_FIRST_S = 2.0


def write_scans(root: Path) -> None:
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    for number in range(SCANS):
        folder = root / f"scan-{number:02d}"
        folder.mkdir(parents=True)
        if number < DIFFERENT:
            wave = np.sin(column / (9.0 + number)) * np.cos(row / 13.0)
            hill = np.exp(-((row - 1500.0) ** 2 + (column - 2000.0) ** 2) / 900.0**2)
            write_field(folder / "height_um.tif", 20.0 * wave + 400.0 * hill, 3.0, "height, um")
        else:
            os.link(root / f"scan-{number % DIFFERENT:02d}" / "height_um.tif", folder / "height_um.tif")
        record = {"schema": "retrograph.result/1", "name": folder.name, "rows": SHAPE[0], "columns": SHAPE[1]}
        (folder / "result.json").write_bytes(msgspec.json.encode(record | {"pixel_pitch_um": 3.0}))


class Viewer:
    """`retrosync view` as a process of its own."""

    def __init__(self, root: Path, cache: Path) -> None:
        command = [sys.executable, "-m", "host_sync", "view", str(root), "--cache", str(cache), "--no-browser"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().split()[1]
        self.origin = self.address.partition("/?")[0]
        self.opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        self.opener.open(self.address).close()

    def stop(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=60.0)
        self.opener.close()

    def get(self, path: str) -> bytes:
        with self.opener.open(self.origin + path) as answer:
            return bytes(answer.read())

    def json(self, path: str) -> Any:
        return json.loads(self.get(path))

    def peak_mb(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1024.0

    def first_picture_s(self, key: str) -> float:
        """What the page asks for until there is something on the screen, as wide as a screen is."""
        began = time.perf_counter()
        facts = self.json(f"/api/scan/{key}")
        for level in range(facts["levels"] - 1, 1, -1):
            self.get(f"/api/scan/{key}/level/{level}?first=0&last={facts['padded'][0] >> level}")
        return time.perf_counter() - began


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Viewer]:
    write_scans(tmp_path / "scans")
    running = Viewer(tmp_path / "scans", tmp_path / "cache")
    yield running
    running.stop()


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the peak of memory is read from /proc")
def test_memory_is_bounded_and_the_first_picture_soon(viewer: Viewer, capsys: pytest.CaptureFixture[str]) -> None:
    keys = [entry["key"] for entry in viewer.json("/api/list")["entries"]]
    assert len(keys) == SCANS
    first = [viewer.first_picture_s(key) for key in keys[:10]]
    for key in keys:
        viewer.get(f"/api/scan/{key}/thumbnail")
        viewer.get(f"/api/scan/{key}/level/0?first=1000&last=1512")
    after_ten_mb = viewer.peak_mb()
    for key in keys:
        viewer.first_picture_s(key)
    again = [viewer.first_picture_s(key) for key in keys[:10]]
    peak_mb = viewer.peak_mb()
    with capsys.disabled():
        sys.stdout.write(
            f"\n50 scans of 12 MP: first picture {max(first):.2f} s at worst, {max(again):.2f} s once cached; "
            f"peak of memory {after_ten_mb:.0f} MB after all were touched, {peak_mb:.0f} MB at the end\n"
        )
    assert peak_mb < MAX_MB
    assert min(first) < MAX_FIRST_S
    assert min(again) < MAX_FIRST_S
