"""The Kubernetes API by its Python client: requests with the errors of this package, and watches that last."""

from __future__ import annotations

import logging
import os
import random
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import urllib3
import yaml
from kubernetes import client, config
from kubernetes.watch.watch import iter_resp_lines

from robotkube.backoffs import Random, backoff
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json, read_json_shortened
from robotkube.foundation.kubernetes.core.objects import object_key

log = logging.getLogger(__name__)

REQUEST_SECONDS_MAX = 10.0
NO_HEADERS: Mapping[str, str] = MappingProxyType({})
WATCH_SECONDS = 240
SILENCE_SECONDS_MAX = WATCH_SECONDS + 20
BACKOFF_SECONDS_MIN = 0.25
BACKOFF_SECONDS_MAX = 10.0
PAGE_OBJECTS = 500
PAGES_MAX = 200
CONFLICT = 409
# What the Python client raises for a file that it cannot read, or that is something else: of YAML, of another form.
NO_KUBECONFIG = (OSError, ValueError, yaml.YAMLError, TypeError, AttributeError)
CONNECTIONS_KEPT_MAX = 32  # a watch holds one; by default five for each processor are kept, and more are warned of
Object = Mapping[str, Any]


def api_client(kubeconfig: str | None = None, context: str | None = None, in_cluster: bool = False) -> client.ApiClient:
    """A client of the API server, as the pod's own account or by a kubeconfig (default: KUBECONFIG or
    ~/.kube/config)."""
    configuration = client.Configuration()
    try:
        if in_cluster:
            config.load_incluster_config(client_configuration=configuration)
        else:
            config.load_kube_config(config_file=kubeconfig, context=context, client_configuration=configuration)
    except (config.ConfigException, *NO_KUBECONFIG) as error:
        named = kubeconfig or os.environ.get("KUBECONFIG") or "~/.kube/config"
        missing = [file for file in named.split(os.pathsep) if not Path(file).expanduser().exists()]
        reason = f"there is no file {', '.join(missing)}"
        if in_cluster or not missing:
            known = isinstance(error, config.ConfigException)
            reason = str(error).rstrip(".") if known else f"{named} is no kubeconfig ({' '.join(str(error).split())})"
        raise InputError(
            f"no access to a cluster: {reason}; run in a pod, or name a kubeconfig in KUBECONFIG"
        ) from error
    configuration.retries = False
    configuration.connection_pool_maxsize = CONNECTIONS_KEPT_MAX
    return client.ApiClient(configuration)


def call(
    api: client.ApiClient,
    method: str,
    path: str,
    query: Sequence[tuple[str, str]] = (),
    body: Object | None = None,
    content_type: str = "application/json",
    seconds: float = REQUEST_SECONDS_MAX,
    headers: Mapping[str, str] = NO_HEADERS,
) -> Any:
    """The open answer of one request to the API server, with further `headers`. UnavailableError when nobody answers or
    the fault passes, InputError when it is refused, KeyError when there is no such object."""
    try:
        return api.call_api(
            path,
            method,
            query_params=list(query),
            header_params={"Accept": "application/json", "Content-Type": content_type, **headers},
            body=body,
            auth_settings=["BearerToken"],
            _preload_content=False,
            _request_timeout=(REQUEST_SECONDS_MAX, seconds),
        )
    except client.ApiException as error:
        raise _translated(error, f"{method} {path}") from error
    except (urllib3.exceptions.HTTPError, OSError) as error:
        raise UnavailableError(f"API server: {method} {path}: {error}") from error


def send(api: client.ApiClient, method: str, path: str, body: Object, content_type: str = "application/json") -> None:
    """Send a request whose answer says nothing more. It is read to its end, which keeps the connection for the next
    one: a new one would cost more than the request."""
    call(api, method, path, body=body, content_type=content_type).read()


def _translated(error: client.ApiException, what: str) -> Exception:
    if error.status == 404:
        return KeyError(what)
    text = f"API server: {what}: {error.status} {_message(error)}"
    passing = error.status in (0, 409, 410, 429) or error.status >= 500
    return UnavailableError(text) if passing else InputError(text)


def _message(error: client.ApiException) -> str:
    try:
        return str(read_json(error.body)["message"])
    except (ValueError, KeyError, TypeError):
        return str(error.reason)


class ResourceWatch:
    """The watch of all objects below one path: each, reduced by `reduce`, by `<namespace>/<name>`.

    `changed` is called with key, value before and value now (None: not there) from the watch's thread, only when the
    reduced value differs.
    """

    def __init__(
        self,
        api: client.ApiClient,
        path: str,
        selector: str,
        reduce: Callable[[Object], Any],
        changed: Callable[[str, Any, Any], None],
        jitter: Random = random.random,
        field_selector: str = "",
    ) -> None:
        """`selector` of labels; `field_selector` such as `metadata.name=one`, for an account that may watch one."""
        self._api = api
        self._path = path
        self._selectors = [("labelSelector", selector), ("fieldSelector", field_selector)]
        self._reduce = reduce
        self._changed = changed
        self._jitter = jitter
        self._values: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self.synced = threading.Event()
        self.complaint = f"{path} was not listed yet"

    def values(self) -> dict[str, Any]:
        """The values now, as a copy."""
        with self._lock:
            return dict(self._values)

    def start(self) -> None:
        """Begin to watch, on a thread of its own."""
        threading.Thread(target=self._run, name=f"watch {self._path}", daemon=True).start()

    def stop(self) -> None:
        """End the watch, within SILENCE_SECONDS_MAX; its thread does not keep the process."""
        self._stopping.set()

    def _run(self) -> None:
        failures = 0
        version = ""
        while not self._stopping.is_set():
            try:
                version = self._watch(version or self._list())
                self.complaint = ""
                failures = 0
            except (UnavailableError, InputError, KeyError, ValueError) as error:
                if self._stopping.is_set():
                    return
                self.complaint = f"{self._path}: {error}"
                log.warning("watch interrupted path=%s reason=%s", self._path, error)
                version = ""
                self._stopping.wait(backoff(failures, BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX, self._jitter))
                failures += 1

    def _list(self) -> str:
        """Read all objects anew, and return the version from which changes follow."""
        values: dict[str, Any] = {}
        query = [("limit", str(PAGE_OBJECTS)), *self._selectors]
        version = ""
        token = ""
        for _ in range(PAGES_MAX):
            answer = read_json_shortened(call(self._api, "GET", self._path, [*query, ("continue", token)]).data)
            values |= {object_key(item): self._reduce(item) for item in answer.get("items", [])}
            version = answer["metadata"]["resourceVersion"]
            token = answer["metadata"].get("continue", "")
            if not token:
                break
        else:
            raise InputError(f"more than {PAGES_MAX * PAGE_OBJECTS} objects; remove old ones")
        before = self.values()
        for key in sorted({*before, *values}):
            self._set(key, values.get(key))
        self.complaint = ""
        self.synced.set()
        return str(version)

    def _watch(self, version: str) -> str:
        """Apply changes until the server ends the watch, and return the version reached."""
        query = [
            ("watch", "true"),
            ("allowWatchBookmarks", "true"),
            ("resourceVersion", version),
            ("timeoutSeconds", str(WATCH_SECONDS)),
            *self._selectors,
        ]
        answer = call(self._api, "GET", self._path, query, seconds=SILENCE_SECONDS_MAX)
        try:
            for event in self._events(answer):
                item = event["object"]
                if event["type"] == "ERROR":
                    raise UnavailableError(f"watch refused: {item.get('message', item)}")
                version = str(item["metadata"]["resourceVersion"])
                if event["type"] != "BOOKMARK":
                    self._set(object_key(item), None if event["type"] == "DELETED" else self._reduce(item))
        finally:
            answer.close()
            answer.release_conn()
        return version

    def _events(self, answer: Any) -> Iterator[dict[str, Any]]:
        try:
            for line in iter_resp_lines(answer):
                if self._stopping.is_set():
                    return
                yield read_json_shortened(line)
        except (urllib3.exceptions.HTTPError, OSError) as error:
            raise UnavailableError(f"watch ended: {error}") from error

    def _set(self, key: str, value: Any) -> None:
        with self._lock:
            before = self._values.get(key)
            if value is None:
                self._values.pop(key, None)
            else:
                self._values[key] = value
        if before != value:
            self._changed(key, before, value)
