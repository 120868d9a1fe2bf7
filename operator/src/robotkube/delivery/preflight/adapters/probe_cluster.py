"""The probe's namespace at the API server."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from robotkube.delivery.preflight.core.probing import objects
from robotkube.delivery.preflight.core.renderings import Object, labels_of, name_of
from robotkube.errors import InputError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.access_reviews import may

REQUEST_SECONDS_MAX = 5.0
OBJECTS_MAX = 500
NAMESPACES = "/api/v1/namespaces"


class KubernetesProbeCluster:
    """The port ProbeCluster by `call`, which has the form of `client.call`; `run` marks what this probe made."""

    def __init__(self, call: Callable[..., Any], namespace: str, run: str) -> None:
        self._open = call
        self._namespace = namespace
        self._run = run
        self._core = f"{NAMESPACES}/{namespace}"
        self._policies = f"/apis/networking.k8s.io/v1/namespaces/{namespace}/networkpolicies"

    def lacking(self) -> Sequence[str]:
        """The rights that the account lacks, as an access review of each says."""
        return [str(right) for right in objects.rights_in(self._namespace) if not may(self._call, right)]

    def open(self) -> None:
        """Make the namespace with its account and its policy."""
        if self._get(self._core) is not None:
            raise InputError(
                f"namespace {self._namespace} is there already: another probe is at work, or one was killed. When none "
                f"is: kubectl delete namespace {self._namespace}"
            )
        self._post(NAMESPACES, objects.namespace(self._namespace, self._run))
        self._post(f"{self._core}/serviceaccounts", objects.account())
        self._post(self._policies, objects.policy())

    def start(self, pod: Object) -> None:
        """Make a pod."""
        self._post(f"{self._core}/pods", pod)

    def pods(self) -> Mapping[str, Object]:
        """The pods that are there."""
        return {name_of(one): one for one in self._items("pods")}

    def events(self) -> Sequence[Object]:
        """The Events of the namespace."""
        return self._items("events")

    def close(self) -> bool:
        """Delete pods at once, and the namespace; one that another probe made is left alone."""
        present = self._get(self._core)
        if present is None or labels_of(present).get(objects.RUN) != self._run:
            return True
        if "deletionTimestamp" not in present["metadata"]:
            self._call("DELETE", f"{self._core}/pods", [("gracePeriodSeconds", "0")]).read()
            self._call("DELETE", self._core, ()).read()
        return False

    def _items(self, kind: str) -> Sequence[Object]:
        page = self._get(f"{self._core}/{kind}", [("limit", str(OBJECTS_MAX))])
        return list((page or {}).get("items") or ())

    def _get(self, path: str, query: Sequence[tuple[str, str]] = ()) -> Any:
        try:
            return read_json_shortened(self._call("GET", path, query).data)
        except KeyError:
            return None

    def _post(self, path: str, body: Object) -> None:
        try:
            self._call("POST", path, (), body).read()
        except KeyError as error:
            raise InputError(f"absent: the API server has no {path}") from error

    def _call(self, method: str, path: str, query: Sequence[tuple[str, str]], body: Object | None = None) -> Any:
        return self._open(method, path, query, body, seconds=REQUEST_SECONDS_MAX)
