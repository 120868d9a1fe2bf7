"""Policies and list as objects of the API, on an API server in memory; charts/test_admission_process.py has a real
one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
import urllib3
from kubernetes.client import ApiException

from robotkube.errors import InputError, UnavailableError
from robotkube.registry.admission.adapters.policy_objects import ListMemory, PolicyObjects
from robotkube.registry.admission.core.domain import Domain
from robotkube.registry.admission.core.list_objects import documents_for_api
from robotkube.registry.admission.core.listing import AllowedVersions
from robotkube.registry.admission.core.policies import LIST
from tests.stages.registry.admission_examples import CHARTS, digest

DOMAIN = Domain(("vehicle-00",), ("robotkube-suite-0",), CHARTS)
LISTED = AllowedVersions((f"app@{digest(9)}",), (digest(1),), commit="c" * 40)
LIST_PATH = f"/api/v1/namespaces/robotkube/configmaps/{LIST}"
POLICIES = "/apis/admissionregistration.k8s.io/v1/validatingadmissionpolicies"
ROLE = "/apis/rbac.authorization.k8s.io/v1/clusterroles/robotkube-admission"


@dataclass
class Answer:
    data: bytes

    def read(self) -> bytes:
        return self.data


@dataclass
class Server:
    """Objects by path, as far as the adapter asks for them. `away`: the paths at which nobody answers."""

    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    away: set[str] = field(default_factory=set)
    refused: set[str] = field(default_factory=set)
    requests: list[tuple[str, str]] = field(default_factory=list)
    version: int = 0

    def call_api(self, path: str, method: str, body: Any = None, **_: Any) -> Answer:
        self.requests.append((method, path))
        if path in self.away:
            raise urllib3.exceptions.HTTPError("nobody answers")
        if path in self.refused:
            raise ApiException(status=403, reason="Forbidden")
        stands = self.objects.get(path)
        if stands is None and method != "PATCH":
            raise ApiException(status=404, reason="Not Found")
        if method == "DELETE":
            del self.objects[path]
        elif method in ("PUT", "PATCH"):
            self._write(path, stands, body)
        return Answer(json.dumps(self.objects.get(path, {})).encode())

    def _write(self, path: str, stands: Mapping[str, Any] | None, body: Mapping[str, Any]) -> None:
        known = {**(stands or {}).get("metadata", {})}
        version = known.pop("resourceVersion", "")
        metadata = {key: value for key, value in body["metadata"].items() if key != "resourceVersion"}
        if stands is not None and ({**stands, "metadata": known}) == {**body, "metadata": metadata}:
            return
        assert stands is None or body["metadata"]["resourceVersion"] == version
        self.version += 1
        written = {**body, "metadata": {**metadata, "resourceVersion": str(self.version)}}
        self.objects[path] = json.loads(json.dumps(written))


@dataclass
class Stage:
    server: Server = field(default_factory=Server)
    woken: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.server.objects[ROLE] = {"metadata": {"uid": "u", "resourceVersion": "1"}}
        self.place = PolicyObjects(self.server, "robotkube", lambda: self.woken.append(1))  # type: ignore[arg-type]

    def changed(self, kind: str, path: str) -> None:
        """Somebody changed it: what its watch says."""
        current = self.server.objects.get(path)
        [watch] = [watch for watch in self.place._watches if path.startswith(watch._path)]
        name = path.rpartition("/")[2]
        key = f"robotkube/{name}" if kind == "ConfigMap" else f"/{name}"
        watch._set(key, watch._reduce(current) if current else None)


@pytest.fixture
def stage() -> Stage:
    return Stage()


def documents(domain: Domain = DOMAIN, found: AllowedVersions = LISTED) -> Sequence[Mapping[str, Any]]:
    return documents_for_api(domain, found)


def test_what_is_written_belongs_to_the_accounts_role_and_is_written_once(stage: Stage) -> None:
    assert not stage.place.intact()
    assert stage.place.write(documents())
    assert stage.place.intact()
    [owner] = stage.server.objects[LIST_PATH]["metadata"]["ownerReferences"]
    assert (owner["kind"], owner["name"], owner["uid"]) == ("ClusterRole", "robotkube-admission", "u")
    assert len(stage.server.objects) == 1 + len(documents())
    stage.server.requests.clear()
    assert not stage.place.write(documents())
    assert stage.server.requests == [("GET", ROLE)]
    assert ListMemory(stage.place).load() == LISTED


def test_where_it_runs_with_other_rights_nobody_owns_them(stage: Stage) -> None:
    del stage.server.objects[ROLE]
    stage.place.write(documents())
    assert "ownerReferences" not in stage.server.objects[LIST_PATH]["metadata"]


def test_only_what_differs_is_written(stage: Stage) -> None:
    stage.place.write(documents())
    stage.server.requests.clear()
    more = replace(LISTED, verified=(digest(1), digest(2)))
    assert stage.place.write(documents(found=more))
    assert stage.server.requests == [("GET", ROLE), ("GET", LIST_PATH), ("PUT", LIST_PATH)]
    assert ListMemory(stage.place).load() == more
    assert stage.place.restored == 0


def test_policies_of_what_is_gone_are_removed(stage: Stage) -> None:
    stage.place.write(documents())
    assert stage.place.write(documents(replace(DOMAIN, tests=())))
    assert f"{POLICIES}/robotkube-tests" not in stage.server.objects
    assert not stage.place.write(documents(replace(DOMAIN, tests=())))


def test_what_somebody_deletes_or_changes_is_written_again_and_counted(stage: Stage) -> None:
    stage.place.write(documents())
    path = f"{POLICIES}/robotkube-agents"
    before = stage.server.objects.pop(path)
    stage.changed("ValidatingAdmissionPolicy", f"{POLICIES}/robotkube-elsewhere")  # nobody's
    assert stage.place.intact()
    stage.place._seen(("ValidatingAdmissionPolicy", "robotkube-agents"), None)
    assert (stage.place.intact(), len(stage.woken)) == (False, 1)
    assert stage.place.write(documents())
    assert stage.server.objects[path]["spec"] == before["spec"]
    stage.server.objects[LIST_PATH]["data"]["image.more"] = ""
    stage.changed("ConfigMap", LIST_PATH)
    assert stage.place.write(documents())
    assert "image.more" not in stage.server.objects[LIST_PATH]["data"]
    assert stage.place.restored == 2


def test_what_it_wrote_itself_wakes_nobody(stage: Stage) -> None:
    stage.place.write(documents())
    for path in stage.server.objects:
        if path != ROLE:
            stage.changed("ConfigMap" if path == LIST_PATH else "ValidatingAdmissionPolicy", path)
    assert (stage.place.intact(), stage.woken) == (True, [])


@pytest.mark.parametrize("away", [ROLE, LIST_PATH, f"{POLICIES}/robotkube-agents"])
def test_what_could_not_be_written_is_written_with_the_next_attempt(stage: Stage, away: str) -> None:
    """Also what somebody had touched before."""
    stage.place.write(documents())
    path = f"{POLICIES}/robotkube-agents"
    del stage.server.objects[path]
    stage.place._seen(("ValidatingAdmissionPolicy", "robotkube-agents"), None)
    stage.server.away = {away}
    more = replace(LISTED, verified=(digest(2),))
    with pytest.raises(UnavailableError, match="nobody answers"):
        stage.place.write(documents(found=more))
    assert not stage.place.intact()
    stage.server.away = set()
    assert stage.place.write(documents(found=more))
    assert (path in stage.server.objects, ListMemory(stage.place).load()) == (True, more)


def test_a_removal_that_failed_is_tried_again(stage: Stage) -> None:
    stage.place.write(documents())
    path = f"{POLICIES}/robotkube-tests"
    without = documents(replace(DOMAIN, tests=()))
    stage.server.refused = {path}
    with pytest.raises(InputError, match=r"DELETE .*: 403"):
        stage.place.write(without)
    stage.server.refused = set()
    assert stage.place.write(without)
    assert path not in stage.server.objects
