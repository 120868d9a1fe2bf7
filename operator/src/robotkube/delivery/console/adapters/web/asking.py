"""Asking for tasks over HTTP: what would become of one, asking for it, and taking it back, in the name of who asks."""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from robotkube.delivery.console.adapters.web.people import People
from robotkube.delivery.console.adapters.web.problems import ProblemError
from robotkube.delivery.console.core.asking import ApplicationRequest, read_request
from robotkube.delivery.console.core.rate_limits import RateLimits, RequestRate
from robotkube.delivery.console.ports import ManagerPages, PeoplesTasks, WhatIf
from robotkube.errors import InputError, RefusalError, RobotKubeError
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import NAME, TASK
from robotkube.foundation.documents.core.times import time_text

BODY_BYTES_MAX = 64 * 1024
JSON = "application/json"
FRESH = {"Cache-Control": "no-store"}
WRITES = RequestRate(burst=10, per_second=0.2)
QUESTIONS = RequestRate(burst=20, per_second=0.5)
RETRY_SECONDS = 5.0
PREVIEWED = "preview"  # the name of a task that is only thought of

T = TypeVar("T")
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AskedParties:
    """Whom to ask: the managers, of which the one answers whose namespace it is unless another is named; what they
    answer; and who writes."""

    managers: Sequence[ManagerPages]
    what_if: WhatIf
    tasks: PeoplesTasks


class TaskRequests:
    """The requests about tasks of one console."""

    def __init__(self, people: People, asking: AskedParties, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._people = people
        self._asking = asking
        self._monotonic = monotonic
        self._questions, self._writes = RateLimits(QUESTIONS), RateLimits(WRITES)

    def routes(self) -> list[Route]:
        """Their addresses."""
        return [
            Route("/api/explain", self._explain, methods=["POST"]),
            Route("/api/tasks", self._submit, methods=["POST"]),
            Route("/api/tasks/{namespace}/{name}", self._withdraw, methods=["DELETE"]),
        ]

    async def _explain(self, request: Request) -> Response:
        asker = self._people.asker(request)
        self._slow_down(self._questions, asker)
        document = await _body(request)
        withdrawn = isinstance(document, dict) and document.keys() >= {"withdraw"}
        question, namespace, name = _withdrawal(document) if withdrawn else _task(_request_in(document), asker)
        url = self._manager(namespace, name).url
        answer = await _answered(lambda: self._asking.what_if.ask(f"{url}/explain", question))
        return JSONResponse(dict(answer), headers=FRESH)

    async def _submit(self, request: Request) -> Response:
        person = self._people.writer(request)
        self._slow_down(self._writes, person.name)
        asked = _request_in(await _body(request))
        group = self._people.group(person, asked.namespace)
        name = asked.name(secrets.token_hex(3))
        document = asked.document(name, person.name, time_text(time.time_ns()))
        key = f"{asked.namespace}/{name}"
        made = await _answered(lambda: self._asking.tasks.submit(person, group, document))
        if not made:
            raise ProblemError(409, "There is a task of this name", f"{key} is there already; ask again.")
        log.info("task submitted task=%s user=%s group=%s", key, person.name, group)
        return JSONResponse({"task": key}, 201, headers=FRESH)

    async def _withdraw(self, request: Request) -> Response:
        person = self._people.writer(request)
        self._slow_down(self._writes, person.name)
        namespace, name = request.path_params["namespace"], request.path_params["name"]
        key = f"{namespace}/{name}"
        if not TASK.fullmatch(key):
            raise ProblemError(404, "No such task", f"{key[:200]!r} is no name of a task.")
        group = self._people.group(person, namespace)
        if not await _answered(lambda: self._asking.tasks.withdraw(person, group, namespace, name)):
            raise ProblemError(404, "No such task", f"There is no task {key} (any more).")
        log.info("task withdrawn task=%s user=%s group=%s", key, person.name, group)
        return Response(status_code=204)

    def _slow_down(self, limits: RateLimits, who: str) -> None:
        wait = limits.wait_seconds(who, self._monotonic())
        if wait:
            raise ProblemError(429, "Too many requests", "Wait a moment, then ask again.", wait)

    def _manager(self, namespace: str, name: str) -> ManagerPages:
        """The manager of a name, or of a namespace where none is given."""
        managers = self._asking.managers
        fits = [manager for manager in managers if (manager.name == name if name else manager.answers(namespace))]
        if fits:
            return fits[0]
        names = ", ".join(manager.name for manager in managers) or "none"
        if name:
            raise ProblemError(422, "No such manager", f"Name one of {names} in `manager`, or none.")
        raise ProblemError(422, "Nobody answers there", f"No manager answers tasks in {namespace}; there are: {names}.")


def _withdrawal(document: Mapping[str, Any]) -> tuple[Mapping[str, Any], str, str]:
    """The question, the task's namespace, and the manager that is named."""
    key = document["withdraw"]
    if not isinstance(key, str) or not TASK.fullmatch(key) or document.keys() - {"withdraw", "manager"}:
        raise ProblemError(
            422, "No question", "Give <namespace>/<name> in `withdraw`, and nothing but `manager` besides."
        )
    manager = document.get("manager")
    if "manager" in document and not (isinstance(manager, str) and NAME.fullmatch(manager)):
        raise ProblemError(422, "No question", "Give the name of a manager in `manager`, or leave it out.")
    return {"withdraw": key}, key.partition("/")[0], manager or ""


def _task(asked: ApplicationRequest, asker: str) -> tuple[Mapping[str, Any], str, str]:
    document = asked.document(asked.name(PREVIEWED), asker, time_text(time.time_ns()))
    return document, asked.namespace, asked.manager


def _request_in(document: Any) -> ApplicationRequest:
    try:
        return read_request(document)
    except InputError as error:
        raise ProblemError(422, "No request for a task", str(error)[:2000]) from error


async def _body(request: Request) -> Any:
    """The JSON document of a request. Its type has to be named: a page of somebody else cannot send one that is, unless
    this console says that it may, which it never does."""
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != JSON:
        raise ProblemError(415, "No JSON", f"Send the request as {JSON}.")
    data = b""
    async for part in request.stream():
        data += part
        if len(data) > BODY_BYTES_MAX:
            raise ProblemError(413, "Too large", f"A request has at most {BODY_BYTES_MAX} bytes.")
    try:
        return read_json(data)
    except ValueError as error:
        raise ProblemError(400, "No JSON", f"The request cannot be read: {str(error)[:200]}") from error


async def _answered(ask: Callable[[], T]) -> T:
    """What API server or manager answer, on another thread; their refusals in their words."""
    try:
        return await run_in_threadpool(ask)
    except RefusalError as error:
        raise ProblemError(403, "The API server refuses it", error.message[:2000]) from error
    except InputError as error:
        raise ProblemError(422, "It cannot be asked for", str(error)[:2000]) from error
    except RobotKubeError as error:
        raise ProblemError(503, "Nobody answers now", str(error)[:2000], RETRY_SECONDS) from error
