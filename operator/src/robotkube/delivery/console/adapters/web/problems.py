"""Refusals: what is wrong and what to do, as application/problem+json (RFC 9457)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from starlette.responses import JSONResponse

LOGIN = "/auth/login"


class ProblemError(Exception):
    """A request that is refused."""

    def __init__(self, status: int, title: str, detail: str, wait_seconds: float = 0.0) -> None:
        super().__init__(detail)
        self.status = status
        self.title = title
        self.detail = detail
        self.retry_after_seconds = math.ceil(wait_seconds)

    def response(self) -> JSONResponse:
        """The answer."""
        document: dict[str, object] = {"status": self.status, "title": self.title, "detail": self.detail}
        headers: dict[str, str] = {}
        if self.status == 401:
            document["sign_in"] = LOGIN
        if self.retry_after_seconds:
            document["retry_after_seconds"] = self.retry_after_seconds
            headers["Retry-After"] = str(self.retry_after_seconds)
        return problem_response(document, self.status, headers)


def problem_response(document: object, status: int, headers: Mapping[str, str]) -> JSONResponse:
    """An answer of the type of problems."""
    return JSONResponse(document, status, dict(headers), media_type="application/problem+json")
