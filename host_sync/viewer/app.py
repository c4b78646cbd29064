"""The viewer's web application: routes, and how their arguments are read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields
from datetime import date
from importlib.resources import files
from typing import Any, Final, TypeVar

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from device.errors import DeviceError
from host_sync.errors import HostError, ViewError
from host_sync.library_index import Query
from host_sync.viewer.access import Access, AccessCheck, refused
from host_sync.viewer.answers import (
    binary_answer,
    entry_facts,
    json_answer,
    level_answer,
    profile_csv,
    profile_facts,
    readable,
)
from host_sync.viewer.catalogue import Wanted
from host_sync.viewer.desk import Desk
from host_sync.viewer.palettes import palettes
from host_sync.viewer.profile import Line

MEDIA: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
LONGEST_TEXT: Final = 200
_DAYS: Final = ("since", "until")

NumberT = TypeVar("NumberT", int, float, date)


def make_app(desk: Desk, access: Access) -> Starlette:
    """The application that shows what is on the desk to whoever has access."""
    pages = _page_files()

    async def file(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in pages:
            return refused("There is no such page here: go back to the list.", 404)
        data, media, tag = pages[name]
        kept = request.headers.get("if-none-match") == tag
        headers = {"Cache-Control": "no-cache", "ETag": tag}
        return Response(status_code=304, headers=headers) if kept else Response(data, media_type=media, headers=headers)

    routes = [
        Route("/", file),
        Route("/page/{name:path}", file),
        Route("/api/list", _answering(lambda request: _list(desk, request))),
        Route("/api/palettes", _answering(lambda _: json_answer(palettes()))),
        Route("/api/scan/{key}", _answering(lambda request: _facts(desk, request))),
        Route("/api/scan/{key}/thumbnail", _answering(lambda request: _thumbnail(desk, request))),
        Route("/api/scan/{key}/frame", _answering(lambda request: _frame(desk, request))),
        Route("/api/scan/{key}/sigma", _answering(lambda request: _sigma(desk, request))),
        Route("/api/scan/{key}/level/{level:int}", _answering(lambda request: _level(desk, request))),
        Route("/api/scan/{key}/height", _answering(lambda request: _height(desk, request))),
        Route("/api/scan/{key}/profile", _answering(lambda request: _profile(desk, request))),
        Route("/api/compare", _answering(lambda request: _compare(desk, request)), methods=["POST"]),
    ]

    async def not_found(_request: Request, _error: Exception) -> Response:
        return refused("There is no such page here: go back to the list.", 404)

    return Starlette(
        routes=routes, middleware=[Middleware(AccessCheck, access=access)], exception_handlers={404: not_found}
    )


def _answering(answer: Callable[[Request], Response]) -> Callable[[Request], Any]:
    """Run a handler in a thread; what it refuses becomes one sentence in JSON."""

    def guarded(request: Request) -> Response:
        try:
            return answer(request)
        except (HostError, DeviceError) as error:
            status = 404 if isinstance(error, LookupError) else 400
            told = json_answer({"error": readable(str(error))})
            told.status_code = status
            return told

    async def handler(request: Request) -> Response:
        return await run_in_threadpool(guarded, request)

    return handler


def _list(desk: Desk, request: Request) -> Response:
    asked = request.query_params
    texts: dict[str, Any] = {}
    for name in (part.name for part in fields(Query)):
        text = asked.get(name, "")[:LONGEST_TEXT].strip()
        if text and name in _DAYS:
            texts[name] = _number(text, date.fromisoformat, name)
        elif text:
            texts[name] = text if name == "verdict" else f"*{_literal(text)}*"
    wanted = Wanted(Query(**texts), tuple(asked.get("q", "")[:LONGEST_TEXT].split()))
    listing = desk.catalogue.list(wanted)
    entries, complaints = [], list(listing.complaints)
    for entry in listing.entries:
        try:
            entries.append(entry_facts(entry))
        except ViewError as error:
            complaints.append(str(error))
    only = desk.catalogue.only
    return json_answer(
        {
            "root": readable(str(desk.catalogue.root)),
            "is_library": desk.catalogue.is_library,
            "only": only.key if only else None,
            "entries": entries,
            "complaints": [readable(words) for words in complaints],
        }
    )


def _literal(text: str) -> str:
    """A text in which only * and ? are patterns; SQLite's GLOB knows brackets too."""
    return text.replace("[", "[[]")


def _facts(desk: Desk, request: Request) -> Response:
    entry = desk.catalogue.find(_key(request))
    return json_answer(entry_facts(entry) | desk.facts(entry.key))


def _thumbnail(desk: Desk, request: Request) -> Response:
    return _picture(desk.thumbnail(_key(request)), "image/webp")


def _frame(desk: Desk, request: Request) -> Response:
    return _picture(desk.frame(_key(request)), "image/jpeg")


def _picture(data: bytes, media: str) -> Response:
    return Response(data, media_type=media, headers={"Cache-Control": "private, max-age=3600"})


def _sigma(desk: Desk, request: Request) -> Response:
    found = desk.sigma(_key(request))
    return binary_answer(found.tobytes(), {"Rows": found.shape[0], "Columns": found.shape[1]})


def _level(desk: Desk, request: Request) -> Response:
    asked = request.query_params
    first, last = (_number(asked.get(name, ""), int, name) for name in ("first", "last"))
    return level_answer(desk.level(_key(request), _page(request), int(request.path_params["level"]), first, last))


def _height(desk: Desk, request: Request) -> Response:
    row, column = (_number(request.query_params.get(name, ""), int, name) for name in ("row", "column"))
    return json_answer({"z_um": desk.height(_key(request), _page(request), row, column)})


def _profile(desk: Desk, request: Request) -> Response:
    names = ("row_0", "column_0", "row_1", "column_1")
    line = Line(*(_number(request.query_params.get(name, ""), float, name) for name in names))
    entry = desk.catalogue.find(_key(request))
    found = desk.profile(entry.key, _page(request), line)
    if request.query_params.get("form") == "csv":
        return profile_csv(found, entry)
    return json_answer(profile_facts(found, entry))


def _compare(desk: Desk, request: Request) -> Response:
    asked = request.query_params
    return json_answer(entry_facts(desk.compare(asked.get("first", ""), asked.get("second", ""))))


def _key(request: Request) -> str:
    return str(request.path_params["key"])


def _page(request: Request) -> int:
    return _number(request.query_params.get("page", "0"), int, "page")


def _number(text: str, read: Callable[[str], NumberT], name: str) -> NumberT:
    try:
        return read(text)
    except ValueError as error:
        raise ViewError(f"{name}: is not what it should be: load the page again") from error


def _page_files() -> dict[str, tuple[bytes, str, str]]:
    """The page's own files by name, with kind and tag; nothing else of the disk can be asked for."""
    folder = files("host_sync.viewer") / "page"
    found = {}
    for place in (folder, folder / "vendor"):
        prefix = "vendor/" if place != folder else ""
        for one in place.iterdir():
            suffix = one.name[one.name.rfind(".") :]
            if one.is_file() and suffix in MEDIA:
                data = one.read_bytes()
                found[prefix + one.name] = (data, MEDIA[suffix], f'"{hashlib.sha256(data).hexdigest()[:32]}"')
    return found
