"""The label of a scan is changed on the page and kept by the library; scans themselves stay as they are."""

from __future__ import annotations

import http.client
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device.bundles.scan import ScanBundle
from host_sync.library.labels import Label, label_scan, read_labels
from host_sync.library.library import Library

axe = pytest.importorskip("axe_playwright_python.sync_playwright")


def post(served: Any, key: str, body: bytes, **headers: str) -> tuple[int, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", served.access.port, timeout=60)
    try:
        given = {"Host": served.origin.removeprefix("http://"), "Cookie": served.cookie} | headers
        connection.request("POST", f"/api/scan/{key}/label", body, given)
        answer = connection.getresponse()
        data = answer.read()
        return answer.status, json.loads(data) if answer.getheader("content-type") == "application/json" else data
    finally:
        connection.close()


def test_a_label_is_edited_on_the_page(
    serve: Callable[[Path], Any], library: tuple[Path, list[ScanBundle]], visit: Callable[..., Any]
) -> None:
    root, scans = library
    valve = scans[0].scan_id
    label_scan(Library(root), valve, name="old", tag=("worn", "first"), note="<b>chipped</b>")
    before = {path: path.read_bytes() for path in (root / "scans").rglob("*") if path.is_file()}
    page = visit(serve(root))
    page.get_by_role("link", name="old").first.click()
    page.wait_for_selector("canvas")
    page.get_by_text("Label", exact=True).click()
    assert page.get_by_label("Tags").input_value() == "worn first"
    assert page.get_by_label("Note").input_value() == "<b>chipped</b>"
    page.get_by_label("Name", exact=True).fill("valve 3")
    page.get_by_label("Tags").fill("first, checked")
    page.get_by_label("Note").fill("")
    page.get_by_role("button", name="Save label").click()
    page.wait_for_selector("text=Saved. Lists call it valve 3.")
    page.get_by_label("Note").fill("twice")
    page.get_by_role("button", name="Save label").click()
    page.wait_for_selector("button:enabled:has-text('Save label')")
    assert read_labels(root).scans[valve].note == "twice"
    page.get_by_label("Note").fill("")
    page.get_by_role("button", name="Save label").click()
    page.wait_for_selector("button:enabled:has-text('Save label')")
    assert read_labels(root).scans[valve] == Label(name="valve 3", tags=("first", "checked"))
    found = axe.Axe().run(page).response["violations"]
    assert [(one["id"], [node["target"] for node in one["nodes"]]) for one in found] == []
    page.go_back()
    page.wait_for_selector(".card .name:has-text('valve 3')")
    assert {path: path.read_bytes() for path in (root / "scans").rglob("*") if path.is_file()} == before


def test_a_label_without_a_name_shows_the_part_again(
    serve: Callable[[Path], Any], library: tuple[Path, list[ScanBundle]]
) -> None:
    root, scans = library
    label_scan(Library(root), scans[2].scan_id, name="plate 2")
    served = serve(root)
    key = served.keys()["plate 2"]
    status, found = post(served, key, b'{"name": "", "tags": ["seen"], "note": "", "loaded": {"name": "plate 2"}}')
    assert (status, found["title"], found["tags"]) == (200, "plate", ["seen"])
    assert served.keys()["plate"] == key


def test_a_label_that_was_changed_meanwhile_stays(
    serve: Callable[[Path], Any], library: tuple[Path, list[ScanBundle]]
) -> None:
    root, scans = library
    label_scan(Library(root), scans[2].scan_id, name="plate 2", tag=("worn",))
    served = serve(root)
    key = served.keys()["plate 2"]
    there = label_scan(Library(root), scans[2].scan_id, tag=("seen",), note="from the command line")
    asked = {"name": "mine", "tags": ["worn"], "note": "", "loaded": {"name": "plate 2", "tags": ["worn"], "note": ""}}
    status, found = post(served, key, json.dumps(asked).encode())
    assert status == 400
    assert "was changed meanwhile: load it again" in found["error"]
    assert read_labels(root).scans == {scans[2].scan_id: there}
    asked["loaded"] = {"name": there.name, "tags": there.tags, "note": there.note}
    assert post(served, key, json.dumps(asked).encode())[0] == 200
    assert read_labels(root).scans == {scans[2].scan_id: Label(name="mine", tags=("worn",))}


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{}",
        b'{"name": "", "tags": [], "note": ""}',
        b'{"name": 3, "tags": [], "note": "", "loaded": {}}',
        b'{"name": "' + b"a" * 200 + b'"}',
    ],
)
def test_what_is_no_label_is_refused(
    body: bytes, serve: Callable[[Path], Any], library: tuple[Path, list[ScanBundle]]
) -> None:
    root, _ = library
    served = serve(root)
    status, found = post(served, served.keys()["valve"], body)
    assert status == 404
    assert "label is not valid" in found["error"]
    status, found = post(
        served, served.keys()["valve"], b'{"name": "", "tags": ["two words"], "note": "", "loaded": {}}'
    )
    assert status == 400
    assert "tags[0]: is not of the accepted form: tags are words without blanks" in found["error"]
    assert read_labels(root).scans == {}


def test_results_without_a_library_and_other_sites_cannot_label(
    served: Any, serve: Callable[[Path], Any], library: tuple[Path, list[ScanBundle]]
) -> None:
    status, found = post(served, served.keys()["hill"], b'{"name": "a", "tags": [], "note": "", "loaded": {}}')
    assert status == 404
    assert "only scans of a library" in found["error"]
    root, _ = library
    other = serve(root)
    body = b'{"name": "stolen", "tags": [], "note": "", "loaded": {}}'
    status, _ = post(other, other.keys()["valve"], body, **{"Sec-Fetch-Site": "cross-site"})
    assert status != 200
    assert read_labels(root).scans == {}
