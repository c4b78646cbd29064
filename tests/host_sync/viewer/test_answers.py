"""What is served, and to whom: over a real socket, without a browser."""

import csv
import io
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from host_sync.viewer.access import Access


def test_a_link_opens_the_page_and_its_code_leaves_the_address(served: Any) -> None:
    path = served.access.link.removeprefix(served.origin)
    status, headers, _ = served.ask(path)
    assert (status, headers["location"]) == (303, "/")
    assert served.access.token not in path
    assert served.access.code not in headers["set-cookie"]
    assert served.ask(path)[0] == 303
    assert served.json("/api/link") == {"link": served.access.link}
    assert "HttpOnly" in headers["set-cookie"]
    assert "SameSite=strict" in headers["set-cookie"]
    assert served.get("/")[0] == 200


@pytest.mark.parametrize("path", ["/", "/page/main.js", "/api/list", "/api/scan/x", "/?code=wrong", "/?code=%ff"])
def test_without_the_token_nothing_is_answered(served: Any, path: str) -> None:
    status, headers, body = served.ask(path)
    assert status == 403
    assert "set-cookie" not in headers
    assert b"retrosync view" in body


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:{port}",
        "127.0.0.1:1",
        "127.0.0.1",
        "",
        "localhost.evil.example:{port}",
        "127.0.0.1:{port}",
        "localhost:{port}",
        "[::1]:{port}",
        "other.localhost:{port}",
    ],
)
def test_another_host_is_refused_even_with_the_token(served: Any, host: str) -> None:
    asked = host.format(port=served.access.port)
    assert served.ask("/", Host=asked, Cookie=served.cookie)[0] == 421


def test_another_page_may_not_ask(served: Any) -> None:
    for site in ("cross-site", "same-site"):
        assert served.ask("/api/list", Cookie=served.cookie, Sec_Fetch_Site=site)[0] == 403
    assert served.ask("/api/list", Cookie=served.cookie, Sec_Fetch_Site="same-origin")[0] == 200


@pytest.mark.parametrize("path", ["/", "/page/main.js", "/api/list", "/api/scan/none", "/nowhere"])
def test_every_answer_carries_the_strict_headers(served: Any, path: str) -> None:
    _, headers, _ = served.get(path)
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize(
    "path",
    [
        "/page/../access.py",
        "/page/%2e%2e/access.py",
        "/page/..%2f..%2f..%2fpyproject.toml",
        "/page/vendor/../../app.py",
        "/page//etc/passwd",
        "/page/vendor",
        "/page/style.css%00.js",
        "/api/scan/..%2f..%2fetc/thumbnail",
        "/api/scan/hill/thumbnail",
    ],
)
def test_nothing_but_what_is_offered_can_be_asked_for(served: Any, path: str) -> None:
    status, _, body = served.get(path)
    assert status == 404
    assert b"root:" not in body
    assert b"import" not in body


@pytest.mark.parametrize(
    "query",
    [
        "level/0?first=0&last=1",
        "level/0?first=0&last=9999",
        "level/99?first=0&last=2",
        "level/1?first=5&last=2",
        "level/1?first=x&last=2",
        "level/1",
        "level/1?first=0&last=2&page=7",
        "height?row=-1&column=0",
        "height?row=1e9&column=0",
        "profile?row_0=0&column_0=0&row_1=nan&column_1=3",
        "profile?row_0=0",
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(served: Any, query: str) -> None:
    status, headers, body = served.get(f"/api/scan/{served.keys()['hill']}/{query}")
    assert status in (400, 404)
    assert headers["content-type"] == "application/json"
    assert b"error" in body


def test_a_level_is_half_floats_then_bytes(served: Any, results: Path) -> None:
    key = served.keys()["hill"]
    facts = served.json(f"/api/scan/{key}")
    _, headers, body = served.get(f"/api/scan/{key}/level/0?first=20&last=40")
    rows, columns = int(headers["x-rows"]), int(headers["x-columns"])
    assert (rows, columns) == (20, facts["padded"][1])
    assert len(body) == rows * columns * 9
    half = struct.unpack("<4e", body[8 * 30 : 8 * 31])
    z_um = tifffile.imread(results / "hill" / "height_um.tif")
    assert half[2] + half[3] == pytest.approx(z_um[20, 30], rel=1e-6)


def test_the_table_of_a_profile_is_the_array(served: Any, results: Path) -> None:
    key = served.keys()["hill"]
    _, headers, body = served.get(f"/api/scan/{key}/profile?row_0=160&column_0=5&row_1=160&column_1=200&form=csv")
    assert "attachment" in headers["content-disposition"]
    table = list(csv.DictReader(io.StringIO(body.decode())))
    z_um = tifffile.imread(results / "hill" / "height_um.tif")[160, 5:201]
    written = [float(line["height_um"]) if line["height_um"] else np.nan for line in table]
    np.testing.assert_allclose(written, z_um, rtol=1e-7)
    assert float(table[0]["height_sigma_um"]) == pytest.approx(1.5)


def test_an_error_common_to_both_ends_leaves_their_difference(served: Any) -> None:
    told = served.json(f"/api/scan/{served.keys()['hill']}/profile?row_0=9&column_0=5&row_1=9&column_1=200")
    assert told["sigma_um"][0] == pytest.approx(1.5)
    assert told["step_sigma_um"] == pytest.approx(0.0, abs=1e-6)


def test_compare_says_shift_and_residual_and_can_be_opened(served: Any) -> None:
    keys = served.keys()
    found = served.json(f"/api/compare?first={keys['hill']}&second={keys['moved']}", "POST")
    assert found["record"]["shift_um"] == pytest.approx([48.0, -84.0], abs=2.0)
    assert found["record"]["residual_um"] < 1.0
    assert found["record"]["agreement_share"] > 0.9
    assert "height_sigma_median_um" not in found["record"]  # one of the two states no ±
    assert served.json(f"/api/scan/{found['key']}")["kind"] == "difference"
    again = served.json(f"/api/compare?first={keys['hill']}&second={keys['moved']}", "POST")
    assert again == found
    assert served.get(f"/api/compare?first={keys['hill']}&second={keys['hill']}", "POST")[0] == 404
    assert served.get(f"/api/compare?first={keys['hill']}&second={keys['moved']}")[0] == 405


def test_a_page_that_is_kept_is_not_sent_again(served: Any) -> None:
    _, headers, _ = served.get("/page/main.js")
    status, _, body = served.ask("/page/main.js", Cookie=served.cookie, If_None_Match=headers["etag"])
    assert (status, body) == (304, b"")
    assert served.ask("/page/main.js", If_None_Match=headers["etag"])[0] == 403


def test_thumbnails_are_pictures(served: Any) -> None:
    for key in served.keys().values():
        status, headers, body = served.get(f"/api/scan/{key}/thumbnail")
        assert (status, headers["content-type"]) == (200, "image/webp")
        assert body[8:12] == b"WEBP"


def test_the_overview_of_a_calibration_is_shown_where_there_is_one(served: Any, results: Path) -> None:
    key = served.keys()["hill"]
    assert not served.json(f"/api/scan/{key}")["has_calibration_overview"]
    status, _, body = served.get(f"/api/scan/{key}/calibration")
    assert status in range(400, 500)
    assert b"has no overview" in body
    folder = results / "calibration"
    folder.mkdir()
    (folder / "report.json").write_text('{"calibration_id": ""}')
    (folder / "overview.png").write_bytes(b"\x89PNG a picture")
    assert served.json(f"/api/scan/{key}")["has_calibration_overview"]
    status, headers, body = served.get(f"/api/scan/{key}/calibration")
    assert (status, headers["content-type"], body) == (200, "image/png", b"\x89PNG a picture")
    shutil.rmtree(folder)


def test_a_page_of_a_video_is_its_own(served: Any) -> None:
    key = served.keys()["a film"]
    heights = [served.json(f"/api/scan/{key}/height?row=3&column=4&page={page}")["z_um"] for page in (0, 4)]
    assert heights[1] - heights[0] == pytest.approx(40.0, abs=1e-3)


@pytest.mark.parametrize(
    ("host", "header", "known"),
    [
        ("127.0.0.1", "abc.localhost:80", True),
        ("127.0.0.1", "localhost:80", False),
        ("127.0.0.1", "[::1]:80", False),
        ("127.0.0.1", "192.168.1.4:80", False),
        ("0.0.0.0", "192.168.1.4:80", True),  # noqa: S104
        ("0.0.0.0", "scanner.example:80", False),  # noqa: S104
        ("scanner.local", "scanner.local:80", True),
        ("127.0.0.1", "ABC.localhost", True),
    ],
)
def test_on_loopback_only_the_random_name_is_known_and_else_addresses_and_the_named_host(
    host: str, header: str, known: bool
) -> None:
    assert Access(host, 80, random_name="abc").knows_host(header) is known


def test_the_mark_that_browsers_ask_for_on_their_own_is_there(served: Any) -> None:
    status, headers, _ = served.get("/favicon.ico")
    assert (status, headers["location"]) == (301, "/page/mark.svg")
    assert served.get(headers["location"])[0] == 200
