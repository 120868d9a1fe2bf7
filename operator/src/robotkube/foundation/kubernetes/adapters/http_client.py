"""A small client of the API server for robot pods: a few calls and one watch, on the standard library's HTTP client.

The full client costs a second of import and 60 MB in every pod; fifteen pods start at once on two cores.

    api = ApiServer.from_environment(os.environ)   # a pod's account; ROBOTKUBE_API_SERVER=http://host:port needs none
    api.get(config_map_path("vehicle-00", "simulation"))                      # the object, None when there is none
    api.create(custom_path("robotkube.io", "v1alpha1", "cloud-0", "taskdescriptions"), body)  # False: was there
    api.patch(path, {"spec": ...})                 # JSON merge patch; False: gone
    api.delete(path)                               # False: was gone already
    watch = ConfigMapWatch(api, "vehicle-00", "mqtt-bridge", changed)     # changed(data | None), own thread
    watch.start()

Every call is bounded by `timeout_seconds`. UnavailableError: no answer, or a passing fault (5xx, 429); InputError:
refused (400, 401, 403, 404 of a kind, 422), with the server's own words.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

from robotkube.backoffs import Random, backoff
from robotkube.errors import InputError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened

SERVER_VARIABLE = "ROBOTKUBE_API_SERVER"
ACCOUNT_FOLDER = Path("/var/run/secrets/kubernetes.io/serviceaccount")
TIMEOUT_SECONDS = 10.0
WATCH_SECONDS = 240
BACKOFF_SECONDS_MIN = 0.5
BACKOFF_SECONDS_MAX = 10.0
JSON = "application/json"
METADATA_ALONE = f"{JSON};as=PartialObjectMetadataList;g=meta.k8s.io;v=v1,{JSON}"
EVENT_BYTES_MAX = 4 * 1024 * 1024
EVENT_NOTE_BYTES_MAX = 1024  # of an Event, by the API
EVENT_INSTANCE_CHARACTERS_MAX = 128  # as well
KEEPALIVE_IDLE_SECONDS = 20
KEEPALIVE_INTERVAL_SECONDS = 5
KEEPALIVE_PROBES = 3

ConfigMapData = Mapping[str, str]
Body = Mapping[str, Any] | Sequence[Mapping[str, Any]]
"""A document, or the steps of a JSON patch."""


def config_map_path(namespace: str, name: str = "") -> str:
    """The path of a ConfigMap, or of the namespace's list."""
    return f"/api/v1/namespaces/{quote(namespace)}/configmaps" + (f"/{quote(name)}" if name else "")


def custom_path(group: str, version: str, namespace: str, plural: str, name: str = "") -> str:
    """The path of a custom resource, or of the namespace's list."""
    base = f"/apis/{group}/{version}/namespaces/{quote(namespace)}/{plural}"
    return f"{base}/{quote(name)}" if name else base


def event_path(namespace: str) -> str:
    """The path of the namespace's Events."""
    return f"/apis/events.k8s.io/v1/namespaces/{quote(namespace)}/events"


def config_map_warning(
    namespace: str, name: str, reason: str, message: str, component: str, now: str
) -> dict[str, Any]:
    """The Event (events.k8s.io/v1) that puts a warning on a ConfigMap; `now` in RFC 3339 with microseconds."""
    return {
        "apiVersion": "events.k8s.io/v1",
        "kind": "Event",
        "metadata": {"generateName": f"{name[:200]}-", "namespace": namespace},
        "regarding": {"apiVersion": "v1", "kind": "ConfigMap", "namespace": namespace, "name": name},
        "reason": reason,
        "action": "ReadSettings",
        "note": message.encode()[:EVENT_NOTE_BYTES_MAX].decode(errors="ignore"),
        "type": "Warning",
        "reportingController": f"robotkube.io/{component}",
        "reportingInstance": f"{namespace}.{name}"[:EVENT_INSTANCE_CHARACTERS_MAX],
        "eventTime": now,
    }


@dataclass
class ApiServer:
    """The API server as one account calls it. The token is read anew for every request: kubelets replace it hourly.

    All calls share one kept-alive connection and may be made from any thread. A process of a machine shows a
    certificate (`certificate_file` with its `key_file`) where a pod has a token."""

    url: str
    token_file: Path | None = None
    authority_file: Path | None = None
    timeout_seconds: float = TIMEOUT_SECONDS
    certificate_file: Path | None = None
    key_file: Path | None = None
    _connection: http.client.HTTPConnection | None = field(default=None, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> ApiServer:
        """The server of this pod; ROBOTKUBE_API_SERVER names another one, which is called without an account."""
        if SERVER_VARIABLE in environment:
            return cls(environment[SERVER_VARIABLE].rstrip("/"))
        host = environment.get("KUBERNETES_SERVICE_HOST")
        port = environment.get("KUBERNETES_SERVICE_PORT", "443")
        if not host:
            raise InputError(f"no API server: this is not a pod; set {SERVER_VARIABLE} or remove ROBOTKUBE_CONFIGMAP")
        host = f"[{host}]" if ":" in host else host
        return cls(f"https://{host}:{port}", ACCOUNT_FOLDER / "token", ACCOUNT_FOLDER / "ca.crt")

    def get(self, path: str, accept: str = JSON) -> dict[str, Any] | None:
        """Read an object, or a list; None when there is none. With `accept` METADATA_ALONE a list's items are their
        metadata and nothing else."""
        status, document = self._call("GET", path, accept=accept)
        return None if status == 404 else document

    def create(self, path: str, body: Mapping[str, Any]) -> bool:
        """Create an object below a list's path; False when one of that name is there already."""
        status, document = self._call("POST", path, body)
        if status == 404:
            raise InputError(f"POST {path}: {document.get('message', 'not found')}")
        return status != 409

    def patch(self, path: str, body: Mapping[str, Any]) -> bool:
        """Apply a JSON merge patch; False when there is no such object."""
        return self._call("PATCH", path, body, "application/merge-patch+json")[0] != 404

    def delete(self, path: str) -> bool:
        """Delete an object; False when there was none."""
        return self._call("DELETE", path)[0] != 404

    def request(
        self, method: str, path: str, body: Body | None = None, content_type: str = "application/json"
    ) -> tuple[int, dict[str, Any]]:
        """Status and document of any other request. 404 and 409 are answers, too."""
        return self._call(method, path, body, content_type)

    def close(self) -> None:
        """Give the kept connection back; the next call makes a new one."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
                self._connection = None

    def open(self, timeout_seconds: float) -> http.client.HTTPConnection:
        """Make a connection of its own, not connected yet."""
        parts = urlsplit(self.url)
        if parts.scheme == "http":
            return http.client.HTTPConnection(parts.netloc, timeout=timeout_seconds)
        import ssl

        context = ssl.create_default_context(cafile=self.authority_file)
        if self.certificate_file is not None:
            context.load_cert_chain(self.certificate_file, self.key_file)
        return http.client.HTTPSConnection(parts.netloc, timeout=timeout_seconds, context=context)

    def headers(self, content_type: str = JSON, accept: str = JSON) -> dict[str, str]:
        """The headers of a request, with the account's token of this moment."""
        headers = {"Accept": accept, "Content-Type": content_type}
        if self.token_file is not None:
            headers["Authorization"] = f"Bearer {self.token_file.read_text().strip()}"
        return headers

    def _call(
        self, method: str, path: str, body: Body | None = None, content_type: str = JSON, accept: str = JSON
    ) -> tuple[int, dict[str, Any]]:
        data = None if body is None else json.dumps(body).encode()
        with self._lock:
            try:
                status, text = self._exchange(method, path, data, self.headers(content_type, accept))
            except (OSError, http.client.HTTPException) as error:
                raise UnavailableError(
                    f"API server {self.url}, {method} {path}: {error or type(error).__name__}"
                ) from error
        return _checked(status, text, f"{method} {path}")

    def _exchange(self, method: str, path: str, data: bytes | None, headers: Mapping[str, str]) -> tuple[int, bytes]:
        """Send on the kept connection; when the server closed that meanwhile, once more on a new one."""
        for fresh in (False, True):
            reused = self._connection is not None and not fresh
            if not reused:
                self._connection = self.open(self.timeout_seconds)
            assert self._connection is not None
            try:
                self._connection.request(method, path, data, headers)
                response = self._connection.getresponse()
                return response.status, response.read()
            except (OSError, http.client.HTTPException):
                self._connection.close()
                self._connection = None
                if not reused:
                    raise
        raise AssertionError("unreachable")


def _checked(status: int, text: bytes, call: str) -> tuple[int, dict[str, Any]]:
    """Status and document of an answer; 404 and 409 are for the caller, any other error is raised."""
    try:
        document = read_json_shortened(text)
    except ValueError:
        document = {}
    document = document if isinstance(document, dict) else {}
    if status < 300 or status in (404, 409):
        return status, document
    message = (
        f"{call}: the API server answered {status}: {document.get('message') or text[:200].decode(errors='replace')}"
    )
    raise (UnavailableError if status >= 500 or status == 429 else InputError)(message)


class ConfigMapWatch:
    """The watch of one ConfigMap: `changed` gets its data after every change and at the beginning, None when there is
    none.

    Runs on a thread of its own and never gives up: a lost connection is made again after a pause with jitter, at most
    BACKOFF_SECONDS_MAX. An exception in `changed` is reported by `failed` (a sentence) and the watch goes on.
    `complaint` is None while it is connected.
    `read_at` and `interrupted_at` as in the port SettingsSource, by `clock`.
    """

    def __init__(
        self,
        api: ApiServer,
        namespace: str,
        name: str,
        changed: Callable[[ConfigMapData | None], None],
        failed: Callable[[str], None] = lambda sentence: None,
        clock: Callable[[], float] = time.monotonic,
        jitter: Random = random.random,
    ) -> None:
        self._api = api
        self._namespace = namespace
        self._name = name
        self._changed = changed
        self._failed = failed
        self._clock = clock
        self._jitter = jitter
        self._stopping = threading.Event()
        self._again = threading.Event()
        self.read_at: float | None = None
        self.interrupted_at: float | None = None
        self._socket: socket.socket | None = None
        self._last: tuple[ConfigMapData | None] | None = None
        self.complaint: str | None = f"ConfigMap {namespace}/{name} was not read yet"

    def start(self) -> None:
        """Begin to watch, on a thread of its own."""
        threading.Thread(target=self._run, name=f"watch-{self._name}", daemon=True).start()

    def stop(self) -> None:
        """End the watch; returns at once."""
        self._stopping.set()
        self.read_again()

    def read_again(self) -> None:
        """Read the ConfigMap now, without waiting for the next attempt or the end of the watch; returns at once."""
        self._again.set()
        connected = self._socket
        if connected is not None:
            with contextlib.suppress(OSError):
                connected.shutdown(socket.SHUT_RDWR)

    def _run(self) -> None:
        failures = 0
        while not self._stopping.is_set():
            begin = time.monotonic()
            try:
                self._watch()
            except (OSError, http.client.HTTPException, ValueError, InputError, UnavailableError) as error:
                if self._again.is_set():
                    continue  # ended by `read_again`, or to be tried at once
                if self.interrupted_at is None:
                    self.interrupted_at = self._clock()
                self.complaint = f"ConfigMap {self._namespace}/{self._name}: {error or type(error).__name__}"
                self._failed(self.complaint)
                failures = 0 if time.monotonic() - begin > BACKOFF_SECONDS_MAX else failures
                self._again.wait(backoff(failures, BACKOFF_SECONDS_MIN, BACKOFF_SECONDS_MAX, self._jitter))
                failures += 1

    def _watch(self) -> None:
        """Read the list, then its changes, until the server ends the watch (after WATCH_SECONDS at most)."""
        self._again.clear()
        begin = self._clock()
        selector = {"fieldSelector": f"metadata.name={self._name}"}
        path = config_map_path(self._namespace)
        listed = self._api.get(f"{path}?{urlencode(selector)}")
        if listed is None:
            raise InputError(f"namespace {self._namespace} has no ConfigMaps")
        self._api.close()  # the watch has a connection of its own
        self._notify(listed["items"][0] if listed.get("items") else None)
        self.complaint = self.interrupted_at = None
        self.read_at = begin
        version = listed["metadata"]["resourceVersion"]
        query = {**selector, "watch": "true", "resourceVersion": version, "timeoutSeconds": str(WATCH_SECONDS)}
        for event in self._events(f"{path}?{urlencode(query)}"):
            if event["type"] == "ERROR":
                return
            self._notify(None if event["type"] == "DELETED" else event["object"])

    def _events(self, path: str) -> Iterator[dict[str, Any]]:
        connection = self._api.open(TIMEOUT_SECONDS)
        try:
            connection.connect()
            self._socket = connection.sock
            _keep_alive(connection.sock)
            connection.sock.settimeout(WATCH_SECONDS + TIMEOUT_SECONDS)
            connection.request("GET", path, headers=self._api.headers())
            response = connection.getresponse()
            if response.status != 200:
                _checked(response.status, response.read(EVENT_BYTES_MAX), "watch")
                return
            while not self._again.is_set() and (line := response.readline(EVENT_BYTES_MAX)):
                yield read_json_shortened(line)
        finally:
            self._socket = None
            connection.close()

    def _notify(self, config_map: Mapping[str, Any] | None) -> None:
        """Call `changed` with the data of the ConfigMap, unless they are the same as the last time."""
        data = None if config_map is None else dict(config_map.get("data") or {})
        if self._last == (data,):
            return
        self._last = (data,)
        try:
            self._changed(data)
        except Exception as error:  # a fault of the receiver must not end the watch
            self._failed(f"ConfigMap {self._namespace}/{self._name}: {type(error).__name__}: {error}")


def _keep_alive(connection: socket.socket) -> None:
    """Have TCP probe the connection: a vanished server is noticed after 35 s although a watch may be silent for
    minutes."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEPALIVE_IDLE_SECONDS)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEPALIVE_INTERVAL_SECONDS)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEPALIVE_PROBES)


def split_name(text: str) -> tuple[str, str]:
    """The two parts of `<namespace>/<name>`; InputError when it is not that."""
    namespace, _, name = text.partition("/")
    if not namespace or not name or "/" in name:
        raise InputError(f"ROBOTKUBE_CONFIGMAP is {text!r}; write it as <namespace>/<name>")
    return namespace, name
