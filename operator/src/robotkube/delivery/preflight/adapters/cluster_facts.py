"""The facts of a cluster, by GETs and access reviews at its API server: nothing is written.

Each request has a bound of REQUEST_SECONDS_MAX, and REQUESTS_AT_ONCE are under way at the same time.
"""

from __future__ import annotations

import functools
import re
import threading
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

from robotkube.delivery.preflight.adapters.calls_at_once import at_once
from robotkube.delivery.preflight.adapters.helm_releases import last_revision, selector
from robotkube.delivery.preflight.core import admission
from robotkube.delivery.preflight.core.argocd import DEFINITIONS, PARAMETERS, SERVER, ArgoCd
from robotkube.delivery.preflight.core.findings import Unread
from robotkube.delivery.preflight.core.releases import HelmRevision, PresentObjects
from robotkube.delivery.preflight.core.renderings import Object, labels_of, name_of, plural
from robotkube.delivery.preflight.core.rights import EVERYTHING, NeededRights, Reviewed
from robotkube.delivery.preflight.core.storage import Storage
from robotkube.errors import InputError, RobotKubeError, UnavailableError
from robotkube.foundation.documents.core.json_codec import read_json_shortened
from robotkube.foundation.kubernetes.adapters.access_reviews import may, rules_in
from robotkube.foundation.kubernetes.core.access_rights import ApiRight, covers

REQUEST_SECONDS_MAX = 5.0
REQUESTS_AT_ONCE = 5
PAGE_OBJECTS = 500
PAGES_MAX = 20
REVIEWS_MAX = 400
METRICS_NODES_MAX = 50
VERSION_LINE = re.compile(rb"^kubelet_cgroup_version ([12])\b", re.MULTILINE)
ADMISSION_API = "/apis/admissionregistration.k8s.io/v1"
DEFINITIONS_PATH = "/apis/apiextensions.k8s.io/v1/customresourcedefinitions"
PART_OF_ARGO_CD = "app.kubernetes.io/part-of=argocd"
Query = Sequence[tuple[str, str]]
Call = Callable[..., Any]


class ClusterFacts:
    """Reads facts by `call`, which has the form of `client.call`."""

    def __init__(self, call: Call) -> None:
        self._open = call
        self._places = threading.BoundedSemaphore(REQUESTS_AT_ONCE)

    def version(self) -> str:
        """The version of the API server."""
        return str(self._get("/version").get("gitVersion"))

    def served(self, versions: Collection[str]) -> Mapping[str, frozenset[str]]:
        """The kinds of these `<group>/<version>`; none where one is not served."""
        return dict(at_once([functools.partial(self._kinds, version) for version in versions]))

    def namespaces(self) -> Mapping[str, Mapping[str, str]]:
        """All namespaces with their labels."""
        return {name_of(item): labels_of(item) for item in self._items("/api/v1/namespaces")}

    def nodes(self) -> Sequence[Object]:
        """All Nodes."""
        return self._items("/api/v1/nodes")

    def pods(self) -> Sequence[Object]:
        """The pods of the cluster that are not over."""
        over = [("fieldSelector", "status.phase!=Succeeded,status.phase!=Failed")]
        return self._items("/api/v1/pods", over)

    def storage(self) -> Storage:
        """Classes, claims and volumes."""
        paths = (
            "/apis/storage.k8s.io/v1/storageclasses",
            "/api/v1/persistentvolumeclaims",
            "/api/v1/persistentvolumes",
        )
        return Storage(*at_once([functools.partial(self._items, path) for path in paths]))

    def judges(self) -> admission.Judges:
        """Webhooks and policies; kinds that the API server has not are nobody's."""
        paths = [f"{ADMISSION_API}/{plural(kind)}" for kind in admission.KINDS]
        listed = at_once([functools.partial(self._items, path, (), ()) for path in paths])
        return dict(zip(admission.KINDS, listed, strict=True))

    def control_groups(self, nodes: Sequence[Object]) -> Mapping[str, int | Unread]:
        """The version of the control groups of each Node, as its kubelet says through the API server."""
        names = [name_of(node) for node in nodes]
        asked = at_once([functools.partial(self._control_groups, name) for name in names[:METRICS_NODES_MAX]])
        more: dict[str, int | Unread] = {
            name: Unread(f"more than {METRICS_NODES_MAX} Nodes are not asked") for name in names[METRICS_NODES_MAX:]
        }
        return dict(zip(names, asked, strict=False)) | more

    def argocd(self, namespace: str) -> ArgoCd:
        """What is there of Argo CD."""
        chosen = [("labelSelector", PART_OF_ARGO_CD)]
        paths = [f"/apis/apps/v1/namespaces/{namespace}/{kind}" for kind in ("deployments", "statefulsets")]
        lists = at_once([functools.partial(self._items, path, chosen) for path in paths])
        standing = at_once([functools.partial(self._one, f"{DEFINITIONS_PATH}/{name}") for name in DEFINITIONS])
        there = (name for name, item in zip(DEFINITIONS, standing, strict=True) if item is not None)
        workloads = [item for listed in lists for item in listed]
        told = at_once([functools.partial(read, namespace) for read in (self._parameters, self._ports)])
        return ArgoCd(namespace, frozenset(there), workloads, *told)

    def _parameters(self, namespace: str) -> Mapping[str, str] | Unread:
        """What Argo CD's ConfigMap of parameters has; nothing where there is none, as its programs take it."""
        try:
            present = self._one(f"/api/v1/namespaces/{namespace}/configmaps/{PARAMETERS}")
        except RobotKubeError as error:
            return Unread(str(error))
        return (present or {}).get("data") or {}

    def _ports(self, namespace: str) -> frozenset[int] | Unread | None:
        """The ports of the Service argocd-server; None where there is none."""
        try:
            present = self.service(namespace, SERVER)
        except RobotKubeError as error:
            return Unread(str(error))
        if present is None:
            return None
        return frozenset(one["port"] for one in (present.get("spec") or {}).get("ports") or ())

    def release(self, name: str, namespace: str) -> HelmRevision | None:
        """The last revision of a Helm release."""
        query = [("labelSelector", selector(name))]
        return last_revision(self._items(f"/api/v1/namespaces/{namespace}/secrets", query))

    def in_namespace(self, namespace: str) -> PresentObjects:
        """The Deployments and Services of a namespace."""
        paths = (f"/apis/apps/v1/namespaces/{namespace}/deployments", f"/api/v1/namespaces/{namespace}/services")
        return PresentObjects(*at_once([functools.partial(self._items, path) for path in paths]))

    def service(self, namespace: str, name: str) -> Object | None:
        """A Service; None when there is none."""
        return self._one(f"/api/v1/namespaces/{namespace}/services/{name}")

    def standing(self, objects: Sequence[Object]) -> Mapping[tuple[str, str], Object | None]:
        """What stands under the names of these objects of the whole cluster."""
        present = at_once([functools.partial(self._one, _path(item)) for item in objects])
        return {(str(item["kind"]), name_of(item)): there for item, there in zip(objects, present, strict=True)}

    def rights(self, needed: NeededRights) -> Reviewed:
        """Which of these rights the account has not."""
        if self._may(EVERYTHING):
            return Reviewed(needed, frozenset())
        places: defaultdict[str, list[ApiRight]] = defaultdict(list)
        for right in needed.all:
            places[right.namespace].append(right)
        cluster = self._refused(places.pop("", []))
        missing = at_once([functools.partial(self._missing, place, rights) for place, rights in places.items()])
        return Reviewed(needed, frozenset().union(cluster, *missing))

    def _missing(self, namespace: str, rights: Sequence[ApiRight]) -> Collection[ApiRight]:
        """Those that the rules in a namespace do not give; asked one by one where the rules are not all."""
        rules, whole = self._reviewed(rules_in, namespace)
        lacking = [right for right in rights if not covers(rules, right)]
        return lacking if whole or not lacking else self._refused(lacking)

    def _refused(self, rights: Sequence[ApiRight]) -> Collection[ApiRight]:
        if len(rights) > REVIEWS_MAX:
            raise UnavailableError(
                f"{len(rights)} rights would have to be asked for one by one, at most {REVIEWS_MAX} are"
            )
        allowed = at_once([functools.partial(self._may, right) for right in rights])
        return [right for right, has in zip(rights, allowed, strict=True) if not has]

    def _may(self, right: ApiRight) -> bool:
        return bool(self._reviewed(may, right))

    def _kinds(self, version: str) -> tuple[str, frozenset[str]]:
        resources = self._one(f"/apis/{version}" if "/" in version else f"/api/{version}") or {}
        return version, frozenset(str(one.get("kind")) for one in resources.get("resources") or ())

    def _control_groups(self, node: str) -> int | Unread:
        try:
            page = self._call("GET", f"/api/v1/nodes/{node}/proxy/metrics", ()).data
        except KeyError:
            return Unread("absent: its kubelet has no such page")
        except RobotKubeError as error:
            return Unread(str(error))
        line = VERSION_LINE.search(page)
        return int(line[1]) if line else Unread("absent: its kubelet does not say it (before Kubernetes 1.31)")

    def _items(self, path: str, query: Query = (), absent: Sequence[Object] | None = None) -> Sequence[Object]:
        """All objects of a kind; `absent` where the API server does not know it."""
        try:
            return list(self._pages(path, query))
        except KeyError as error:
            if absent is None:
                raise InputError(f"absent: the API server has no {path}") from error
            return absent

    def _pages(self, path: str, query: Query) -> Iterator[Object]:
        token = ""
        for _ in range(PAGES_MAX):
            page = self._read(path, [("limit", str(PAGE_OBJECTS)), ("continue", token), *query])
            yield from page.get("items") or ()
            token = (page.get("metadata") or {}).get("continue", "")
            if not token:
                return
        raise InputError(f"{path}: more than {PAGES_MAX * PAGE_OBJECTS} objects are not read")

    def _one(self, path: str) -> Object | None:
        try:
            return self._read(path)
        except KeyError:
            return None

    def _get(self, path: str) -> Object:
        document = self._one(path)
        if document is None:
            raise InputError(f"absent: the API server has no {path}")
        return document

    def _read(self, path: str, query: Query = ()) -> Object:
        try:
            document: Object = read_json_shortened(self._call("GET", path, query).data)
        except ValueError as error:
            raise UnavailableError(f"API server: GET {path}: its answer is no JSON") from error
        return document

    def _reviewed(self, review: Callable[[Call, Any], Any], asked: Any) -> Any:
        try:
            return review(self._call, asked)
        except (KeyError, ValueError) as error:
            raise InputError("absent: the API server answers no access reviews") from error

    def _call(self, method: str, path: str, query: Query, body: Object | None = None) -> Any:
        with self._places:
            answer = self._open(method, path, query, body, seconds=REQUEST_SECONDS_MAX)
            answer.data  # noqa: B018 - read to its end while the place is held
            return answer


def _path(item: Object) -> str:
    """The path of an object of the whole cluster."""
    version = str(item["apiVersion"])
    return f"/{'apis' if '/' in version else 'api'}/{version}/{plural(str(item['kind']))}/{name_of(item)}"
