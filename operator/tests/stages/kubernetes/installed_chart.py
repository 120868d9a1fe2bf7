"""The platform chart on a real API server without nodes: the programs to talk to it, and what is there before."""

from __future__ import annotations

import base64
import json
import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx
import yaml

from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from tests.stages.kubernetes.api_server import ApiServerProcess, believing
from tests.stages.kubernetes.argocd_definitions import KINDS, define
from tests.stages.paths import CHARTS
from tests.stages.programs import SELDOM_COLLECTING, program

CALL_SECONDS_MAX = 120
CHART = CHARTS / "robotkube"
NO_OPTIONS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Cluster:
    """An API server, and the programs to talk to it."""

    kubeconfig: Path

    def run(self, name: str, *arguments: str, text: str | None = None) -> subprocess.CompletedProcess[str]:
        own = {"KUBECONFIG": str(self.kubeconfig), "HOME": str(self.kubeconfig.parent)}
        command = [program(name), *arguments]
        return subprocess.run(
            command,
            input=text,
            capture_output=True,
            text=True,
            timeout=CALL_SECONDS_MAX,
            check=False,
            env={**os.environ, **SELDOM_COLLECTING, **own},
        )

    def kubectl(self, *arguments: str, text: str | None = None) -> str:
        done = self.run("kubectl", "-n", "robotkube", *arguments, text=text)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def helm(self, *arguments: str) -> str:
        """What helm says; without asking the API server first whether it checks fields, which it does: it warns of one
        that it does not know."""
        options = ("--disable-openapi-validation",) if arguments[0] in ("install", "upgrade") else ()
        done = self.run("helm", "-n", "robotkube", *arguments, *options)
        assert done.returncode == 0, done.stderr
        assert str(CHART) not in arguments or "unknown field" not in done.stderr, done.stderr
        return done.stdout

    def client(self, account: str = "") -> httpx.Client:
        """Requests of the administrator, or of a service account `<namespace>:<name>` that it impersonates."""
        document = yaml.safe_load(self.kubeconfig.read_text())
        headers = {"Authorization": f"Bearer {document['users'][0]['user']['token']}"}
        headers |= {"Impersonate-User": f"system:serviceaccount:{account}"} if account else {}
        server = document["clusters"][0]["cluster"]
        verify = believing(Path(server["certificate-authority"]))
        return httpx.Client(base_url=server["server"], headers=headers, verify=verify, timeout=30)

    def password(self, namespace: str, name: str) -> str:
        secret = json.loads(self.kubectl("get", "secret", name, "-n", namespace, "-o", "json"))
        return base64.b64decode(secret["data"]["password"]).decode()


@contextmanager
def prepared_cluster(
    folder: Path,
    policies: Sequence[Mapping[str, Any]] = (),
    options: Mapping[str, str] = NO_OPTIONS,
    kinds: Sequence[str] = tuple(KINDS),
) -> Iterator[Cluster]:
    """An API server on `folder`, with what the platform chart needs: its namespaces and these `kinds` of Argo CD, which
    take any content. Under these admission policies, from files, or with further `options`."""
    if policies:
        files = PolicyFiles(folder / "admission")
        files.write(policies)
        options = {**options, **files.options}
    server = ApiServerProcess(folder, options=tuple(f"--{name}={value}" for name, value in options.items()))
    try:
        server.start()
        with server.client() as client:
            for namespace in ("robotkube", "argocd"):
                client.post("/api/v1/namespaces", json={"metadata": {"name": namespace}}).raise_for_status()
            define(client, kinds)
        yield Cluster(server.kubeconfig)
    finally:
        server.stop()
