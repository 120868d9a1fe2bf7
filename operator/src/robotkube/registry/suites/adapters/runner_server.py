"""The suite-runner's side of its protocol.

    PUT /runs/<key>   Authorization: Bearer <token>; a request as JSON -> 200 and how the run goes
                      400 the request is wrong, 401 the token, 404 the path, 413 the size, 503 no place in the queue

The key is that of the request (`SuiteRequest.key`), so that asking again never starts a second run.
"""

from __future__ import annotations

import hmac
import json
import logging
from collections.abc import Callable, Mapping
from typing import Any

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.patterns import SUITE_RUN
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest, progress_document, read_request

REQUEST_BYTES_MAX = 1024 * 1024
RUNS = "/runs/"

log = logging.getLogger(__name__)


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
        document = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise InputError(f"the body is not JSON: {error}") from error
    request = read_request(document)
    if request.key != key:
        raise InputError(f"the key of this request is {request.key}; PUT /runs/{request.key}")
    return request
