"""The suite-runner's protocol over HTTP, both of its sides.

    PUT /runs/<key>   Authorization: Bearer <token>; a request as JSON -> 200 and how the run goes
                      400 the request is wrong, 401 the token, 404 the path, 413 the size, 503 no place in the queue

The key is that of the request (`SuiteRequest.key`), so that asking again never starts a second run.
"""

from __future__ import annotations

import hmac
import logging
from collections.abc import Callable, Mapping
from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.foundation.documents.core.json_codec import read_json
from robotkube.foundation.documents.core.patterns import SUITE_RUN
from robotkube.registry.suites.core.requests import (
    SuiteProgress,
    SuiteRequest,
    progress_document,
    read_progress,
    read_request,
    request_document,
)

REQUEST_BYTES_MAX = 1024 * 1024
RUNS = "/runs/"
TIMEOUT_SECONDS = 10.0
ANSWER_BYTES_MAX = 4 << 20
PASSING = frozenset({408, 425, 429})  # besides 5xx: the runner may say otherwise later
OURS = frozenset({401, 403, 404})  # a wrong token or address: nothing that the submission can help

log = logging.getLogger(__name__)


class SuiteRunnerClient:
    """The port SuiteRunner at `url` (no slash at the end); `token` is the one that the runner knows.

    UnavailableError: no answer, an answer that cannot be read, or a refusal of this gate. InputError: the runner
    refuses this request.
    """

    def __init__(self, url: str, token: str) -> None:
        self._url = url
        self._where = f"suite-runner {url}"
        headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
        self._client = httpx.Client(
            base_url=url,
            headers=headers,
            verify=certificate_authorities(trust_env=False),
            timeout=TIMEOUT_SECONDS,
            trust_env=False,
        )

    def disconnect(self) -> None:
        """Give the connection back."""
        self._client.close()

    def run(self, request: SuiteRequest) -> SuiteProgress:
        """Ask for a run, or how it goes."""
        body = canonical_json(request_document(request))
        what = f"{self._where}: suite {request.rule.name} of {request.artefact.chart}"
        try:
            answer = self._client.put(f"{RUNS}{request.key}", content=body)
        except httpx.HTTPError as error:
            raise UnavailableError(f"{what}: {what_failed(error, self._url)}") from error
        if answer.status_code >= 500 or answer.status_code in PASSING | OURS:
            raise UnavailableError(f"{what}: {answer.status_code} {_words(answer)}")
        if answer.is_error:
            raise InputError(f"{what}: {answer.status_code} {_words(answer)}")
        return self._read(answer, what)

    @staticmethod
    def _read(answer: httpx.Response, what: str) -> SuiteProgress:
        if len(answer.content) > ANSWER_BYTES_MAX:
            raise UnavailableError(f"{what}: answered {len(answer.content)} bytes, at most {ANSWER_BYTES_MAX}")
        try:
            return read_progress(read_json(answer.content))
        except (InputError, ValueError) as error:
            raise UnavailableError(f"{what}: its answer cannot be read: {error}") from error


def _words(answer: httpx.Response) -> str:
    try:
        body: Any = read_json(answer.content)
    except ValueError:
        return answer.text[:500].strip()
    return str(body.get("message", body) if isinstance(body, dict) else body)[:500]


class RunsEndpoint:
    """What a WebServer's `put` needs; `enqueue` puts a request into the queue, `token` is the one that the gate knows
    as well."""

    def __init__(self, token: str, enqueue: Callable[[SuiteRequest], SuiteProgress]) -> None:
        self._authorization = f"Bearer {token}".encode()
        self._enqueue = enqueue

    def put(self, path: str, headers: Mapping[str, str], body: bytes) -> tuple[int, Mapping[str, Any]]:
        """Status and answer."""
        given = headers.get("authorization", "").encode("utf-8", "surrogateescape")
        if not hmac.compare_digest(given, self._authorization):
            return 401, {"message": "the token is not the suite-runner's; gate and suite-runner mount the same Secret"}
        key = path.removeprefix(RUNS)
        if not path.startswith(RUNS) or not SUITE_RUN.fullmatch(key):
            return 404, {"message": "not found; PUT /runs/<key>"}
        if len(body) > REQUEST_BYTES_MAX:
            return 413, {"message": f"longer than {REQUEST_BYTES_MAX} bytes"}
        try:
            return 200, progress_document(self._enqueue(_read(key, body)))
        except InputError as error:
            log.warning("request refused key=%s reason=%s", key, error)
            return 400, {"message": str(error)}
        except UnavailableError as error:
            return 503, {"message": str(error)}


def _read(key: str, body: bytes) -> SuiteRequest:
    try:
        document = read_json(body)
    except ValueError as error:
        raise InputError(f"the body is not readable as JSON: {error}") from error
    request = read_request(document)
    if request.key != key:
        raise InputError(f"the key of this request is {request.key}; PUT /runs/{request.key}")
    return request
