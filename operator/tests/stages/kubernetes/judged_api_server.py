"""An API server with admission policies from files, and requests to it by any account."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx

from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.kubernetes.argocd_definitions import define

MERGE, JSON_PATCH = "application/merge-patch+json", "application/json-patch+json"
RBAC = "/apis/rbac.authorization.k8s.io/v1/clusterrolebindings"
ADMINISTRATOR = ""  # the token's own account, of system:masters
NO_VARIABLES: Mapping[str, str] = MappingProxyType({})
Object = dict[str, Any]


@dataclass(frozen=True)
class Requests:
    """Requests as the administrator, or as the account that it impersonates."""

    client: httpx.Client

    def request(self, method: str, path: str, body: Any = None, user: str = ADMINISTRATOR, kind: str = "") -> Object:
        """The answer's document, of a refusal too (a Status)."""
        headers = {"Content-Type": kind or "application/json"} | ({"Impersonate-User": user} if user else {})
        answer: Object = self.client.request(method, path, json=body, headers=headers).json()
        return answer

    def done(self, method: str, path: str, body: Any = None, user: str = ADMINISTRATOR, kind: str = "") -> Object:
        """The answer of a request that is not refused."""
        answer = self.request(method, path, body, user, kind)
        assert answer["kind"] != "Status" or answer["status"] == "Success", answer["message"]
        return answer

    def refusal(self, method: str, path: str, body: Any = None, user: str = ADMINISTRATOR, kind: str = "") -> str:
        """The words of the policy that refuses this; it is an error when nothing does."""
        answer = self.request(method, path, body, user, kind)
        assert (answer["kind"], answer.get("status")) == ("Status", "Failure"), "it was taken"
        message = str(answer["message"])
        assert "ValidatingAdmissionPolicy 'robotkube-" in message, message
        return message.partition("denied request: ")[2]


@dataclass(frozen=True)
class Api(Requests):
    """The same to a server of the tests; `server` is its process."""

    server: ApiServerProcess


@contextmanager
def judged_api_server(
    folder: Path,
    documents: Sequence[Mapping[str, Any]] | None,
    environment: Mapping[str, str] = NO_VARIABLES,
    gives_tokens: bool = False,
    schemas: bool = False,
) -> Iterator[tuple[Api, PolicyFiles]]:
    """The API server; every account may do everything, as far as rights go: what is refused, a policy refuses. Without
    `documents` it reads no files; with `schemas` Argo CD's objects are only what they may be."""
    files = PolicyFiles(folder / "admission")
    if documents is not None:
        files.write(documents)
    with served(folder, files, environment, gives_tokens, schemas) as api:
        yield api, files


@contextmanager
def served(
    folder: Path,
    files: PolicyFiles,
    environment: Mapping[str, str] = NO_VARIABLES,
    gives_tokens: bool = False,
    schemas: bool = False,
) -> Iterator[Api]:
    """The same with these files, where they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    options = {"allow-privileged": "true"}  # so that it is a policy that refuses it
    if files.policies.exists():
        options.update(files.options)
    words = tuple(f"--{name}={value}" for name, value in options.items())
    server = ApiServerProcess(folder, options=words, environment=environment, gives_tokens=gives_tokens)
    try:
        server.start()
        with server.client() as client:
            api = Api(client, server)
            _allow_everything(api)
            define(client, ("applications", "appprojects"), schemas)
            yield api
    finally:
        server.stop()


def _allow_everything(api: Api) -> None:
    role = {"apiGroup": "rbac.authorization.k8s.io", "kind": "ClusterRole", "name": "cluster-admin"}
    subject = {"apiGroup": "rbac.authorization.k8s.io", "kind": "Group", "name": "system:authenticated"}
    api.done("POST", RBAC, {"metadata": {"name": "everybody"}, "roleRef": role, "subjects": [subject]})
