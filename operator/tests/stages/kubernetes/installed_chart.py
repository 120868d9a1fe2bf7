"""The platform chart on a real API server without nodes: the programs to talk to it, and what is there before."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ci import toolchain
from robotkube.registry.admission.adapters.policy_files import PolicyFiles
from tests.stages.kubernetes.api_server import ApiServerProcess
from tests.stages.paths import CHARTS
from tests.stages.programs import program

SERVED_SECONDS_MAX = 60.0
CALL_SECONDS_MAX = 120
CHART = CHARTS / "robotkube"
NO_OPTIONS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Cluster:
    """An API server, and the programs to talk to it."""

    kubeconfig: Path

    def run(self, name: str, *arguments: str, text: str | None = None) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "KUBECONFIG": str(self.kubeconfig), "HOME": str(self.kubeconfig.parent)}
        command = [program(name), *arguments]
        return subprocess.run(
            command, input=text, capture_output=True, text=True, timeout=CALL_SECONDS_MAX, check=False, env=environment
        )

    def kubectl(self, *arguments: str, text: str | None = None) -> str:
        done = self.run("kubectl", "-n", "robotkube", *arguments, text=text)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def helm(self, *arguments: str) -> str:
        done = self.run("helm", "-n", "robotkube", *arguments)
        assert done.returncode == 0, done.stderr
        assert str(CHART) not in arguments or "unknown field" not in done.stderr, done.stderr
        return done.stdout

    def password(self, namespace: str, name: str) -> str:
        secret = json.loads(self.kubectl("get", "secret", name, "-n", namespace, "-o", "json"))
        return base64.b64decode(secret["data"]["password"]).decode()


@contextmanager
def prepared_cluster(
    folder: Path, policies: Sequence[Mapping[str, Any]] = (), options: Mapping[str, str] = NO_OPTIONS
) -> Iterator[Cluster]:
    """An API server on `folder`, with what the platform chart needs; under these admission policies, from files, or
    with further `options`."""
    if policies:
        files = PolicyFiles(folder / "admission")
        files.write(policies)
        options = {**options, **files.options}
    server = ApiServerProcess(folder, options=tuple(f"--{name}={value}" for name, value in options.items()))
    try:
        server.start()
        cluster = Cluster(server.kubeconfig)
        prepare(cluster)
        yield cluster
    finally:
        server.stop()


def prepare(cluster: Cluster) -> None:
    """What is there before the platform: Argo CD's definitions, and the namespaces."""
    manifests = toolchain.module_dir("github.com/argoproj/argo-cd/v3") / "manifests" / "crds"
    names = ("application-crd.yaml", "applicationset-crd.yaml", "appproject-crd.yaml")
    files = [option for name in names for option in ("-f", str(manifests / name))]
    for namespace in ("robotkube", "argocd"):
        cluster.kubectl("create", "namespace", namespace)
    cluster.kubectl("apply", "--server-side", *files)
    deadline = time.monotonic() + SERVED_SECONDS_MAX
    while cluster.run("kubectl", "get", "applications,applicationsets,appprojects").returncode:
        assert time.monotonic() < deadline, "Argo CD's definitions are not served"
        time.sleep(0.2)
