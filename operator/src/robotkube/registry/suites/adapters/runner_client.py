"""The suite-runner over HTTP: `PUT /runs/<key>` starts a run or says how it goes."""

from __future__ import annotations

from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.digests import canonical_json
from robotkube.registry.suites.core.requests import SuiteProgress, SuiteRequest, read_progress, request_document

TIMEOUT_SECONDS = 10.0
ANSWER_BYTES_MAX = 4 << 20
PASSING = frozenset({408, 425, 429})  # besides 5xx: the runner may say otherwise later
OURS = frozenset({401, 403, 404})  # a wrong token or address: nothing that the submission can help


class SuiteRunnerClient:
    """The port SuiteRunner at `url` (no slash at the end); `token` is the one that the runner knows.

    UnavailableError: no answer, an answer that cannot be read, or a refusal of this gate. InputError: the runner
    refuses this request.
    """

    def __init__(self, url: str, token: str) -> None:
        self._where = f"suite-runner {url}"
        headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
        self._client = httpx.Client(base_url=url, headers=headers, timeout=TIMEOUT_SECONDS, trust_env=False)

    def disconnect(self) -> None:
        """Give the connection back."""
        self._client.close()

    def run(self, request: SuiteRequest) -> SuiteProgress:
        """Ask for a run, or how it goes."""
        body = canonical_json(request_document(request))
        what = f"{self._where}: suite {request.rule.name} of {request.artefact.chart}"
        try:
            answer = self._client.put(f"/runs/{request.key}", content=body)
        except httpx.HTTPError as error:
            raise UnavailableError(f"{what}: {error or type(error).__name__}") from error
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
            return read_progress(answer.json())
        except (InputError, ValueError, RecursionError) as error:
            raise UnavailableError(f"{what}: its answer cannot be read: {error}") from error


def _words(answer: httpx.Response) -> str:
    try:
        body: Any = answer.json()
    except (ValueError, RecursionError):
        return answer.text[:500].strip()
    return str(body.get("message", body) if isinstance(body, dict) else body)[:500]
