"""The port RemovalCluster in memory: pods and Deployments that go, change and come again."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from robotkube.errors import InputError, UnavailableError

Object = dict[str, Any]


class ClusterInMemory:
    """`makers`: pods that somebody makes again under these names as soon as they are gone. `hidden`: pods that may not
    be read; `refusing`: the words with which changes are refused; `away`: nobody answers; `meddling`: everything is
    changed between reading and writing."""

    def __init__(self) -> None:
        self.documents: dict[str, Object] = {}
        self.pods: dict[str, Object] = {}
        self.deployments: dict[str, Object] = {}
        self.makers: set[str] = set()
        self.hidden: set[str] = set()
        self.refusing = ""
        self.away = False
        self.meddling = False
        self.deleted: list[tuple[str, str, int]] = []
        self.patched: list[tuple[str, list[str]]] = []
        self.events: list[tuple[str, str, str, bool]] = []
        self.conditions_written = 0

    def put(self, *inspections: Object) -> None:
        """The Inspections as an inspector writes them: the remover's condition stays."""
        for inspection in inspections:
            before = self.documents.get(inspection["metadata"]["name"], {})
            kept = [c for c in before.get("status", {}).get("conditions", []) if c["type"] == "Removed"]
            status = {**inspection["status"], "conditions": [*inspection["status"]["conditions"], *kept]}
            self.documents[inspection["metadata"]["name"]] = {**inspection, "status": status}

    def condition(self, name: str = "kubelet.one") -> tuple[str, str, str]:
        """Status, reason and message of Removed."""
        [one] = [c for c in self.documents[name]["status"]["conditions"] if c["type"] == "Removed"]
        return one["status"], one["reason"], one["message"]

    def inspections(self) -> Sequence[Object]:
        if self.away:
            raise UnavailableError("API server: it does not answer")
        return list(copy.deepcopy(self.documents).values())

    def pod(self, namespace: str, name: str) -> Object | None:
        if name in self.hidden:
            raise InputError(f'pods "{name}" is forbidden')
        return copy.deepcopy(self.pods.get(name))

    def deployment(self, namespace: str, name: str) -> Object | None:
        return copy.deepcopy(self.deployments.get(name))

    def delete_pod(self, pod: Mapping[str, Any], grace_seconds: int) -> bool:
        self._refuse()
        name, uid = pod["metadata"]["name"], pod["metadata"]["uid"]
        if self.meddling:
            return False
        assert self.pods[name]["metadata"] == pod["metadata"]
        self.deleted.append((name, uid, grace_seconds))
        if name in self.makers:
            self.pods[name]["metadata"]["uid"] = f"{uid}+"
        else:
            del self.pods[name]
        return True

    def patch_deployment(self, deployment: Mapping[str, Any], patch: Sequence[Mapping[str, Any]]) -> bool:
        self._refuse()
        if self.meddling:
            return False
        name = deployment["metadata"]["name"]
        self.patched.append((name, [step["path"] for step in patch if step["op"] == "remove"]))
        self.deployments[name]["metadata"]["generation"] += 1
        return True

    def write_condition(self, inspection: str, condition: Mapping[str, Any]) -> None:
        conditions = self.documents[inspection]["status"]["conditions"]
        conditions[:] = [*(c for c in conditions if c["type"] != "Removed"), dict(condition)]
        self.conditions_written += 1

    def report(self, inspection: str, uid: str, reason: str, text: str, warning: bool) -> None:
        self.events.append((inspection, reason, text, warning))

    def _refuse(self) -> None:
        if self.refusing:
            raise InputError(self.refusing)
