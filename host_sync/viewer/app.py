"""The viewer's web application: routes and their arguments."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from device.errors import DeviceError
from host_sync.errors import HostError, RegistrationRefused, ViewError
from host_sync.library.index import Query
from host_sync.library.labels import Label, label_scan
from host_sync.library.library import Library
from host_sync.render.shading import palettes
from host_sync.viewer.access import Access, AccessCheck, refused
from host_sync.viewer.catalogue import Catalogue, ListFilter
from host_sync.viewer.entry import Entry, relabelled
from host_sync.viewer.responses import (
    binary_answer,
    entry_info,
    json_answer,
    level_answer,
    profile_csv,
    profile_info,
    readable,
)
from host_sync.viewer.service import NearPose, ViewerService

if TYPE_CHECKING:
    from host_sync.viewer.live import LiveView

NO_LIBRARY: Final = "only scans of a library have a label: pull them into one"


class _LabelRequest(msgspec.Struct, forbid_unknown_fields=True):
    """The whole label as the page has it now, and as it loaded it."""

    name: str
    tags: list[str]
    note: str
    loaded: Label


def change_label(catalogue: Catalogue, key: str, body: bytes) -> Entry:
    """Write the label of a request into the library's `labels.json`, and return the entry with it.

    Scans themselves stay as they are.

    Raises
    ------
    ViewError
        The entry is of no library, or the request is not valid.
    LibraryError
        The label was changed since the page loaded it, a text is too long, a tag has a blank or comma, or the library
        cannot be written.
    """
    entry = catalogue.find(key)
    if entry.hit is None or not catalogue.is_library:
        raise ViewError(NO_LIBRARY)
    try:
        asked = msgspec.json.decode(body, type=_LabelRequest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ViewError("the label is not valid: load the page again") from error
    library, scan_id = Library(catalogue.root), entry.hit.scan_id
    gone, loaded = set(asked.loaded.tags) - set(asked.tags), asked.loaded
    label = label_scan(library, scan_id, name=asked.name, tag=asked.tags, untag=gone, note=asked.note, loaded=loaded)
    catalogue.replace_entries(lambda one: relabelled(one, scan_id, label))
    return relabelled(entry, scan_id, label)


MEDIA: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
MAX_TEXT: Final = 200
MAX_BODY: Final = 256_000
_DAYS: Final = ("since", "until")

NumberT = TypeVar("NumberT", int, float, date)


def make_app(service: ViewerService, access: Access) -> Starlette:
    """Return the application, open to requests with access."""
    routes = [
        Route("/api/list", _answering(lambda request: _list(service, request))),
        Route("/api/link", _answering(lambda _: json_answer({"link": access.link}))),
        Route("/api/palettes", _answering(lambda _: json_answer(palettes()))),
        Route("/api/scan/{key}", _answering(lambda request: _facts(service, request))),
        Route("/api/scan/{key}/thumbnail", _picture(service.thumbnail, "image/webp")),
        Route("/api/scan/{key}/frame", _picture(service.frame, "image/jpeg")),
        Route("/api/scan/{key}/calibration", _picture(service.calibration_overview, "image/png")),
        Route("/api/scan/{key}/sigma", _answering(lambda request: _sigma(service, request))),
        Route("/api/scan/{key}/level/{level:int}", _answering(lambda request: _level(service, request))),
        Route("/api/scan/{key}/height", _answering(lambda request: _height(service, request))),
        Route("/api/scan/{key}/profile", _answering(lambda request: _profile(service, request))),
        Route(
            "/api/scan/{key}/measure", _posted(lambda request, body: _measure(service, request, body)), methods=["POST"]
        ),
        Route("/api/scan/{key}/label", _posted(lambda request, body: _label(service, request, body)), methods=["POST"]),
        Route("/api/trend", _posted(lambda _, body: _trend(body)), methods=["POST"]),
        Route("/api/compare", _answering(lambda request: _compare(service, request)), methods=["POST"]),
    ]
    return _application(routes, access)


def make_live_app(view: LiveView, access: Access) -> Starlette:
    """Return the application of a live view."""
    routes = [
        Route("/api/list", _answering(lambda _: json_answer({"only": None, "live": True, "entries": []}))),
        Route("/api/link", _answering(lambda _: json_answer({"link": access.link}))),
        Route("/api/palettes", _answering(lambda _: json_answer(palettes()))),
        *view.routes(),
    ]
    return _application(routes, access)


def _application(routes: Sequence[BaseRoute], access: Access) -> Starlette:
    """Return the page's files, and these routes, for requests with access."""
    pages = _page_files()

    async def file(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in pages:
            return refused("No such page: go back to the list.", 404)
        data, media, tag = pages[name]
        kept = request.headers.get("if-none-match") == tag
        headers = {"Cache-Control": "no-cache", "ETag": tag}
        return Response(status_code=304, headers=headers) if kept else Response(data, media_type=media, headers=headers)

    def mark(_: Request) -> Response:
        """Return a browser asks for it on the way in, before the page names its own."""
        return RedirectResponse("/page/mark.svg", 301)

    async def not_found(_request: Request, _error: Exception) -> Response:
        return refused("No such page: go back to the list.", 404)

    page = [Route("/", file), Route("/favicon.ico", mark), Route("/page/{name:path}", file)]
    return Starlette(
        routes=[*page, *routes],
        middleware=[Middleware(AccessCheck, access=access)],
        exception_handlers={404: not_found},
    )


def _answering(answer: Callable[[Request], Response]) -> Callable[[Request], Any]:
    """Run a handler in a thread; an error becomes one sentence in JSON."""

    def guarded(request: Request) -> Response:
        try:
            return answer(request)
        except (HostError, DeviceError) as error:
            status = 404 if isinstance(error, LookupError) else 400
            problem = json_answer({"error": readable(str(error))})
            problem.status_code = status
            return problem

    async def handler(request: Request) -> Response:
        return await run_in_threadpool(guarded, request)

    return handler


def _posted(answer: Callable[[Request, bytes], Response]) -> Callable[[Request], Any]:
    """Run a handler with the body of its request in a thread; an error becomes one sentence in JSON."""

    async def handler(request: Request) -> Response:
        body = bytearray()
        async for part in request.stream():
            body += part
            if len(body) > MAX_BODY:
                return refused("The request is too large: take parts of the recipe away.", 413)
        return cast(Response, await _answering(lambda one: answer(one, bytes(body)))(request))

    return handler


def _list(service: ViewerService, request: Request) -> Response:
    asked = request.query_params
    texts: dict[str, Any] = {}
    for name in (part.name for part in fields(Query)):
        text = asked.get(name, "")[:MAX_TEXT].strip()
        if text and name in _DAYS:
            texts[name] = _number(text, date.fromisoformat, name)
        elif text:
            texts[name] = text if name == "verdict" else f"*{_literal(text)}*"
    wanted = ListFilter(Query(**texts), tuple(asked.get("q", "")[:MAX_TEXT].split()))
    listing = service.catalogue.list(wanted)
    entries, complaints = [], list(listing.complaints)
    for entry in listing.entries:
        try:
            entries.append(entry_info(entry))
        except ViewError as error:  # its heights were removed just now
            complaints.append(str(error))
    only = service.catalogue.only
    return json_answer(
        {
            "root": readable(str(service.catalogue.root)),
            "is_library": service.catalogue.is_library,
            "only": only.key if only else None,
            "entries": entries,
            "complaints": [readable(words) for words in complaints],
        }
    )


def _literal(text: str) -> str:
    """Return the text with brackets escaped: SQLite's GLOB would read them as a pattern."""
    return text.replace("[", "[[]")


def _facts(service: ViewerService, request: Request) -> Response:
    entry = service.catalogue.find(_key(request))
    return json_answer(entry_info(entry) | service.facts(entry.key))


def _picture(picture: Callable[[str], bytes], media: str) -> Callable[[Request], Any]:
    """Return a handler that answers with the picture of a scan."""
    headers = {"Cache-Control": "private, max-age=3600"}
    return _answering(lambda request: Response(picture(_key(request)), media_type=media, headers=headers))


def _sigma(service: ViewerService, request: Request) -> Response:
    found = service.sigma(_key(request))
    return binary_answer(found.tobytes(), {"Rows": found.shape[0], "Columns": found.shape[1]})


def _level(service: ViewerService, request: Request) -> Response:
    asked = request.query_params
    first, last = (_number(asked.get(name, ""), int, name) for name in ("first", "last"))
    return level_answer(service.level(_key(request), _page(request), int(request.path_params["level"]), first, last))


def _height(service: ViewerService, request: Request) -> Response:
    row, column = (_number(request.query_params.get(name, ""), int, name) for name in ("row", "column"))
    doubts = [readable(words) for words in service.catalogue.find(_key(request)).doubts]
    return json_answer({"z_um": service.height(_key(request), _page(request), row, column), "doubts": doubts})


def _profile(service: ViewerService, request: Request) -> Response:
    names = ("row_0", "column_0", "row_1", "column_1")
    row_0, column_0, row_1, column_1 = (_number(request.query_params.get(name, ""), float, name) for name in names)
    entry = service.catalogue.find(_key(request))
    found = service.profile(entry.key, _page(request), (row_0, column_0, row_1, column_1))
    if request.query_params.get("form") == "csv":
        return profile_csv(found, entry)
    return json_answer(profile_info(found, entry))


def _measure(service: ViewerService, request: Request, body: bytes) -> Response:
    # The measuring engine is loaded when it is first needed, so that the list appears at once.
    from host_sync.viewer.measuring import recipe_from_page

    recipe, samples = recipe_from_page(body), request.query_params.get("samples") == "1"
    return json_answer(service.measure(_key(request), _page(request), recipe, samples=samples))


def _label(service: ViewerService, request: Request, body: bytes) -> Response:

    return json_answer(entry_info(change_label(service.catalogue, _key(request), body)))


class _TrendRequest(msgspec.Struct, forbid_unknown_fields=True):
    """A number over scans in order, with standard uncertainties, and its tolerance."""

    values: list[float | None]
    sigmas: list[float | None]
    unit: str = ""
    low: float | None = None
    high: float | None = None
    coverage_factor: int = 1
    warnings: list[list[str]] = []


def _trend(body: bytes) -> Response:
    from host_sync.measurement.trend import trend_of

    try:
        asked = msgspec.json.decode(body, type=_TrendRequest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ViewError("the numbers are not valid: load the page again") from error
    if asked.warnings and len(asked.warnings) != len(asked.values):
        raise ViewError("the numbers are not valid: load the page again")
    found = trend_of(
        asked.values,
        asked.sigmas,
        asked.low,
        asked.high,
        coverage_factor=asked.coverage_factor,
        warnings=asked.warnings,
    )
    if found is None:
        return json_answer({"text": "A trend needs two scans or more with this number."})
    return json_answer(msgspec.to_builtins(found) | {"text": found.text(asked.unit)})


def _compare(service: ViewerService, request: Request) -> Response:
    asked = request.query_params
    near = None
    if "down_um" in asked:
        down, right, turn = (
            _number(asked.get(name, "0"), _finite, name) for name in ("down_um", "right_um", "turn_deg")
        )
        near = NearPose(down, right, turn, asked.get("pinned") == "1")
    try:
        found = service.compare(asked.get("first", ""), asked.get("second", ""), near)
    except RegistrationRefused as refused:
        return json_answer({"refused": str(refused), "best": service.refused_pose(asked.get("first", ""), refused)})
    return json_answer(entry_info(found))


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _key(request: Request) -> str:
    return str(request.path_params["key"])


def _page(request: Request) -> int:
    return _number(request.query_params.get("page", "0"), int, "page")


def _number(text: str, read: Callable[[str], NumberT], name: str) -> NumberT:
    try:
        return read(text)
    except ValueError as error:
        raise ViewError(f"{name}: {text[:40]!r} is not valid: load the page again") from error


def _page_files() -> dict[str, tuple[bytes, str, str]]:
    """Return the page's own files by name, with media type and tag; no other file can be requested."""
    folder = Path(__file__).with_name("page")
    found = {}
    for one in folder.rglob("*"):
        if media := MEDIA.get(one.suffix):
            data = one.read_bytes()
            found[one.relative_to(folder).as_posix()] = (data, media, f'"{hashlib.sha256(data).hexdigest()[:32]}"')
    return found
