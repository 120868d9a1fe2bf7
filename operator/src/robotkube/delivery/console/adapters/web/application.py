"""The console over HTTP: the page, what it shows (docs/reference/console-api.yaml), and signing in."""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Match, Route

from robotkube.delivery.console.adapters.web import streams
from robotkube.delivery.console.adapters.web.asking import AskedParties, TaskRequests
from robotkube.delivery.console.adapters.web.encoding import snapshot_text
from robotkube.delivery.console.adapters.web.guarding import Guard
from robotkube.delivery.console.adapters.web.page_files import PageFile, file_response
from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.adapters.web.problems import ProblemError
from robotkube.delivery.console.core import chains
from robotkube.delivery.console.core import table as kinds
from robotkube.delivery.console.core.table import resume_id, resumed_version
from robotkube.delivery.console.ports import ModelReading
from robotkube.foundation.runtime.ports import Series, by_one
from robotkube.robots.export.core.foxglove_layout import SUFFIX, recording_layout

FILES = "/{path:path}"
FILE_METHODS = ("GET", "HEAD")
COMPRESSED_BYTES_MIN = 1024
ID_CHARACTERS_MAX = 600
FILE_NAME = re.compile(r"[^A-Za-z0-9._-]")  # what an agent calls its recordings is not believed to be a name of a file
JSON = "application/json"
FRESH = {"Cache-Control": "no-store"}
PREFIX = "robotkube_console_"


@dataclass(frozen=True)
class ConsoleSurroundings:
    """What is around the model: names by which browsers come, whether by TLS, addresses of other pages, the page's
    files."""

    hosts: Collection[str]
    encrypted: bool = False
    links: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, PageFile] = field(default_factory=dict)


class Console:
    """The application (`app`, ASGI) over a model."""

    def __init__(
        self, model: ModelReading, people: People, asking: AskedParties, surroundings: ConsoleSurroundings
    ) -> None:
        self._model = model
        self._people = people
        self._requests = TaskRequests(people, asking)
        self._around = surroundings
        self._answers: Counter[str] = Counter()
        self.streams = streams.Streams(model, time.monotonic)
        guard = Middleware(Guard, surroundings.hosts, surroundings.encrypted, self._count)
        self.app = Starlette(
            routes=list(self._routes()),
            middleware=[guard, Middleware(GZipMiddleware, minimum_size=COMPRESSED_BYTES_MIN, compresslevel=5)],
            exception_handlers={ProblemError: _refused, HTTPException: _refused_by_path},
        )

    def _routes(self) -> list[Route]:
        lists = {"/api/tasks": kinds.TASKS, "/api/agents": kinds.AGENTS, "/api/catalogue": kinds.CATALOGUE}
        return [
            Route("/healthz", self._health),
            Route("/api/session", self._session),
            Route("/api/snapshot", self._snapshot),
            Route("/api/changes", self._changes),
            Route("/api/events", self._events),
            Route("/api/why/{kind}/{id:path}", self._why),
            Route("/api/recordings/{agent}/{recording}/layout", self._layout),
            *(Route(path, self._list(kind)) for path, kind in lists.items()),
            *self._requests.routes(),
            Route("/auth/login", self._people.login),
            Route("/auth/callback", self._people.callback),
            Route("/auth/logout", self._people.logout, methods=["POST"]),
            Route(FILES, self._file),
        ]

    async def _health(self, request: Request) -> Response:
        return PlainTextResponse("ok\n")

    async def _session(self, request: Request) -> Response:
        return JSONResponse(self._people.described(request), headers=FRESH)

    async def _snapshot(self, request: Request) -> Response:
        self._people.check_reading(request)
        model = self._model
        links = {"forge": "", "argocd": "", **self._around.links}
        text = snapshot_text(model.whole(), model.epoch, model.now_ms(), links)
        return Response(text, media_type=JSON, headers=FRESH)

    async def _changes(self, request: Request) -> Response:
        self._people.check_reading(request)
        version = resumed_version(_after(request), self._model.epoch)
        change = None if version is None else self.streams.change(version)
        if change is None:
            raise ProblemError(410, "Read a snapshot", streams.STALE)
        reached, text = change
        empty = {"id": resume_id(self._model.epoch, reached), "version": reached, "time_ms": self._model.now_ms()}
        return Response(text or json.dumps({**empty, "set": {}, "gone": {}}), media_type=JSON, headers=FRESH)

    async def _events(self, request: Request) -> Response:
        self._people.check_reading(request)
        source = request.client.host if request.client else ""
        if not self.streams.has_place(source):
            detail = "Close other windows of the console, or poll /api/changes."
            raise ProblemError(429, "Too many open streams", detail, streams.HEARTBEAT_SECONDS)
        after = request.headers.get("last-event-id") or _after(request)
        version = resumed_version(after, self._model.epoch)
        events = self.streams.events(version, source, lambda: self._people.may_read(request))
        return StreamingResponse(events, headers=streams.HEADERS)

    async def _why(self, request: Request) -> Response:
        self._people.check_reading(request)
        kind, wanted = request.path_params["kind"], request.path_params["id"]
        if kind not in chains.WHY_KINDS or not 0 < len(wanted) <= ID_CHARACTERS_MAX:
            raise ProblemError(404, "No such kind", f"There are chains of {', '.join(chains.WHY_KINDS)}.")
        view = self._model.view()
        matches = chains.find_of(kind, wanted, view)
        if not matches:
            detail = f"Nothing is known of {kind} {wanted[:200]} (any more): `robotkube audit` reads what Git keeps."
            raise ProblemError(404, "Not known", detail)
        steps = [step.as_json() for step in chains.steps(matches, view)]
        title = next((step["text"] for step in steps if step["step"] == chains.EVENT), wanted)
        document: dict[str, Any] = {"kind": kind, "id": wanted, "title": title, "time_ms": self._model.now_ms()}
        return JSONResponse({**document, "steps": steps}, headers=FRESH)

    async def _layout(self, request: Request) -> Response:
        self._people.check_reading(request)
        key = f"{request.path_params['agent']}/{request.path_params['recording']}"
        recording = self._model.documents(kinds.RECORDINGS).get(key)
        if recording is None:
            detail = (
                f"No recorder told of {key[:200]} since this console began; `robotkube recording export` writes one."
            )
            raise ProblemError(404, "Not known", detail)
        layout = recording_layout(topic["topic"] for topic in recording["topics"])
        name = FILE_NAME.sub("_", recording["recording"])[:200]
        headers = {**FRESH, "Content-Disposition": f'attachment; filename="{name}{SUFFIX}"'}
        return JSONResponse(layout, headers=headers)

    def _list(self, kind: str) -> Any:
        async def listed(request: Request) -> Response:
            self._people.check_reading(request)
            return JSONResponse(dict(self._model.documents(kind)), headers=FRESH)

        return listed

    async def _file(self, request: Request) -> Response:
        path = request.scope["path"]  # not of its URL, which the header Host is a part of
        file = self._around.files.get(path)
        if file is None and _own_routes(request):
            raise HTTPException(405)  # an address of another method alone
        if file is None:
            what = "The page is not part of this image" if not self._around.files else "There is no such page"
            raise ProblemError(404, "Not found", f"{what}; what it shows is at /api/snapshot.")
        return file_response(file, path, request)

    def _count(self, status: int) -> None:
        self._answers[f"{status // 100}xx"] += 1

    def metrics(self) -> list[Series]:
        """What was answered, and who reads."""
        answers = by_one({status: float(count) for status, count in self._answers.items()})
        open_streams, resyncs = float(self.streams.wakeups.count), float(self.streams.resyncs)
        return [
            Series(f"{PREFIX}answers_total", "counter", "Answers by kind of status.", answers, ("status",)),
            Series(f"{PREFIX}streams", "gauge", "Open streams of events.", {(): open_streams}),
            Series(f"{PREFIX}resyncs_total", "counter", "Readers sent to a snapshot.", {(): resyncs}),
        ]


def _after(request: Request) -> str:
    after = request.query_params.get("after")
    if after is None:
        raise ProblemError(400, "No `after`", "Give the id of a snapshot or of a change in the query `after`.")
    return after


async def _refused(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, ProblemError)
    return problem.response()


async def _refused_by_path(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, HTTPException)
    detail = f"{request.method} {request.scope['path'][:200]}"
    response = ProblemError(problem.status_code, problem.detail, detail).response()
    if problem.status_code == 405:
        methods = {method for route in _own_routes(request) for method in route.methods or ()}
        response.headers["Allow"] = ", ".join(sorted(methods or FILE_METHODS))
    return response


def _own_routes(request: Request) -> list[Route]:
    """The routes of a request's address, whatever the method: several may have some. None of a file's."""
    routes = [route for route in request.app.routes if isinstance(route, Route) and route.path != FILES]
    return [route for route in routes if route.matches(request.scope)[0] is not Match.NONE]
