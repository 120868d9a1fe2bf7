"""Notifications that main moved: signed push events, as the forges send them. Best effort: a hook returns whether it
was accepted and logs why not; a receiver that was not reached polls, or is notified by the forge.

`SignedPushHook` notifies the ApplicationSet controller, which accepts GitHub's form only. `PushRelay` notifies a
manager in Gitea's form, whose own delivery comes about a fifth of a second after the push: it makes its records first.
`ObjectsRelay` sends the gate the commit objects of a proposal while the forge still receives the push.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import logging
import threading
from collections.abc import Callable, Mapping

import httpx

from robotkube.foundation.certificates.adapters.certificate_authorities import certificate_authorities, what_failed
from robotkube.foundation.forge.core.commit_objects import CommitObjects, write_objects

HOOK_SECONDS_MAX = 5.0
RELAY_SECONDS_MAX = 1.0  # the gate's next decision waits for it

log = logging.getLogger(__name__)


class _PushEvents:
    """A sender of signed push events. `repository` is how the event names it, `headers` names the event and signs it
    (from the signature in hex)."""

    def __init__(
        self,
        url: str,
        secret: bytes,
        repository: Mapping[str, str],
        branch: str,
        seconds_max: float,
        headers: Callable[[str], Mapping[str, str]],
    ) -> None:
        self._url = url
        self._secret = secret
        self._repository = repository
        self._branch = branch
        self._headers = headers
        self._client = httpx.Client(verify=certificate_authorities(), timeout=seconds_max)

    def disconnect(self) -> None:
        """Close the connection."""
        self._client.close()

    def hook(self, before: str, after: str) -> bool:
        """Send the event; whether it was accepted (HTTP 2xx)."""
        reference = f"refs/heads/{self._branch}"
        event = {"ref": reference, "before": before, "after": after, "repository": self._repository}
        body = json.dumps(event).encode()
        signature = hmac.new(self._secret, body, hashlib.sha256).hexdigest()
        headers = {"Content-Type": "application/json", **self._headers(signature)}
        try:
            answer = self._client.post(self._url, content=body, headers=headers)
        except httpx.HTTPError as error:
            reason = what_failed(error, self._url)
            log.warning("hook not delivered url=%s after=%s reason=%s", self._url, after, reason)
            return False
        if answer.is_error:
            reason = answer.text[:200].strip()
            log.warning("hook refused url=%s status=%d reason=%s", self._url, answer.status_code, reason)
        return answer.is_success


class SignedPushHook(_PushEvents):
    """The port PushHook. `repository_url` must be the URL that the ApplicationSet names (without .git); the key is
    `webhook.github.secret`."""

    def __init__(self, url: str, secret: bytes, repository_url: str, branch: str = "main") -> None:
        def headers(signature: str) -> Mapping[str, str]:
            return {"X-GitHub-Event": "push", "X-Hub-Signature-256": f"sha256={signature}"}

        repository = {"html_url": repository_url, "default_branch": branch}
        super().__init__(url, secret, repository, branch, HOOK_SECONDS_MAX, headers)


class PushRelay(_PushEvents):
    """Push events to a manager. `repository` is `<organisation>/<name>`, `secret` the manager's own, with which the
    forge signs as well."""

    def __init__(self, url: str, secret: bytes, repository: str, branch: str = "main") -> None:
        def headers(signature: str) -> Mapping[str, str]:
            return {"X-Gitea-Event": "push", "X-Gitea-Signature": signature}

        super().__init__(url, secret, {"full_name": repository}, branch, RELAY_SECONDS_MAX, headers)


class ObjectsRelay:
    """A sender of commit objects for `repository` (`<organisation>/<name>`) to the gate at `url`; `secret` is the
    manager's own. One at a time, on a thread of its own: the push does not wait for it, nor it for the push."""

    def __init__(self, url: str, secret: bytes, repository: str) -> None:
        self._url = url
        self._secret = secret
        self._repository = repository
        self._client = httpx.Client(verify=certificate_authorities(), timeout=RELAY_SECONDS_MAX)
        self._free = threading.Semaphore(1)

    def disconnect(self) -> None:
        """Close the connection."""
        self._client.close()

    def send(self, objects: CommitObjects) -> None:
        """Send the objects; returns at once. While others are still under way these are dropped: the gate fetches
        them."""
        if self._free.acquire(blocking=False):
            threading.Thread(target=self._deliver, args=(objects,), daemon=True).start()

    def _deliver(self, objects: CommitObjects) -> None:
        body = write_objects(objects, self._repository)
        signature = hmac.new(self._secret, body, hashlib.sha256).hexdigest()
        headers = {"Content-Type": "application/json", "X-Gitea-Signature": signature}
        try:
            answer = self._client.post(self._url, content=body, headers=headers)
            if answer.is_error:
                reason = answer.text[:200].strip()
                log.warning("objects refused url=%s status=%d reason=%s", self._url, answer.status_code, reason)
        except (httpx.HTTPError, RuntimeError) as error:  # the latter: disconnected meanwhile
            log.warning("objects not sent url=%s reason=%s", self._url, what_failed(error, self._url))
        finally:
            self._free.release()
