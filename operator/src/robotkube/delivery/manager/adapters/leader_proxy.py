"""A proxy from a process that waits to the one that leads: it forwards requests and returns the answer.

A Service reaches any of a manager's processes; only the one that leads knows the plans and can say what would become of
a task. A request that was forwarded once is not forwarded again.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

import httpx

from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.kubernetes.ports import Leadership

ANSWER_SECONDS_MAX = 20.0
FORWARDED = "x-robotkube-forwarded"
FORWARDED_FORMERLY = "x-robotkube-handed-on"  # of processes of the version before, during an upgrade
# How the names of the headers begin that name and sign a delivery.
DELIVERY_HEADERS = ("content-type", "x-gitea-", "x-github-", "x-gitlab-", "x-hub-")
TEXT = "text/plain; charset=utf-8"

log = logging.getLogger(__name__)


class LeaderRequests:
    """Requests answered by the leader; a call is safe from any thread. `server_name`: by HTTPS, with a certificate for
    that name, which all of them have; its address is no name of it. Empty: by HTTP."""

    def __init__(self, leadership: Leadership, seconds_max: float = ANSWER_SECONDS_MAX, server_name: str = "") -> None:
        self._leadership = leadership
        self._server_name = server_name
        limits = httpx.Limits(max_keepalive_connections=0)  # the next leader is another process
        verify = certificate_authorities(trust_env=False)
        self._client = httpx.Client(timeout=seconds_max, limits=limits, verify=verify, trust_env=False)

    def __call__(self, method: str, path: str, headers: Mapping[str, str], body: bytes) -> tuple[int, str, str] | None:
        """Status, text and content type of the leader's answer (`headers` with lower-case names); 503 when nobody is
        known to lead or the leader does not answer; None when this process leads."""
        if self._leadership.term() is not None:
            return None
        address = self._leadership.leader()
        if address is None or FORWARDED in headers or FORWARDED_FORMERLY in headers:
            return 503, "no process of this manager leads at this moment; ask again\n", TEXT
        try:
            answer = self._ask(method, f"{address}{path}", _forwarded(headers), body)
        except httpx.HTTPError as error:
            words = what_failed(error, f"https://{self._server_name}")
            reason = f"the process that leads does not answer at {address}: {words}"
            log.warning("request not forwarded path=%s reason=%s", path, reason)
            return 503, f"{reason}\n", TEXT
        return answer.status_code, answer.text, answer.headers.get("content-type", TEXT)

    def _ask(self, method: str, where: str, headers: Mapping[bytes, bytes], body: bytes) -> httpx.Response:
        if not self._server_name:
            return self._client.request(method, f"http://{where}", content=body, headers=headers)
        named = {"sni_hostname": self._server_name}
        return self._client.request(method, f"https://{where}", content=body, headers=headers, extensions=named)

    def close(self) -> None:
        """Close the connections."""
        self._client.close()


def _forwarded(headers: Mapping[str, str]) -> dict[bytes, bytes]:
    """The headers that the leader needs, as bytes: what a client sent need not be ASCII."""
    delivery = {name: value for name, value in headers.items() if name.startswith(DELIVERY_HEADERS)}
    sent = {**delivery, FORWARDED: "1"}
    return {name.encode("latin-1"): value.encode("latin-1") for name, value in sent.items()}
