"""One broken scan in a library: it is named, and every route answers for the other scans."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from device.bundles.scan import ScanBundle

MUTATIONS = 40
ROUTES = (
    "",
    "/thumbnail",
    "/level/0?first=0&last=4",
    "/height?row=3&column=4",
    "/profile?row_0=0&column_0=0&row_1=9&column_1=9",
)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with up to 16 of them changed near the beginning or the end, or cut off."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 17))):
        reach = min(400, len(changed))
        place = int(rng.integers(0, reach))
        changed[place if rng.random() < 0.5 else len(changed) - 1 - place] = int(rng.integers(0, 256))
    return bytes(changed[: int(rng.integers(1, len(changed)))] if rng.random() < 0.3 else changed)


@pytest.mark.parametrize(
    ("broken", "name"),
    [
        (2, "quick-look-um.tif"),
        (0, "results/0.1.0-abc/height_um.tif"),
        (0, "results/0.1.0-abc/height_sigma_um.tif"),
        (0, "results/0.1.0-abc/height_draws_um.tif"),
        (0, "results/0.1.0-abc/result.json"),
    ],
)
def test_every_route_answers_for_the_other_scans(
    library: tuple[Path, list[ScanBundle]], serve: Callable[..., Any], broken: int, name: str
) -> None:
    """The broken scan itself is answered with a sentence or with what is left of it, never with a failure (500)."""
    root, scans = library
    served = serve(root)
    keys = {entry["scan_id"]: entry["key"] for entry in served.json("/api/list")["entries"]}
    path = root / "scans" / scans[broken].scan_id / name
    whole = path.read_bytes()
    rng = np.random.default_rng(broken)
    for number in range(MUTATIONS):
        path.write_bytes(mutated(whole, rng))
        os.utime(path, (number, number))
        listed = served.json("/api/list")
        found = {entry["scan_id"]: entry["key"] for entry in listed["entries"]}
        others = {scan_id: key for scan_id, key in keys.items() if scan_id != scans[broken].scan_id}
        assert others.items() <= found.items()
        assert len(found) + len(listed["complaints"]) >= len(scans)
        for key in others.values():
            for route in ROUTES:
                assert served.get(f"/api/scan/{key}{route}")[0] == 200
        for route in (*ROUTES, "/sigma", "/frame"):
            assert served.get(f"/api/scan/{keys[scans[broken].scan_id]}{route}")[0] in (200, 400, 404)


@pytest.mark.parametrize("broken", ["a folder", "a pipe", "a link to itself", "larger than the frame", "compressed"])
def test_a_quick_look_that_cannot_be_read_is_named(
    library: tuple[Path, list[ScanBundle]], serve: Callable[..., Any], broken: str
) -> None:
    root, scans = library
    path = root / "scans" / scans[2].scan_id / "quick-look-um.tif"
    path.unlink()
    flat = np.zeros((6, 8), np.float32)
    if broken == "a folder":
        path.mkdir()
    elif broken == "a pipe":
        os.mkfifo(path)
    elif broken == "a link to itself":
        path.symlink_to(path)
    elif broken == "larger than the frame":
        tifffile.imwrite(path, np.zeros((700, 900), np.float32))
    else:
        tifffile.imwrite(path, flat, compression="zlib")
    listed = serve(root).json("/api/list")
    assert {entry["scan_id"] for entry in listed["entries"]} == {scan.scan_id for scan in scans[:2]}
    (sentence,) = listed["complaints"]
    assert scans[2].scan_id in sentence
