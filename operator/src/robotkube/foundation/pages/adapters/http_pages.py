"""Pages of processes of the platform, and questions to managers, over connections that are kept."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import httpx

from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.documents.core.json_codec import read_json

TIMEOUT_SECONDS = 3.0  # until something comes, and then until more does
PAGE_SECONDS_MAX = 6.0
PAGE_BYTES_MAX = 32 * 1024 * 1024
QUESTION_SECONDS = 15.0
AGENT_PAGE_BYTES_MAX = 8 * 1024 * 1024  # of 1,000 edges; whoever has an agent answers what he likes
JSON = {"Content-Type": "application/json"}
REFUSALS = (400, 404, 413)
"""Who asks has to ask otherwise; any other answer but 200 passes."""


class HttpPages:
    """Answers of at most `bytes_max` each; UnavailableError when nobody answers, or the answer is none of the kind that
    was asked for, InputError when the question is refused. For any thread."""

    def __init__(self, bytes_max: int = PAGE_BYTES_MAX, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._bytes_max = bytes_max
        self._monotonic = monotonic
        limits = httpx.Limits(max_connections=64, max_keepalive_connections=64, keepalive_expiry=30.0)
        self._client = httpx.Client(
            timeout=TIMEOUT_SECONDS, limits=limits, trust_env=False, verify=certificate_authorities(trust_env=False)
        )

    def get(self, url: str) -> Mapping[str, Any]:
        """The JSON object at an address."""
        return _object(self._read("GET", url), url)

    def text(self, url: str) -> str:
        """The page at an address as it is."""
        return self._read("GET", url).decode(errors="replace")

    def sentences(self, url: str) -> Sequence[str]:
        """The JSON list of texts at an address."""
        try:
            listed = read_json(self._read("GET", url))
        except ValueError as error:
            raise UnavailableError(f"{url}: no JSON: {str(error)[:200]}") from error
        if not isinstance(listed, list):
            raise UnavailableError(f"{url}: no JSON list")
        return [str(sentence) for sentence in listed]

    def ask(self, url: str, question: Mapping[str, Any]) -> Mapping[str, Any]:
        """The JSON object that answers a question, which is sent as JSON."""
        return _object(self._read("POST", url, json.dumps(question).encode(), QUESTION_SECONDS), url)

    def _read(self, method: str, url: str, body: bytes = b"", seconds: float = TIMEOUT_SECONDS) -> bytes:
        try:
            with self._client.stream(method, url, content=body or None, headers=JSON, timeout=seconds) as answer:
                data = self._bounded(answer, url)
        except httpx.HTTPError as error:
            raise UnavailableError(f"{url}: {what_failed(error, url)}") from error
        if answer.status_code in REFUSALS:
            raise InputError(_message(data) or f"{url}: {answer.status_code}")
        if answer.status_code != 200:
            raise UnavailableError(_message(data) or f"{url}: {answer.status_code}")
        return data

    def _bounded(self, answer: httpx.Response, url: str) -> bytes:
        """The whole answer: who sends a little at a time keeps nobody waiting, who sends without end fills nothing."""
        end = self._monotonic() + PAGE_SECONDS_MAX
        parts = []
        size = 0
        for part in answer.iter_bytes():
            size += len(part)
            if size > self._bytes_max:
                raise UnavailableError(f"{url}: more than {self._bytes_max} bytes")
            if self._monotonic() >= end:
                raise UnavailableError(f"{url}: no end within {PAGE_SECONDS_MAX:.0f} s")
            parts.append(part)
        return b"".join(parts)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()


def _object(data: bytes, url: str) -> Mapping[str, Any]:
    try:
        document = read_json(data)
    except ValueError as error:
        raise UnavailableError(f"{url}: no JSON: {str(error)[:200]}") from error
    if not isinstance(document, dict):
        raise UnavailableError(f"{url}: no JSON object")
    return document


def _message(data: bytes) -> str:
    """What a refusal says in its `message`; empty when it says nothing."""
    try:
        return str(read_json(data)["message"])
    except (ValueError, KeyError, TypeError):
        return ""
