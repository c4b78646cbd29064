"""Facts for scripts: one JSON document on the output, and nothing else there."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device.bundles.scan import ScanBundle
from device.store.store import BundleStore
from host_sync.cli.main import main
from host_sync.library.library import Library
from host_sync.offload.pull import pull
from host_sync.offload.source import DirectorySource


@pytest.fixture
def library(store: BundleStore, publish_scan: Callable[..., ScanBundle], tmp_path: Path) -> Library:
    publish_scan(store)
    publish_scan(store)
    library = Library(tmp_path / "library")
    assert pull(DirectorySource(store.root), library).complete
    return library


def facts(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int = 0) -> Any:
    assert main([*arguments, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def test_list_and_search_give_scans(library: Library, capsys: pytest.CaptureFixture[str]) -> None:
    listed = facts(capsys, ["list", "--library", str(library.root)])
    assert [scan["scan_id"] for scan in listed["scans"]] == [scan.scan_id for scan in library.scans().bundles]
    assert listed["damaged"] == []
    assert facts(capsys, ["list", "--library", str(library.root), "--job", "none such"])["scans"] == []
    assert facts(capsys, ["list", "--set-aside", "--library", str(library.root)])["set_aside"] == []


def test_verify_gives_what_is_lost_and_damaged(library: Library, capsys: pytest.CaptureFixture[str]) -> None:
    whole = facts(capsys, ["verify", "--library", str(library.root)])
    assert (whole["sound"], whole["lost"], whole["damaged"]) == (2, [], [])
    victim = library.scans().bundles[0]
    raw = victim.path("raw.tif")
    raw.write_bytes(raw.read_bytes()[:-1])
    (damaged,) = facts(capsys, ["verify", "--library", str(library.root)], code=1)["damaged"]
    assert damaged["directory"].endswith(victim.scan_id)
    assert "raw.tif" in damaged["reason"]
