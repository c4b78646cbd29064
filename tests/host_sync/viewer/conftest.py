"""A viewer that really serves, over small surfaces whose every height is known."""

from __future__ import annotations

import http.client
import json
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import tifffile
from limits import join

from device.bundles.scan import Annotations, ScanBundle, ScanRecord, VerdictRecord
from device.store.store import BundleStore
from device.surface import Float32Array
from host_sync.results.field_file import write_field
from host_sync.video.reconstruct import HeightStack
from host_sync.viewer.access import Access
from host_sync.viewer.app import make_app
from host_sync.viewer.catalogue import Catalogue
from host_sync.viewer.service import ViewerService
from host_sync.viewer.serving import ConnectionLimits, listening, make_server

SHAPE = (210, 280)
PITCH_UM = 12.0
HOSTILE = '<img src=x onerror="window.stolen=1"><script>window.stolen=1</script>"\'&'


def surface(down: float = 0.0, right: float = 0.0) -> Float32Array:
    """A hill with ripples and a few bumps, seen so many pixels further down and to the right, µm."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    row, column = row - down, column - right
    hill = 90.0 * np.exp(-((row - 100.0) ** 2 + (column - 150.0) ** 2) / 60.0**2)
    bumps = 25.0 * np.exp(-((row - 60.0) ** 2 + (column - 80.0) ** 2) / 9.0**2)
    ripples = 4.0 * np.sin(column / 7.0 + np.sin(row / 19.0)) + 3.0 * np.cos(row / 11.0)
    return np.asarray(hill + bumps + ripples, np.float32)


def write_result(folder: Path, z_um: Float32Array, name: str, *, known: bool = True) -> Path:
    """A folder of results; with ± of 1.5 µm that is common to all pixels, and 0.2 µm a draw of tilt, when `known`."""
    folder.mkdir(parents=True)
    write_field(folder / "height_um.tif", z_um, PITCH_UM, "height, um")
    record: dict[str, Any] = {
        "schema": "retrograph.result/1",
        "name": name,
        "rows": z_um.shape[0],
        "columns": z_um.shape[1],
        "pixel_pitch_um": PITCH_UM,
        "warnings": [f"a warning {HOSTILE}"] if "<" in name else [],
    }
    if known:
        write_field(folder / "height_sigma_um.tif", np.full_like(z_um, 1.5), PITCH_UM, "sigma, um")
        samples = np.repeat(np.array([1.5, -1.5, 1.5, -1.5], np.float32)[:, None, None], 70, axis=1).repeat(93, axis=2)
        tifffile.imwrite(folder / "height_draws_um.tif", samples, photometric="minisblack", metadata=None)
    (folder / "result.json").write_bytes(msgspec.json.encode(record))
    return folder


def write_video(folder: Path, pages: int) -> Path:
    """A video's result whose page n is raised by 10 n µm."""
    folder.mkdir(parents=True)
    with HeightStack(folder / "heights_um.tif", SHAPE, pages, PITCH_UM, 25.0) as stack:
        for page in range(pages):
            stack.append(surface() + np.float32(10.0 * page))
    record = {
        "schema": "retrograph.sequence/1",
        "name": "a film",
        "rows": SHAPE[0],
        "columns": SHAPE[1],
        "pixel_pitch_um": PITCH_UM,
        "rate_hz": 25.0,
        "colour_range_um": [-10.0, 150.0],
        "frames": [{"page": page} for page in range(pages)],
    }
    (folder / "result.json").write_bytes(msgspec.json.encode(record))
    return folder


@pytest.fixture(scope="session")
def world() -> SimpleNamespace:
    """What the surfaces of these tests are made with."""
    return SimpleNamespace(surface=surface, write_result=write_result, SHAPE=SHAPE, PITCH_UM=PITCH_UM, HOSTILE=HOSTILE)


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results: a hill with a hole in it, the same moved, one with a hostile name, a video."""
    root = tmp_path_factory.mktemp("results")
    holed = surface()
    holed[150:170, 40:90] = np.nan
    write_result(root / "hill", holed, "hill")
    tilted = surface(4.0, -7.0) + np.linspace(0.0, 6.0, SHAPE[1], dtype=np.float32) + np.float32(3.0)
    write_result(root / "moved", tilted, "moved", known=False)
    write_result(root / "hostile <b>&", surface(), HOSTILE)
    write_video(root / "film", 5)
    return root


@dataclass(frozen=True)
class Served:
    """A viewer that answers; `get` asks as its page does, with the cookie."""

    access: Access

    @property
    def origin(self) -> str:
        return self.access.origin

    def ask(self, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body, sent as they are."""
        connection = http.client.HTTPConnection("127.0.0.1", self.access.port, timeout=30)
        try:
            connection.putrequest(method, path, skip_host=True)
            headers = {"Host": self.origin.removeprefix("http://")} | headers
            for name, value in headers.items():
                connection.putheader(name.replace("_", "-"), value)
            connection.endheaders()
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    @property
    def cookie(self) -> str:
        return f"{self.access.cookie}={self.access.token}"

    def get(self, path: str, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
        return self.ask(path, method, Cookie=self.cookie)

    def json(self, path: str, method: str = "GET") -> Any:
        status, _, body = self.get(path, method)
        assert status == 200, body
        return json.loads(body)

    def keys(self) -> dict[str, str]:
        """Keys by title."""
        return {entry["title"]: entry["key"] for entry in self.json("/api/list")["entries"]}


@pytest.fixture(scope="session")
def serve(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Path], Served]]:
    """Starts a viewer of a folder; all end with the tests."""
    running = []

    def start(root: Path, limits: ConnectionLimits | None = None) -> Served:
        service = ViewerService(Catalogue(root), tmp_path_factory.mktemp("cache"))
        listener = listening("127.0.0.1", 0)
        listeners = listener.__enter__()
        access = Access("127.0.0.1", listeners[0].getsockname()[1])
        server = make_server(make_app(service, access), limits)
        thread = threading.Thread(target=server.run, kwargs={"sockets": listeners})
        thread.start()
        running.append((server, thread, listener))
        return Served(access)

    yield start
    for server, thread, listener in running:
        server.should_exit = True
        join(thread)
        listener.__exit__(None, None, None)


@pytest.fixture(scope="session")
def served(serve: Callable[[Path], Served], results: Path) -> Served:
    """The viewer of the folder of results."""
    return serve(results)


ARGUMENTS = [
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
VIEW = {"width": 860, "height": 560}
TIMEOUT_MS = 60_000


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests in a browser, a program with a schedule of its own, fail when they fail twice; summaries name reruns."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser for a module: its event loop must not run while other modules of the process start theirs."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("chromium is not installed (make test-deps)")
    with playwright.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=program, args=ARGUMENTS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def context(browser: Any) -> Iterator[Any]:
    """A desktop's window; its cache spares each test the reading of three.js."""
    opened = browser.new_context(viewport=VIEW, reduced_motion="reduce")
    yield opened
    opened.close()


@pytest.fixture
def visit(browser: Any, context: Any) -> Iterator[Callable[..., Any]]:
    """Opens a served viewer; afterwards nothing was asked of another host and nothing was said on the console."""
    opened, problems, asked = [], [], []

    def open_page(served: Any, begin: str | None = None, **options: Any) -> Any:
        window = browser.new_context(viewport=VIEW, reduced_motion="reduce", **options) if options else context
        page = window.new_page()
        opened.append(window if options else page)
        page.set_default_timeout(TIMEOUT_MS)
        page.on("console", lambda said: problems.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("request", lambda request: asked.append((served.origin, request.url)))
        page.goto(begin or served.access.link)
        return page

    open_page.problems = problems  # type: ignore[attr-defined]
    yield open_page
    for one in opened:
        one.close()
    assert problems == []
    assert [url for origin, url in asked if not url.startswith((origin, "blob:", "data:", "file:"))] == []


@pytest.fixture
def library(
    store: BundleStore, scan_record: Callable[..., ScanRecord], tmp_path: Path
) -> tuple[Path, list[ScanBundle]]:
    """A library of three scans: two with results, one with a quick look only; one of them annotated by an enemy."""
    scans = []
    said = (
        ("J-7", "valve", "good"),
        (HOSTILE, "seal [3]", "doubtful"),
        ("J-8", "plate", "retake"),
    )
    for job, part, level in said:
        record = msgspec.structs.replace(
            scan_record(store),
            annotations=Annotations(job=job, part=part, operator="Ada"),
            verdict=VerdictRecord(level=level, reason="as pressed", figures={}),
        )

        def write(directory: Path) -> None:
            (directory / "raw.tif").write_bytes(b"raw")
            tifffile.imwrite(directory / "quick-look-um.tif", surface()[::8, ::8])

        scans.append(store.publish_scan(record, write))
    root = tmp_path / "library"
    shutil.copytree(store.root / "scans", root / "scans")
    for scan in scans[:2]:
        write_result(root / "scans" / scan.scan_id / "results" / "0.1.0-abc", surface(), scan.scan_id)
    return root, scans
